"""File formats, one module each: numpy in and out, no Blender."""
