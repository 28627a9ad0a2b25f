"""Blender looks for register and unregister beside the manifest."""

# Blender's name for an extension has dots; pytest, which imports this file too, gives it none.
if "." in (__package__ or ""):
    from .pointsplat_addon import register, unregister

    __all__ = ["register", "unregister"]
