"""Participating media as splats: voxels, their optics, transfer functions and normals."""
