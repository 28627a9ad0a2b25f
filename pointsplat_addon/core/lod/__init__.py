"""Level of detail: hierarchies of splats over points, cuts through them, instances, depth order and costs."""
