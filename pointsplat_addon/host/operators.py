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


CLASSES = (POINTSPLAT_OT_clear_cache,)
