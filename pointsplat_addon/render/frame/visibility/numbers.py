"""The numbers of all primitives of a picture in the visibility buffer, and where in the picture they are.

Splats come first, page by page (their uploads know their numbers), then triangles, instance by instance, then segments of
strands, geometry by geometry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...passes.strands.strand_ids import StrandIds
from ...passes.strands.strand_page import StrandDraw
from ...passes.uniforms import SampleView
from ...passes.visibility.polygon_ids import PolygonDraw
from ..uploads.uploads import Uploads

Rectangle = tuple[float, float, float, float]  # low and high corner, from 0 to 1 over the picture


@dataclass(frozen=True, eq=False)
class NumberedDraws:
    """What the hardware rasterises of one picture, with the number of each one's first primitive."""

    polygons: list[PolygonDraw]
    strands: list[StrandIds]


def number_draws(uploads: Uploads, view: SampleView) -> NumberedDraws:
    """Numbers triangles and segments of strands, and leaves out what lies outside of the picture."""
    first = sum(draw.elements for draw in uploads.points.draws)
    polygons, first = _polygons(uploads, view, first)
    return NumberedDraws(polygons, _strands(uploads, view, first))


def _polygons(uploads: Uploads, view: SampleView, first: int) -> tuple[list[PolygonDraw], int]:
    """Returns the triangles of all instances, and the first number after them."""
    found: list[PolygonDraw] = []
    instances = uploads.scene.instances
    for instance in uploads.prepared.polygons.tolist():
        mesh = uploads.polygons.meshes[int(instances.geometry[instance])]
        matrix = uploads.prepared.view_from_object[instance].copy()
        matrix[:3, 3] += matrix[:3, :3] @ mesh.origin
        rectangle = rectangle_in_picture(mesh.box, matrix, view)
        if rectangle is not None:
            holdout = bool(instances.holdout is not None and instances.holdout[instance])
            parts = uploads.polygons.part_lists.get(instance)
            found.append(PolygonDraw(mesh, instance, matrix, holdout, first, rectangle, parts))
        first += mesh.triangles
    return found, first


def _strands(uploads: Uploads, view: SampleView, first: int) -> list[StrandIds]:
    found: list[StrandIds] = []
    for draw in uploads.strands.draws:
        rectangle = _rectangle_of_strands(draw, uploads.prepared.view_from_object, view)
        for kind, (_, count) in draw.lists().items():
            if rectangle is not None:
                found.append(StrandIds(draw, kind, first, rectangle))
            first += count
    return found


def _rectangle_of_strands(draw: StrandDraw, view_from_object: np.ndarray, view: SampleView) -> Rectangle | None:
    """Returns a rectangle that holds all instances of a geometry's strands; None: it is outside the picture."""
    bounds, matrices = draw.page.strands.bounds, view_from_object[np.unique(draw.segments.instance)]
    middle = matrices[:, :3, :3] @ bounds.center + matrices[:, :3, 3]
    reach = bounds.radius * np.linalg.norm(matrices[:, :3, :3], 2, axis=(1, 2))[:, None]
    box = np.array([(middle - reach).min(axis=0), (middle + reach).max(axis=0)])
    return rectangle_in_picture(box, np.eye(4), view)


def rectangle_in_picture(
    box: np.ndarray, view_from_object: np.ndarray, view: SampleView
) -> Rectangle | None:
    """Returns the low and the high corner, from 0 to 1 over the picture, of a rectangle that holds what is in a box.

    box: (2, 3), in object space. view_from_object: (4, 4). None: all of it is outside the picture.
    """
    whole = 0.0, 0.0, 1.0, 1.0
    corners = np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)
    with np.errstate(all="ignore"):
        p = corners @ view_from_object[:3, :3].T + view_from_object[:3, 3]
        depth = -p[:, 2]
        if not np.isfinite(p).all():
            return whole
        if (depth < view.near).all() or (depth > view.far).all():
            return None
        if view.camera.perspective and (depth <= view.near).any():
            return whole
        fx, fy = view.camera.pixel_from_view()[:2]
        scale = 1 / depth if view.camera.perspective else np.ones(len(p))
        pixels = np.stack([fx * p[:, 0] * scale, fy * p[:, 1] * scale], axis=1) + view.principal_point
    low, high = (pixels.min(axis=0) - 1) / view.size, (pixels.max(axis=0) + 1) / view.size
    if (low >= 1).any() or (high <= 0).any():
        return None
    low, high = np.clip(low, 0, 1), np.clip(high, 0, 1)
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])
