"""Blender's cameras and viewports as cameras of core."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np

from ...core.scene.camera import Aperture, Camera

LEAST_FOCUS = 1e-5  # world units: replaces a focus distance of zero
HIGH_RESOLUTION = 1.5  # Blender's pixel size from which on its own engines draw viewports with half as many pixels
LEAST_STOP = 1e-5  # the smallest F-stop, as in Cycles


def render_camera(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> tuple[Camera, list[str]]:
    """The camera of a final render with its border, and warnings. Raises ValueError if the scene has no camera."""
    obj = engine.camera_override or depsgraph.scene.camera
    if obj is None:
        raise ValueError(f'The scene "{depsgraph.scene.name}" has no camera')
    obj = obj.evaluated_get(depsgraph)
    world_from_object = np.array(engine.camera_model_matrix(obj))
    return _from_object(obj, world_from_object, depsgraph, engine.resolution_x, engine.resolution_y), _warnings(obj)


def viewport_camera(context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> Camera:
    """The camera of the viewport that is being drawn, with its border and, in camera view, its lens."""
    rv3d, space = context.region_data, context.space_data
    camera = from_view(context.region, rv3d, space, depsgraph.scene)
    obj = _looked_through(rv3d, space, depsgraph.scene)
    if obj is None or obj.type != "CAMERA":
        return camera
    return replace(camera, aperture=aperture_of(obj.evaluated_get(depsgraph), camera.view_from_world, depsgraph))


def from_camera_object(obj: bpy.types.Object, depsgraph: bpy.types.Depsgraph, width: int, height: int) -> Camera:
    """The camera of an image of width x height pixels without a render engine, for scripts."""
    obj = obj.evaluated_get(depsgraph)
    return _from_object(obj, np.array(obj.matrix_world), depsgraph, width, height)


def from_view(
    region: bpy.types.Region,
    rv3d: bpy.types.RegionView3D,
    space: bpy.types.SpaceView3D,
    scene: bpy.types.Scene,
) -> Camera:
    """The camera of a viewport without its lens, with its border; in camera view, with the scene's border."""
    clip_from_view = np.array(rv3d.window_matrix, float)
    near, far = clip_range(clip_from_view)
    obj = _looked_through(rv3d, space, scene)
    return Camera(
        view_from_world=np.array(rv3d.view_matrix, float),
        clip_from_view=clip_from_view,
        resolution=(region.width, region.height),
        region=_view_border(region, rv3d, space, scene, obj),
        near=near,
        far=far,
    )


def pixel_size(render: bpy.types.RenderSettings) -> int:
    """How many pixels of a viewport one of the picture takes each way: the scene's Pixel Size, as for Cycles."""
    if render.preview_pixel_size == "AUTO":
        return 2 if bpy.context.preferences.system.pixel_size > HIGH_RESOLUTION else 1
    return int(render.preview_pixel_size)


def _looked_through(
    rv3d: bpy.types.RegionView3D, space: bpy.types.SpaceView3D, scene: bpy.types.Scene
) -> bpy.types.Object | None:
    """The camera of a viewport in camera view; None in other views."""
    obj = space.camera if space.use_local_camera else scene.camera
    return obj if rv3d.view_perspective == "CAMERA" else None


def aperture_of(obj: bpy.types.Object, view_from_world: np.ndarray, depsgraph: bpy.types.Depsgraph) -> Aperture | None:
    """The aperture of an evaluated camera object as in Cycles; None if it has no depth of field.

    Its diameter is the focal length over the F-stop, where the focal length is in thousandths of a Blender unit
    whatever the scene's unit is; orthographic cameras have a focal length of one Blender unit.
    """
    data = obj.data
    if data.type not in {"PERSP", "ORTHO"} or not data.dof.use_dof:
        return None
    dof = data.dof
    focal_length = data.lens / 1000 if data.type == "PERSP" else 1.0
    return Aperture(
        radius=focal_length / (2 * max(dof.aperture_fstop, LEAST_STOP)),
        focus=max(_focus(dof, view_from_world, depsgraph), LEAST_FOCUS),
        blades=dof.aperture_blades if dof.aperture_blades >= 3 else 0,
        rotation=dof.aperture_rotation,
        ratio=max(dof.aperture_ratio, 0.01),
    )


