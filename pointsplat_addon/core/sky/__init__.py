"""Worlds that vary with the direction: pictures of graphs, and models of the sky."""
