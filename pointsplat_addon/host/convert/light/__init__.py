"""Lights and worlds of Blender."""
