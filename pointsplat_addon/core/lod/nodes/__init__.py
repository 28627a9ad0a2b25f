"""The nodes of a hierarchy: links, partition of points, merging of splats, their bounds and optics."""
