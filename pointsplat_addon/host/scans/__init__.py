"""Scans in Blender: PointCloud objects out of files."""
