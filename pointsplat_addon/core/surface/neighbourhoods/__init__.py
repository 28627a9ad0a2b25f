"""Surfaces from points alone: for each point an ellipse in the plane of its neighbours."""
