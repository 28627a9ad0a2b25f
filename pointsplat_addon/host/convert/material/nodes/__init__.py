"""Blender's shader nodes as expressions of core: the reader of node trees, and what each kind of node becomes."""
