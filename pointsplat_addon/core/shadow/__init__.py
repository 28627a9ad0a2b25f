"""Translucent shadow tables (Gunjee et al. 2007): casters, grids of directions, how tables are built, and what they
hold."""
