"""Splats: their kernels, what they stand for and hide, their ellipsoids, and how a lens blurs them."""
