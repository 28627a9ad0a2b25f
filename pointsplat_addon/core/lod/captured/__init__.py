"""Level of detail of captured Gaussian splats: merged nodes, and the cuts of them that views draw."""
