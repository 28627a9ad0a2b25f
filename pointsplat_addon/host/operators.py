"""Operators."""

import bpy

from ..formats import hierarchy_cache
from . import caches, preferences


class POINTSPLAT_OT_clear_cache(bpy.types.Operator):
    """Forget converted geometry and delete the cache's files; the next picture makes them anew"""

    bl_idname = "pointsplat.clear_cache"
    bl_label = "Clear Cache"

    def execute(self, _context):
        folder = preferences.cache_folder()
        freed = hierarchy_cache.trim(folder, 0) if folder else 0
        caches.release()
        self.report({"INFO"}, f"PointSplat's cache is cleared, {freed / 1e6:.1f} MB deleted")
        return {"FINISHED"}


class POINTSPLAT_OT_transfer_ramp(bpy.types.Operator):
    """Give the volume a colour ramp of its own"""

    bl_idname = "pointsplat.transfer_ramp"
    bl_label = "New Colour Ramp"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.object is not None and context.object.type == "VOLUME"

    def execute(self, context):
        texture = bpy.data.textures.new(f"{context.object.name} Transfer", "BLEND")
        texture.use_color_ramp = True
        context.object.pointsplat.transfer_texture = texture
        return {"FINISHED"}


CLASSES = (POINTSPLAT_OT_clear_cache, POINTSPLAT_OT_transfer_ramp)
