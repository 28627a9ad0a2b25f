"""Shadow tables of a scene's lights: what casts, how densely it is sampled, and the tables as textures."""
