"""Formats of scans: each module reads one, without Blender, in chunks (reader.py says how)."""
