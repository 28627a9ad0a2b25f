"""The properties scene.pointsplat and object.pointsplat, made from the tables of core.scene.settings."""

from dataclasses import fields
from typing import Any

import bpy
import numpy as np
from bpy.props import (
    BoolProperty,
    CollectionProperty,
    EnumProperty,
    FloatProperty,
    IntProperty,
    PointerProperty,
    StringProperty,
)

from ...core.scene.settings import LIGHTINGS, PRIMITIVES, RADIUS_UNITS, SHAPES, Settings
from .. import engine
from .labels import CLIP_ITEMS, ITEMS, LABELS, LIGHTING_ITEMS, PRIMITIVE_ITEMS, RADIUS_UNIT_ITEMS, SHAPE_ITEMS
from .point_filters import PointSplatFilter, changed


def device_changed(_properties: Any, _context: bpy.types.Context) -> None:
    """Register the engine with the kind of context that the device setting needs."""
    engine.choose_context()


def _property(name: str, default: Any) -> Any:
    """Blender's property for a field of Settings."""
    label, tooltip = LABELS[name]
    common = {"name": label, "description": tooltip, "default": default, "update": UPDATES.get(name, changed)}
    if name in ITEMS:
        return EnumProperty(items=ITEMS[name], **common)
    if isinstance(default, bool):
        return BoolProperty(**common)
    low, high = Settings.RANGES[name]
    if isinstance(default, int):
        return IntProperty(min=int(low), max=int(high), **common)
    if name == "tolerance":
        return FloatProperty(min=low, max=high, soft_max=16.0, subtype="PIXEL", precision=2, **common)
    if name == "time_budget":
        return FloatProperty(min=low, max=high, soft_max=10_000.0, precision=1, **common)
    return FloatProperty(min=low, max=high, precision=4, **common)


UPDATES = {"device": device_changed}
OF_BLENDER = Settings.OF_BLENDER


class PointSplatScene(bpy.types.PropertyGroup):
    """Settings of the render engine; one property for each field of core.scene.settings.Settings that Blender does not
    have."""

    __annotations__ = {
        f.name: _property(f.name, Settings.IN_BLENDER.get(f.name, f.default))
        for f in fields(Settings)
        if f.name not in OF_BLENDER
    }

    def settings(self) -> Settings:
        """The present values; those of Blender's own properties within the ranges that PointSplat has."""
        render, own = self.id_data.render, self.__annotations__
        found = {name: float(np.clip(getattr(render, name), *Settings.RANGES[name])) for name in OF_BLENDER}
        return Settings(**found, **{name: getattr(self, name) for name in own})


