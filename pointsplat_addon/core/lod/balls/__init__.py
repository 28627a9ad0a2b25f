"""Nodes over balls, for the visibility buffer: how they are built, and the cut that a view draws of them."""
