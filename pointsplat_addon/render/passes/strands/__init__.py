"""Strands: pages of control points, and segments drawn into the G-buffer or into the visibility buffer."""
