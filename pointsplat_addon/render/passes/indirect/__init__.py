"""Passes that light surfels, and gather from the light tree."""
