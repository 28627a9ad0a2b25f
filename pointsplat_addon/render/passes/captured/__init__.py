"""Captured Gaussian splats: projected once for a view, then blended as lit splats are."""
