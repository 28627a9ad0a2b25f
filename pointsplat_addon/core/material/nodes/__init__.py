"""Nodes of material expressions, one module for each theme."""
