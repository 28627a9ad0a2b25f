"""Blender's data blocks as the plain data of core: one file or folder for each kind of data."""
