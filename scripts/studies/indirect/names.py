"""The names of the scenes, known without Blender."""

NAMES = ("room", "walls", "dragon", "truck", "fur", "scan", "foliage", "street", "letters", "chrome",
         "polished", "brushed")  # fmt: skip
