"""Geometry without what of it cannot be drawn: one file a kind."""
