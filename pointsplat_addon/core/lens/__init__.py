"""Depth of field: the thin lens, the kernel of splats out of focus, dicing of geometry, and the blurred world."""
