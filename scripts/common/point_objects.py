"""PointCloud objects for the scripts, in every Blender that PointSplat runs in."""

import bpy
import numpy as np


def point_cloud_object(
    name: str,
    position: np.ndarray,
    radius: np.ndarray | float,
    color: np.ndarray | None = None,
    kind: str = "BYTE_COLOR",
) -> bpy.types.Object:
    """Points in the scene's collection: position (N, 3), radius (N,) or one for all, color (N, 3) scene-linear, which
    becomes the attribute "Color" of a kind that Blender has (BYTE_COLOR keeps what lies in 0..1)."""
    count = len(position)
    if hasattr(bpy.types.PointCloud, "resize"):
        points = bpy.data.pointclouds.new(name)
        points.resize(count)
        points.attributes["position"].data.foreach_set("vector", np.ascontiguousarray(position, np.float32).ravel())
        item = bpy.data.objects.new(name, points)
    else:  # until Blender 4.5 points come from a mesh alone
        points = bpy.data.meshes.new(name)
        points.vertices.add(count)
        points.vertices.foreach_set("co", np.ascontiguousarray(position, np.float32).ravel())
        item = bpy.data.objects.new(name, points)
    radii = points.attributes.get("radius") or points.attributes.new("radius", "FLOAT", "POINT")
    radii.data.foreach_set("value", np.broadcast_to(np.asarray(radius, np.float32), count).copy())
    if color is not None:
        painted = np.ones((count, 4), np.float32)
        painted[:, :3] = color
        points.attributes.new("Color", kind, "POINT").data.foreach_set("color", painted.ravel())
    bpy.context.scene.collection.objects.link(item)
    if item.type == "MESH":
        bpy.ops.object.select_all(action="DESELECT")
        bpy.context.view_layer.objects.active = item
        item.select_set(True)
        bpy.ops.object.convert(target="POINTCLOUD")
        item = bpy.context.object
        bpy.data.meshes.remove(points)
    return item
