"""Blender-facing code: the only part of PointSplat that imports bpy."""
