"""Gathered light: surfels of a scene, their light, and what receivers see of them."""