def _focus(dof: bpy.types.CameraDOFSettings, view_from_world: np.ndarray, depsgraph: bpy.types.Depsgraph) -> float:
    """Distance along the view direction to the plane in focus, in world units.

    As in Cycles, an object behind the camera counts as if it were at the same distance in front of it.
    """
    if dof.focus_object is None:
        return dof.focus_distance
    target = dof.focus_object.evaluated_get(depsgraph)
    world_from_target = target.matrix_world
    if target.pose is not None and dof.focus_subtarget in target.pose.bones:
        world_from_target = world_from_target @ target.pose.bones[dof.focus_subtarget].matrix
    return abs(float(view_from_world[2, :3] @ np.array(world_from_target.translation) + view_from_world[2, 3]))


def clip_range(clip_from_view: np.ndarray) -> tuple[float, float]:
    """Distances (near, far) of the clipping planes of an OpenGL projection (4, 4); far may be infinite."""
    m, t = clip_from_view[2, 2], clip_from_view[2, 3]
    if clip_from_view[3, 2] != 0:
        # A far plane that float32 cannot tell from infinity.
        return t / (m - 1), t / (m + 1) if m < -1 else float("inf")
    return (t + 1) / m, (t - 1) / m


def _from_object(
    obj: bpy.types.Object, world_from_object: np.ndarray, depsgraph: bpy.types.Depsgraph, width: int, height: int
) -> Camera:
    render = depsgraph.scene.render
    length = np.linalg.norm(world_from_object[:3, :3], axis=0)
    # A camera scaled to zero has no directions: core/scene/validation.py reports it.
    rotation = world_from_object[:3, :3] / np.where(length > 0, length, 1.0)
    view_from_world = np.eye(4)
    # The transpose rather than a general inverse: exactly rigid whatever float32 made of the matrix.
    view_from_world[:3, :3] = rotation.T
    view_from_world[:3, 3] = -rotation.T @ world_from_object[:3, 3]
    clip_from_view = obj.calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    return Camera(
        view_from_world=view_from_world,
        clip_from_view=np.array(clip_from_view, float),
        resolution=(width, height),
        region=_render_border(render, width, height),
        near=obj.data.clip_start,
        far=obj.data.clip_end,
        aperture=aperture_of(obj, view_from_world, depsgraph),
    )


def _render_border(render: bpy.types.RenderSettings, width: int, height: int) -> tuple[int, int, int, int] | None:
    """The border of a final render as (x, y, width, height) in pixels; None without a border."""
    if not render.use_border:
        return None
    # Multiplied in float32 and truncated, as Blender does: anything else asks for a result of another size.
    corners = (render.border_min_x, render.border_min_y), (render.border_max_x, render.border_max_y)
    low, high = (np.array(corners, np.float32) * np.array((width, height), np.float32)).astype(int)
    extent = np.maximum(high - low, 0)
    return int(low[0]), int(low[1]), int(extent[0]), int(extent[1])


def _view_border(
    region: bpy.types.Region,
    rv3d: bpy.types.RegionView3D,
    space: bpy.types.SpaceView3D,
    scene: bpy.types.Scene,
    camera: bpy.types.Object | None,
) -> tuple[int, int, int, int] | None:
    """The border of a viewport as (x, y, width, height) in pixels; None without a border."""
    size = np.array([region.width, region.height])
    low, high = np.zeros(2), size.astype(float)
    if camera is not None:
        owner = scene.render
        if not owner.use_border:
            return None
        low, high = _camera_frame(rv3d, scene, camera, size)
    else:
        owner = space
        if not space.use_render_border:
            return None
    names = ("border_min_x", "border_min_y", "border_max_x", "border_max_y")
    prefix = "" if camera is not None else "render_"
    border = np.array([getattr(owner, prefix + name) for name in names]).reshape(2, 2)
    first, last = np.clip(np.rint(low + border * (high - low)), 0, size).astype(int)
    return int(first[0]), int(first[1]), int(max(last[0] - first[0], 0)), int(max(last[1] - first[1], 0))


def _camera_frame(
    rv3d: bpy.types.RegionView3D, scene: bpy.types.Scene, camera: bpy.types.Object, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Lower left and upper right corner of the camera's frame in the region, in pixels."""
    corners = np.array(camera.data.view_frame(scene=scene))
    clip = np.column_stack([corners, np.ones(len(corners))]) @ np.array(rv3d.window_matrix).T
    pixels = (clip[:, :2] / clip[:, 3:] + 1) / 2 * size
    return pixels.min(0), pixels.max(0)


def _warnings(obj: bpy.types.Object) -> list[str]:
    if obj.data.type in {"PERSP", "ORTHO"}:
        return []
    return [f'Camera "{obj.name}": a {obj.data.type.lower()} camera is not supported and is drawn in perspective']
