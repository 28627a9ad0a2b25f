"""Polygons, wide balls and strands, rasterised exactly into the G-buffer that points share."""
