"""Translucent splats: lit once for a view, then blended over the opaque picture of every sample."""
