"""Scenes with indirect light, by PointSplat and by Cycles."""
