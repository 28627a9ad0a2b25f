"""Formats of captured Gaussian splats: each module reads one, without Blender, in chunks (reader.py says how)."""
