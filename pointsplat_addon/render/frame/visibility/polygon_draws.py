"""Lists the polygons of a view mesh by mesh, without the instances that lie outside of the picture."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ....core.scene.scene import Scene
from ...device.protocol import Device
from ...passes.uniforms import SampleView
from ...passes.visibility.polygon_ids import PolygonDraw
from ...passes.visibility.small_triangles import are_small
from ...prepare.prepare import Prepared
from ..uploads.polygons import PolygonUploads


class PolygonSource(Protocol):
    """What is on the device of a scene, and which of its instances a view draws as polygons."""

    scene: Scene
    prepared: Prepared
    polygons: PolygonUploads


def polygon_draws(
    device: Device, uploads: PolygonSource, view: SampleView, first_id: int, cells: tuple[int, int] | None
) -> list[PolygonDraw]:
    """Returns what a view draws of each mesh. `first_id`: the number of the first triangle. `cells`: of the
    picture; None: the rasteriser draws all."""
    instances, found = uploads.scene.instances, []
    shown = uploads.prepared.polygons
    for row, mesh in uploads.polygons.meshes.items():
        here = shown[instances.geometry[shown] == row]
        if not len(here):
            continue
        matrices = uploads.prepared.view_from_object[here].copy()
        matrices[:, :3, 3] += matrices[:, :3, :3] @ mesh.origin
        rectangles = rectangles_in_picture(mesh.box, matrices, view)
        seen = (rectangles[:, 2:] > rectangles[:, :2]).all(axis=1)
        if not seen.any():
            continue
        here = here[seen]
        holdout = np.zeros(len(here), bool) if instances.holdout is None else instances.holdout[here].astype(bool)
        small = cells is not None and are_small(mesh.triangles, rectangles[seen], cells) and device.limits.image_atomics
        found.append(PolygonDraw(device, mesh, here, matrices[seen], holdout, first_id, small))
        first_id += found[-1].triangles
    return found


def rectangles_in_picture(box: np.ndarray, view_from_object: np.ndarray, view: SampleView) -> np.ndarray:
    """Returns rectangles, (I, 4) float64, that hold a box in the picture for each transform: low and high corner, from
    0 to 1 over the picture; where all of the box lies outside, the high corner is not above the low one.

    box: (2, 3), low and high corner in object space. view_from_object: (I, 4, 4).
    """
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
    fx, fy = view.camera.pixel_from_view()[:2]
    with np.errstate(all="ignore"):
        p = np.einsum("iab,cb->ica", view_from_object[:, :3, :3], corners) + view_from_object[:, None, :3, 3]
        depth = -p[..., 2]
        scale = 1 / depth if view.camera.perspective else np.ones_like(depth)
        pixels = np.stack([fx * p[..., 0] * scale, fy * p[..., 1] * scale], axis=-1) + view.principal_point
        found = np.concatenate([(pixels.min(axis=1) - 1) / view.size, (pixels.max(axis=1) + 1) / view.size], axis=1)
    across = (depth <= view.near).any(axis=1) & view.camera.perspective
    found[across | ~np.isfinite(found).all(axis=1)] = 0.0, 0.0, 1.0, 1.0
    found[(depth < view.near).all(axis=1) | (depth > view.far).all(axis=1)] = 0.0
    return np.clip(found, 0.0, 1.0)
