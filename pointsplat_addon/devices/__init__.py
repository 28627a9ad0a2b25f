"""The devices: Blender's gpu module, an OpenGL context of our own, and one that only records."""
