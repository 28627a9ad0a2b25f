"""Strands: curves evaluated to polylines, cleaned polylines with levels of detail, and the segments that a view
draws."""
