"""Draws the indirect light of a picture: receivers among its groups, and what they tell of others."""
