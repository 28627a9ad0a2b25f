"""Draws a picture by the visibility buffer: all sub-samples at once, each surface of a pixel shaded once."""
