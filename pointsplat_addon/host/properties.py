"""scene.pointsplat and object.pointsplat, made from core.scene's tables."""

from dataclasses import fields
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ..core.scene.settings import BUDGETS, DEVICES, DOF_METHODS, PRIMITIVES, TECHNIQUES, Settings
from . import engine

Item = tuple[str, str, str]

TECHNIQUE_ITEMS: dict[str, Item] = {
    "AUTO": ("AUTO", "Automatic", "EWA for final renders of points that have colours of their own, else image space"),
    "IMAGE_SPACE": (
        "IMAGE_SPACE",
        "Image Space",
        "Project each point to one pixel and fill the gaps between them in the picture",
    ),
    "EWA": (
        "EWA",
        "EWA",
        "Blend points as Gaussians no finer than the pixels: textures do not flicker from afar, edges are soft",
    ),
    "PAINTER": (
        "PAINTER",
        "Painter",
        "Paint points as fuzzy ellipses from back to front: they mix with smoke and glass point by point",
    ),
}
BUDGET_ITEMS: dict[str, Item] = {
    "NONE": ("NONE", "None", "Samples and tolerance are what the settings say"),
    "TIME": (
        "TIME",
        "Time",
        "As many samples and as fine a cut, up to the tolerance, as the time allows, by what pictures took before",
    ),
    "ERROR": ("ERROR", "Error", "Samples, and a finer tolerance where they do not suffice, until the error is small"),
}
DEVICE_ITEMS: dict[str, Item] = {
    "AUTO": ("AUTO", "Automatic", "An OpenGL context of its own for final renders, Blender's in the viewport"),
    "BLENDER_GPU": (
        "BLENDER_GPU",
        "Blender GPU",
        "Draw with Blender's graphics backend; final renders block the window",
    ),
    "OPENGL": (
        "OPENGL",
        "OpenGL",
        "Draw final renders on an OpenGL context of its own, so that the window stays alive",
    ),
}
DOF_ITEMS: dict[str, Item] = {
    "SPLAT": (
        "SPLAT",
        "Splat",
        "Blur each splat by its circle of confusion: what is blurred more takes fewer splats. "
        "The shape of the aperture is taken for a disk",
    ),
    "LENS_SAMPLES": (
        "LENS_SAMPLES",
        "Lens Samples",
        "Draw each sample through another place on the aperture: exact with many samples, blades and ratio included",
    ),
}
PRIMITIVE_ITEMS: dict[str, Item] = {
    "AUTO": ("AUTO", "Automatic", "Polygons where triangles are large in the picture, points where they are small"),
    "POINTS": ("POINTS", "Points", "Sample the surface with points"),
    "POLYGONS": ("POLYGONS", "Polygons", "Draw the triangles themselves; curves with a bevel become meshes"),
    "LINES": ("LINES", "Lines", "Draw curves with a round bevel as tubes along their points; the rest as by Automatic"),
}

# Name and tooltip of each field of Settings
LABELS: dict[str, tuple[str, str]] = {
    "technique": ("Technique", "How points become pixels"),
    "tolerance": (
        "Tolerance",
        "Size in pixels below which one point stands for all the finer ones that it covers; smaller is more exact",
    ),
    "samples": ("Render", "Number of sub-pixel samples that are averaged for each pixel of a final render"),
    "viewport_samples": ("Viewport", "Number of sub-pixel samples that are averaged in the viewport while it is still"),
    "use_adaptive_sampling": (
        "Adaptive Sampling",
        "Parts of the picture whose samples agree get no more of them; does not apply to what is translucent",
    ),
    "adaptive_threshold": (
        "Threshold",
        "Difference between the means of all samples and of half of them below which no more are taken; "
        "smaller is more exact",
    ),
    "use_shadows": ("Shadows", "Lights cast shadows, which what is translucent softens and tints"),
    "shadow_resolution": (
        "Resolution",
        "Number of cells in half a turn around each lamp that hold what its light crosses; more cells, sharper shadows",
    ),
    "dof_method": ("Depth of Field", "How cameras with depth of field blur what is out of focus"),
    "budget": ("Budget", "What decides how many samples are drawn and how coarse the points may be"),
    "time_budget": (
        "Time",
        "Milliseconds that a final render may take once the scene is converted, and a picture of the viewport while "
        "it moves",
    ),
    "error_budget": (
        "Error",
        "Root mean square error that a picture may have against very many samples at a quarter of the tolerance, "
        "in scene-linear values",
    ),
    "device": ("Device", "What draws the pictures"),
}
ITEMS = {
    "technique": [TECHNIQUE_ITEMS[n] for n in TECHNIQUES],
    "dof_method": [DOF_ITEMS[n] for n in DOF_METHODS],
    "budget": [BUDGET_ITEMS[n] for n in BUDGETS],
    "device": [DEVICE_ITEMS[n] for n in DEVICES],
}


def changed(_properties: Any, _context: bpy.types.Context) -> None:
    """An update callback: without one, Blender does not refresh evaluated copies after a Python script's write."""


def device_changed(_properties: Any, _context: bpy.types.Context) -> None:
    engine.choose_context()


def _property(name: str, default: Any) -> Any:
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


class PointSplatScene(bpy.types.PropertyGroup):
    """Settings of the render engine; one property for each field of core.scene.Settings."""

    __annotations__ = {f.name: _property(f.name, f.default) for f in fields(Settings)}

    def settings(self) -> Settings:
        """The values as core.scene.Settings."""
        return Settings(**{f.name: getattr(self, f.name) for f in fields(Settings)})


class PointSplatObject(bpy.types.PropertyGroup):
    """How one object becomes points."""

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
    radius: FloatProperty(
        name="Radius",
        description="Radius of the points of a point cloud or of a mesh without edges and faces, before the object's "
        "scale; zero takes their radius attribute, else 0.01 for point clouds and half the median distance between "
        "neighbours for meshes",
        default=0.0,
        min=0.0,
        soft_max=1.0,
        precision=4,
        subtype="DISTANCE",
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


CLASSES = (PointSplatScene, PointSplatObject)


def register() -> None:
    bpy.types.Scene.pointsplat = PointerProperty(type=PointSplatScene)
    bpy.types.Object.pointsplat = PointerProperty(type=PointSplatObject)


def unregister() -> None:
    del bpy.types.Object.pointsplat
    del bpy.types.Scene.pointsplat
