"""Builds hierarchies on disk from scans of any size, in steps whose results are files: see build."""
