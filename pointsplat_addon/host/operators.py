"""Operators."""

import bpy

from . import caches, preferences


class POINTSPLAT_OT_clear_cache(bpy.types.Operator):
    """Forget converted geometry and delete the cache's files; the next picture makes them anew"""

    bl_idname = "pointsplat.clear_cache"
    bl_label = "Clear Cache"

    def execute(self, _context):
        files = caches.clear_folder(preferences.cache_folder())
        caches.release()
        self.report({"INFO"}, f"PointSplat's cache is cleared, {files} files deleted")
        return {"FINISHED"}


CLASSES = (POINTSPLAT_OT_clear_cache,)
