"""What is true of the scenes of scripts/error_vs_time/measure.py that have no polygons, by rays in float64."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from functools import partial
from typing import Any, cast
from unittest import mock

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.render.frame.sample_positions import offsets

TRUTH = 256  # samples, or rays through each pixel
VOXELS = 96  # pixels of what is voxels: the plume of smoke and the brain
EXTINCTION = 3.0  # of voxels where the density is 1, per unit: they are two units high


def pattern(p: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) at places of the unit sphere: waves, and squares with edges."""
    x, y, z = p.T
    squares = (np.floor(6 * x + 0.5) + np.floor(6 * y + 0.5) + np.floor(6 * z + 0.5)) % 2
    waves = np.stack([np.sin(9 * x) * np.cos(7 * y), np.sin(8 * z), np.cos(11 * y + 5 * z)], axis=1)
    return 0.35 + 0.2 * waves + 0.3 * squares[:, None]


def sphere_truth(camera: Camera, samples: int = TRUTH) -> np.ndarray:
    """The unit sphere of `pattern` by its rays, (H, W, 3): the pixel's filter by as many places."""
    width, height = camera.resolution
    fx, fy, cx, cy = camera.pixel_from_view()
    world = np.linalg.inv(camera.view_from_world)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    total = np.zeros((height * width, 3))
    for u, v in offsets(samples):
        direction = np.stack([(x + u - cx) / fx, (y + v - cy) / fy, np.full(x.shape, -1.0)], axis=-1).reshape(-1, 3)
        direction = direction @ world[:3, :3].T
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        along = -direction @ world[:3, 3]
        inside = along**2 - world[:3, 3] @ world[:3, 3] + 1
        hit = np.flatnonzero(inside > 0)
        total[hit] += pattern(world[:3, 3] + (along[hit] - np.sqrt(inside[hit]))[:, None] * direction[hit])
    return (total / samples).reshape(height, width, 3)


def balls_truth(
    camera: Camera, position: np.ndarray, radius: np.ndarray, color: np.ndarray, samples: int
) -> np.ndarray:
    """(H, W, 3) float64: the nearest of N balls along each ray, of radiance `color` (N, 3), before black. Balls lie in
    front of the camera, and their pictures are little wider than they were in the middle of its picture."""
    width, height = camera.resolution
    fx, fy, cx, cy = camera.pixel_from_view()
    centre = position.astype(float) @ camera.view_from_world[:3, :3].T + camera.view_from_world[:3, 3]
    middle = np.stack([cx - fx * centre[:, 0] / centre[:, 2], cy - fy * centre[:, 1] / centre[:, 2]], axis=1)
    wide = -1.1 * max(fx, fy) * radius / centre[:, 2]
    reach = int(np.ceil(wide.max() + 0.5))
    beside = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), axis=-1).reshape(-1, 2)
    inside = radius**2 - (centre**2).sum(axis=1)
    total = np.zeros((height * width, 3))
    for shift in offsets(samples):
        first = np.floor(middle - shift)
        places = (first[:, None] + beside).reshape(-1, 2)
        apart = places.reshape(len(first), -1, 2) - (middle - shift - 0.5)[:, None]
        near = (apart**2).sum(axis=2) < wide[:, None] ** 2
        near = np.flatnonzero(near.reshape(-1) & ((places >= 0) & (places < (width, height))).all(axis=1))
        ball, place = near // len(beside), places[near]
        pixel = (place[:, 1] * width + place[:, 0]).astype(int)
        across = (place + 0.5 + shift - (cx, cy)) / (fx, fy)
        square = (across**2).sum(axis=1) + 1
        along = (across * centre[ball, :2]).sum(axis=1) - centre[ball, 2]
        met = along**2 + square * inside[ball]
        hit = np.flatnonzero(met > 0)
        depth = (along[hit] - np.sqrt(met[hit])) / square[hit]
        nearest = np.full(height * width, np.inf)
        np.minimum.at(nearest, pixel[hit], depth)
        seen = hit[depth == nearest[pixel[hit]]]
        total[pixel[seen]] += color[ball[seen]]
    return (total / samples).reshape(height, width, 3)


def voxels_of(item: Any) -> tuple[np.ndarray, np.ndarray]:
    """Densities (X, Y, Z) float32 of a volume object's file, and its (4, 4) object_from_index of them."""
    vdb = importlib.import_module("scripts.common.volume_objects").openvdb()
    grid = vdb.read(item.data.filepath, "density")
    low, high = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
    values = np.empty(high - low + 1, np.float32)
    grid.copyToArray(values, ijk=tuple(int(i) for i in low))
    matrix = np.eye(4)
    matrix[:3, 3] = grid.transform.indexToWorld(tuple(float(i) for i in low))
    for axis in range(3):
        beside = low + np.eye(3, dtype=int)[axis]
        matrix[:3, axis] = np.array(grid.transform.indexToWorld(tuple(float(i) for i in beside))) - matrix[:3, 3]
    return values, matrix


def voxel_field() -> tuple[np.ndarray, np.ndarray]:
    """Densities and (4, 4) world_from_index of the volume in the open scene."""
    import bpy

    item = next(o for o in bpy.context.scene.objects if o.type == "VOLUME")
    values, object_from_index = voxels_of(item)
    return values, np.array(item.matrix_world) @ object_from_index


def voxel_truth() -> np.ndarray:
    """What the voxels let through, trilinear, along rays that are spread as the pixel's filter: by the midpoints of
    steps of less than a voxel."""
    import bpy

    from scripts.common import media_truth as reference

    values, world_from_index = voxel_field()
    field = reference.voxels(values, world_from_index, EXTINCTION)
    count = 8
    origins, directions = filtered_rays(bpy.context.scene, count)
    near, far = field.interval(origins, directions)
    steps = 2 * max(values.shape)  # rays cross it sideways
    part = (np.arange(steps) + 0.5) / steps
    through = np.ones(len(origins))
    for some in np.array_split(np.flatnonzero(far > near), 256):
        along = near[some, None] + (far - near)[some, None] * part
        places = origins[some, None] + along[..., None] * directions[some, None]
        extinction = field.extinction(places.reshape(-1, 3))[:, 0].reshape(along.shape)
        through[some] = np.exp(-extinction.mean(axis=1) * (far - near)[some])
    picture = through.reshape(VOXELS, VOXELS, count**2).mean(axis=2)
    return np.repeat(picture[..., None], 3, axis=2)


def filtered_rays(scene: Any, samples: int, even: Callable | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (H * W * samples^2, 3) of a scene's rays, spread as the pixel's filter. `even`: what
    gives those through the centres of pixels."""
    if even is None:
        even = cast(Callable, importlib.import_module("scripts.studies.media").rays)
    forward = np.array(scene.camera.matrix_world)[:3, 2]
    origins, direction = even(scene, 1)
    side = scene.render.resolution_x
    grid = direction.reshape(side, side, 3) / -(direction @ forward).reshape(side, side, 1)
    right, up = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    spread = offsets(samples**2)
    rays = grid[:, :, None] + spread[:, :1] * right + spread[:, 1:] * up
    rays = rays.reshape(-1, 3) / np.linalg.norm(rays.reshape(-1, 3), axis=1, keepdims=True)
    return np.broadcast_to(origins[0], rays.shape), rays


def smoke_truth() -> np.ndarray:
    """Marched in float64, along rays that are spread as the pixel's filter."""
    import bpy

    media = importlib.import_module("scripts.studies.media")
    with mock.patch.object(media, "rays", partial(filtered_rays, even=media.rays)):
        return media.sphere_truth(bpy.context.scene, "absorbing", 4)
