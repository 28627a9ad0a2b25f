"""Polygons, wide balls and splats, rasterised exactly into the G-buffer that points share or the visibility buffer."""
