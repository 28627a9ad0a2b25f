"""PointCloud objects out of gathered points, in all versions of Blender, and where they lie on the map.

Positions are relative to an origin in float64, which the object keeps as the custom property `pointsplat_origin`, three
doubles: an object's point p lies at origin + p. The scene's origin is kept as BlenderGIS keeps it: the custom
properties `crs x`, `crs y` and `SRID`. All scans of a scene share it; objects whose own origin differs are moved by the
difference.
"""

from __future__ import annotations

import ctypes
from typing import Any

import bpy
import numpy as np

from ...core.material.color_models import linear_from_srgb
from ...core.surface.nearest import scan_spacing
from ...formats.points.gather import Gathered
from ..convert.point_shapes import STATIONS
from ..convert.pointcloud import DEFAULT_RADIUS
from ..convert.selection.filters import ORIGIN

TIME_START = "pointsplat_time_start"
CRS = "pointsplat_crs"
COLOR = "Col"
KINDS = {"FLOAT": ("value", np.float32), "INT": ("value", np.int32), "INT8": ("value", np.int8),
         "FLOAT_VECTOR": ("vector", np.float32), "FLOAT_COLOR": ("color", np.float32)}  # fmt: skip


def scan_object(name: str, found: Gathered, crs: str) -> bpy.types.Object:
    """Returns a new PointCloud object, in no collection, whose points these are.

    Columns are taken out of `found` as they are written, so that no more than one of them is held twice.
    """
    count = len(found)
    position = found.columns["position"]
    radius = found.columns.pop("radius", None)
    if radius is None:
        radius = np.full(count, 0.5 * scan_spacing(position) or DEFAULT_RADIUS, np.float32)
    data = with_points(name, count)
    _write(data, "position", found.columns.pop("position"))
    _write(data, "radius", np.asarray(radius, np.float32))
    color = found.columns.pop("color", None)
    if color is not None:
        _write_color(data, color)
        del color
    for column in list(found.columns):
        _write(data, column, found.columns.pop(column))
    ob = as_object(name, data)
    ob[ORIGIN] = [float(x) for x in found.origin]
    if found.time_start:
        ob[TIME_START] = float(found.time_start)
    if crs:
        ob[CRS] = crs
    if len(found.stations):
        ob[STATIONS] = [float(x) for x in found.stations.ravel()]
    return ob


def scene_origin(scene: bpy.types.Scene, origin: np.ndarray, crs: str) -> np.ndarray:
    """Returns the scene's origin, (3,) float64; a scene that has none takes this one."""
    if "crs x" not in scene or "crs y" not in scene:
        scene["crs x"], scene["crs y"] = float(origin[0]), float(origin[1])
        scene["pointsplat_crs_z"] = float(origin[2])
        if crs.upper().startswith("EPSG:"):
            scene["SRID"] = crs
    return np.array([scene["crs x"], scene["crs y"], scene.get("pointsplat_crs_z", 0.0)], np.float64)


def with_points(name: str, count: int) -> Any:
    """Returns a point cloud of so many points, or a mesh of as many vertices where point clouds cannot be resized."""
    if hasattr(bpy.types.PointCloud, "resize"):
        data = bpy.data.pointclouds.new(name)
        data.resize(count)
    else:
        data = bpy.data.meshes.new(name)
        data.vertices.add(count)
    return data


def as_object(name: str, data: Any) -> bpy.types.Object:
    """Returns the object, in no collection, of a point cloud; of a mesh, which becomes one.

    Positions are to be there: Blender 4.5 keeps the bounds that a mesh had when it became a point cloud.
    """
    ob = bpy.data.objects.new(name, data)
    if isinstance(data, bpy.types.PointCloud):
        return ob
    scene = bpy.context.scene
    scene.collection.objects.link(ob)
    try:
        with bpy.context.temp_override(
            object=ob, active_object=ob, selected_objects=[ob], selected_editable_objects=[ob]
        ):
            bpy.context.view_layer.objects.active = ob
            ob.select_set(True)
            bpy.ops.object.convert(target="POINTCLOUD")
    finally:
        scene.collection.objects.unlink(ob)
    if data.users == 0:
        bpy.data.meshes.remove(data)
    ob.data.name = name
    return ob


def _write(data: Any, name: str, values: np.ndarray) -> None:
    """Write an attribute of the points, (N,) or (N, 3)."""
    if len(values) == 0:
        return
    if name == "position":
        data.attributes["position"].data.foreach_set("vector", values.reshape(-1))
        return
    if values.ndim == 2 and values.shape[1] != 3:
        for column in range(values.shape[1]):
            _write(data, f"{name}_{column + 1}", np.ascontiguousarray(values[:, column]))
        return
    kind = _kind(values)
    key, dtype = KINDS[kind]
    attribute = data.attributes.get(name)
    if attribute is None or attribute.data_type != kind:
        attribute = data.attributes.new(name, kind, "POINT")
    attribute.data.foreach_set(key, np.ascontiguousarray(values, dtype).reshape(-1))


def _kind(values: np.ndarray) -> str:
    """Blender's type of attribute that holds the values with the fewest bytes."""
    if values.ndim == 2:
        return "FLOAT_VECTOR"
    if values.dtype.kind == "f":
        return "FLOAT"
    low, high = int(values.min()), int(values.max())
    for kind in ("INT8", "INT"):
        limits = np.iinfo(KINDS[kind][1])
        if limits.min <= low and high <= limits.max:
            return kind
    return "FLOAT"


def _write_color(data: Any, color: np.ndarray) -> None:
    """Write colours (N, 4), sRGB: uint8 as bytes, float32 scene-linear."""
    if len(color) == 0:
        return
    if color.dtype == np.uint8:
        attribute = data.attributes.new(COLOR, "BYTE_COLOR", "POINT")
        pointer = ctypes.cast(attribute.data[0].as_pointer(), ctypes.POINTER(ctypes.c_uint8))
        np.ctypeslib.as_array(pointer, (len(color), 4))[:] = color
    else:
        attribute = data.attributes.new(COLOR, "FLOAT_COLOR", "POINT")
        linear = np.concatenate([linear_from_srgb(color[:, :3]), color[:, 3:]], axis=1)
        attribute.data.foreach_set("color", linear.astype(np.float32).reshape(-1))
    data.attributes.active_color = attribute
