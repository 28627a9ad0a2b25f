"""Hair and curves of Blender as strands of core: one file for each kind of source."""
