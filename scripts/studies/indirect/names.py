"""The names of the scenes, known without Blender."""

NAMES = ("room", "walls", "dragon", "truck", "fur", "scan", "foliage", "street", "letters", "cloud", "smoke", "alone",
         "chrome", "polished", "brushed")  # fmt: skip
