"""Renderers on the devices that Blender offers: their threads, contexts and measured costs."""
