"""Image-space reconstruction: one pixel per point, then pull-push over a pyramid (Marroquim et al. 2008)."""
