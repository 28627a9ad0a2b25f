"""Scans as text: a point a line."""
