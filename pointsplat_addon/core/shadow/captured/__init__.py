"""Captured Gaussian splats as casters of shadows."""
