"""Captured Gaussian splats in Blender: PointCloud objects out of files, and files out of them."""