class PointSplatObject(bpy.types.PropertyGroup):
    """How one object is drawn."""

    primitive: EnumProperty(
        name="Primitive",
        description="What the object is drawn with",
        items=[PRIMITIVE_ITEMS[n] for n in PRIMITIVES],
        default="AUTO",
        update=changed,
    )
    spacing: FloatProperty(
        name="Spacing",
        description="Distance between points on the surface, before the object's scale; zero chooses by the view",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        precision=4,
        subtype="DISTANCE",
        update=changed,
    )
    shape: EnumProperty(
        name="Shape",
        description="What each point of a point cloud is drawn as",
        items=[SHAPE_ITEMS[n] for n in SHAPES],
        default="BALLS",
        update=changed,
    )
    radius: FloatProperty(
        name="Radius",
        description="Radius of the points of a point cloud or of a mesh without edges and faces, before the object's "
        "scale; of a surface, that of its largest disks. Zero takes their radius attribute, else 0.01 for point clouds "
        "and half the median distance between neighbours for meshes; surfaces have what closes them",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        precision=4,
        update=changed,
    )
    radius_unit: EnumProperty(
        name="Unit",
        description="What the radius of the points of a point cloud counts in",
        items=[RADIUS_UNIT_ITEMS[n] for n in RADIUS_UNITS],
        default="OBJECT",
        update=changed,
    )
    scan_path: StringProperty(
        name="File",
        description="The file of the scan that the object's points stand for: of an Entwine folder its ept.json, or "
        "COPC. Pictures show what they need of it",
        default="",
        subtype="FILE_PATH",
        options={"PATH_SUPPORTS_BLEND_RELATIVE"},
        update=changed,
    )
    lighting: EnumProperty(
        name="Lighting",
        description="What light does to captured Gaussian splats",
        items=[LIGHTING_ITEMS[n] for n in LIGHTINGS],
        default="CAPTURED",
        update=changed,
    )
    filters: CollectionProperty(
        type=PointSplatFilter,
        name="Filters",
        description="Conditions that the points of a point cloud must all meet to be drawn",
    )
    clip_boxes: PointerProperty(
        type=bpy.types.Collection,
        name="Collection",
        description="Clip boxes of a point cloud: all empties of this collection. A box is the cube that an empty "
        "displayed as Cube is drawn as, from -1 to 1 times its display size along each of its own axes, with its "
        "rotation and scale. Hidden empties clip, too, where they were seen last",
        update=changed,
    )
    clip_keep: EnumProperty(
        name="Keep",
        description="Which points are drawn",
        items=CLIP_ITEMS,
        default="INSIDE",
        update=changed,
    )
    extinction: FloatProperty(
        name="Extinction",
        description="How much the object's points absorb and scatter per unit of length; zero asks the material",
        default=0.0,
        min=0.0,
        soft_max=100.0,
        precision=3,
        update=changed,
    )
    ribbons: BoolProperty(
        name="Ribbons",
        description="Strands are flat and lie across the normals of their curves, with their tilt; "
        "otherwise they are round",
        default=False,
        update=changed,
    )
    use_transfer: BoolProperty(
        name="Transfer Function",
        description="Colour and density of the volume by a colour ramp over the values of a grid, not by the material",
        default=False,
        update=changed,
    )
    transfer_grid: StringProperty(
        name="Grid", description="The grid whose values the ramp colours", default="density", update=changed
    )
    transfer_low: FloatProperty(
        name="From", description="The value at the ramp's left end", default=0.0, precision=3, update=changed
    )
    transfer_high: FloatProperty(
        name="To", description="The value at the ramp's right end", default=1.0, precision=3, update=changed
    )
    transfer_density: FloatProperty(
        name="Density",
        description="Extinction per unit of length where the ramp's alpha is one",
        default=1.0,
        min=0.0,
        soft_max=100.0,
        precision=3,
        update=changed,
    )
    # Blender has no property that is a colour ramp; a texture has one.
    transfer_texture: PointerProperty(
        type=bpy.types.Texture,
        name="Ramp",
        description="The texture that holds the colour ramp",
        poll=lambda _settings, texture: texture.type == "BLEND",
        update=changed,
    )


def update_passes(settings, _context) -> None:
    """Register the passes of all view layers of a scene again."""
    for view_layer in settings.id_data.view_layers:
        view_layer.update_render_passes()


class PointSplatViewLayer(bpy.types.PropertyGroup):
    """Settings of a view layer: passes that Blender has no switch for."""

    use_pass_volume_direct: BoolProperty(
        name="Volume Direct",
        description="Deliver the light that volumes scatter once",
        default=False,
        update=update_passes,
    )
    use_pass_volume_indirect: BoolProperty(
        name="Volume Indirect",
        description="Deliver the light that volumes scatter after others did",
        default=False,
        update=update_passes,
    )


CLASSES = (PointSplatScene, PointSplatObject, PointSplatViewLayer)


def register() -> None:
    bpy.types.Scene.pointsplat = PointerProperty(type=PointSplatScene)
    bpy.types.Object.pointsplat = PointerProperty(type=PointSplatObject)
    bpy.types.ViewLayer.pointsplat = PointerProperty(type=PointSplatViewLayer)


def unregister() -> None:
    del bpy.types.ViewLayer.pointsplat
    del bpy.types.Object.pointsplat
    del bpy.types.Scene.pointsplat
