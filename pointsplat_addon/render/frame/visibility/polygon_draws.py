"""Lists the polygons of a view mesh by mesh, those of small ones page by page, without the instances that lie outside
of the picture."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ....core.scene.bounds import box_corners
from ....core.scene.scene import Instances, Scene
from ...device.protocol import Device, released_on_failure
from ...passes.uniforms import SampleView
from ...passes.visibility.polygon_draw import Drawn, PolygonDraw, block_draws
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
) -> list[Drawn]:
    """Returns what a view draws of each mesh. `first_id`: the number of the first triangle. `cells`: of the
    picture; None: the rasteriser draws all."""
    with released_on_failure(device):
        return _polygon_draws(device, uploads, view, first_id, cells)


def _polygon_draws(
    device: Device, uploads: PolygonSource, view: SampleView, first_id: int, cells: tuple[int, int] | None
) -> list[Drawn]:
    """See `polygon_draws`; where the device refuses one, those before it stay."""
    instances, shown = uploads.scene.instances, uploads.prepared.polygons
    found: list[Drawn] = []
    for paged in uploads.polygons.pages:
        member = paged.member[instances.geometry[shown]]
        here, member = shown[member >= 0], member[member >= 0]
        matrices = _from_origins(uploads.prepared.view_from_object[here], paged.page.origin[member])
        rectangles = rectangles_in_picture(paged.page.box[member], matrices, view)
        seen = (rectangles[:, 2:] > rectangles[:, :2]).all(axis=1)
        holdout = _holdout(instances, here[seen])
        found += block_draws(device, paged.page, member[seen], here[seen], matrices[seen], holdout, first_id)
        first_id = found[-1].first_id + found[-1].triangles if found else first_id
    for row, mesh in uploads.polygons.meshes.items():
        here = shown[instances.geometry[shown] == row]
        if not len(here):
            continue
        matrices = _from_origins(uploads.prepared.view_from_object[here], mesh.origin)
        rectangles = rectangles_in_picture(mesh.box, matrices, view)
        seen = (rectangles[:, 2:] > rectangles[:, :2]).all(axis=1)
        if not seen.any():
            continue
        here = here[seen]
        holdout = _holdout(instances, here)
        small = cells is not None and are_small(mesh.triangles, rectangles[seen], cells) and device.limits.image_atomics
        found.append(PolygonDraw(device, mesh, here, matrices[seen], holdout, first_id, small))
        first_id += found[-1].triangles
    return found


def _from_origins(view_from_object: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Returns matrices (I, 4, 4) from positions relative to origins (3,) or (I, 3)."""
    matrices = view_from_object.copy()
    matrices[:, :3, 3] += (matrices[:, :3, :3] @ origin[..., None])[..., 0]
    return matrices


def _holdout(instances: Instances, rows: np.ndarray) -> np.ndarray:
    """Returns whether instances (I,) cut holes, (I,) bool."""
    return np.zeros(len(rows), bool) if instances.holdout is None else instances.holdout[rows].astype(bool)


def rectangles_in_picture(box: np.ndarray, view_from_object: np.ndarray, view: SampleView) -> np.ndarray:
    """Returns rectangles, (I, 4) float64, that hold a box in the picture for each transform: low and high corner, from
    0 to 1 over the picture; where all of the box lies outside, the high corner is not above the low one.

    box: (2, 3) or (I, 2, 3), low and high corner in object space. view_from_object: (I, 4, 4).
    """
    corners = box_corners(box[..., 0, :], box[..., 1, :])
    fx, fy = view.camera.pixel_from_view()[:2]
    with np.errstate(all="ignore"):
        p = corners @ view_from_object[:, :3, :3].swapaxes(1, 2) + view_from_object[:, None, :3, 3]
        depth = -p[..., 2]
        scale = 1 / depth if view.camera.perspective else np.ones_like(depth)
        pixels = np.stack([fx * p[..., 0] * scale, fy * p[..., 1] * scale], axis=-1) + view.principal_point
        found = np.concatenate([(pixels.min(axis=1) - 1) / view.size, (pixels.max(axis=1) + 1) / view.size], axis=1)
    across = (depth <= view.near).any(axis=1) & view.camera.perspective
    found[across | ~np.isfinite(found).all(axis=1)] = 0.0, 0.0, 1.0, 1.0
    found[(depth < view.near).all(axis=1) | (depth > view.far).all(axis=1)] = 0.0
    return np.clip(found, 0.0, 1.0)
