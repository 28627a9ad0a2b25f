"""Chooses what one view draws: points, polygons, strands and their levels of detail; numpy only."""
