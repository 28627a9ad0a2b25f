"""Which points of a PointCloud object are drawn: filters by what they are, boxes by where they are."""
