"""Light: BSDFs of surfaces and hair, the tables that shaders read of lights, and prefiltered environments."""
