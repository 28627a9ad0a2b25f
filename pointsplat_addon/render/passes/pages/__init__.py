"""Splats on the device: pages of textures, and the blocks of splats that a view draws."""
