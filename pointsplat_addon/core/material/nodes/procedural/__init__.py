"""Procedural textures: noise, cells and patterns that are functions of a point alone."""
