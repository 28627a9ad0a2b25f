"""The names of the scenes, known without Blender."""

NAMES = ("room", "walls", "dragon", "truck", "fur", "scan", "foliage", "street", "letters")
MIRRORS = ("chrome", "polished", "brushed")  # roughness 0, 0.1 and 0.2
