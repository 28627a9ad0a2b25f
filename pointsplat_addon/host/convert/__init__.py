"""Blender data blocks to the plain data of core: one file per kind of data."""
