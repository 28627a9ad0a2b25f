"""Writes captured splats, and makes of an object's splats those of a file."""
