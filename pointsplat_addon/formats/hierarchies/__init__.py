"""Scans on disk that are read by pages: PointSplat's own hierarchies, and files that have levels of detail already."""
