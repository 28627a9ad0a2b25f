"""Fits strands to meshes: tubes to branches and ribbons to leaves (Marroquim et al. 2008, section 5)."""
