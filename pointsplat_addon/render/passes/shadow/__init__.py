"""Passes that draw depth maps seen from lights."""
