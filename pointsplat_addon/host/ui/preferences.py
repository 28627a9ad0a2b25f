"""The extension's preferences."""

import os
from pathlib import Path

import bpy
from bpy.props import StringProperty

from ..device import libraries

# Installed, Blender knows the extension by its root, bl_ext.<repository>.pointsplat; a checkout has no more than the
# package itself.
ROOT = (__package__ or "").removesuffix(".host.ui").removesuffix(".pointsplat_addon")


class PointSplatPreferences(bpy.types.AddonPreferences):
    bl_idname = ROOT

    cache_folder: StringProperty(
        name="Cache Folder",
        description="Where point hierarchies are kept between sessions; empty uses the extension's own folder",
        subtype="DIR_PATH",
        default="",
    )

    device_costs: StringProperty(
        name="Device Costs",
        description="What drawing in image space costs on each device, as measured; decides what is points there",
        default="",
        options={"HIDDEN"},
    )

    def draw(self, _context):
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "cache_folder", placeholder=str(own_folder() or ""))
        layout.operator("pointsplat.clear_cache")
        box = layout.column(heading="Final Renders")
        box.label(text=device_text(), icon="INFO")
        layout.operator("pointsplat.calibrate")


def device_text() -> str:
    """What final renders are drawn with, as text for people."""
    if libraries.has_moderngl():
        return "OpenGL context of their own (moderngl)"
    return "Blender's graphics backend: moderngl is not installed, so the window stands still while they run"


def own_folder() -> Path | None:
    """The folder that Blender gives an installed extension; None for a checkout."""
    try:
        return Path(bpy.utils.extension_path_user(ROOT, path="cache"))
    except ValueError:
        return None


def cache_folder() -> Path | None:
    """The folder of hierarchies on disk, which the environment may name for all machines of a farm; None if they are
    not kept."""
    if shared := os.environ.get("POINTSPLAT_CACHE"):
        return Path(shared)
    addon = bpy.context.preferences.addons.get(ROOT)
    chosen = addon.preferences.cache_folder if addon and addon.preferences else ""
    return Path(bpy.path.abspath(chosen)) if chosen else own_folder()


def device_costs() -> str:
    """The costs that `keep_device_costs` stored, as JSON; empty if none were."""
    addon = bpy.context.preferences.addons.get(ROOT)
    return addon.preferences.device_costs if addon and addon.preferences else ""


def keep_device_costs(text: str) -> None:
    """Store measured costs as JSON in the preferences, which Blender saves."""
    addon = bpy.context.preferences.addons.get(ROOT)
    if addon and addon.preferences and addon.preferences.device_costs != text:
        addon.preferences.device_costs = text
        bpy.context.preferences.is_dirty = True


CLASSES = (PointSplatPreferences,)
