"""Lists the polygons of a view mesh by mesh, those of small ones page by page, without the instances that lie outside
of the picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from ....core.numeric.record import record
from ....core.scene.scene import Instances, Scene
from ...device.protocol import Device, released_on_failure
from ...passes.uniforms import SampleView
from ...passes.visibility.polygon_draw import Drawn, PolygonDraw, block_draws
from ...passes.visibility.polygon_mesh import CHUNK, PolygonMesh
from ...passes.visibility.polygon_page import PolygonPage
from ...passes.visibility.small_triangles import are_small
from ...prepare.prepare import Prepared
from ..uploads.polygons import PolygonUploads
from .boxes_in_picture import places_in_picture


class PolygonSource(Protocol):
    """What is on the device of a scene, and which of its instances a view draws as polygons."""

    scene: Scene
    prepared: Prepared
    polygons: PolygonUploads


@record
class PolygonsInView:
    """The instances in the picture of one mesh, or of the meshes of one page; of a large mesh with one instance there,
    its chunks, each as if it were an instance."""

    source: PolygonMesh | PolygonPage
    member: np.ndarray  # (I,) int: which mesh of the page, or chunk of the mesh
    instance: np.ndarray  # (I,) int: row of the scene's instances
    view_from_object: np.ndarray  # (I, 4, 4) float64, from positions relative to the mesh's origin
    holdout: np.ndarray  # (I,) int: see _holdout
    rectangle: np.ndarray  # (I, 4) float64: see `places_in_picture`
    depth: np.ndarray  # (I, 2) float64: nearest and farthest of the box
    triangles: np.ndarray  # (I,) int
    small: bool  # most triangles cover few cells
    chunked: bool

    def those(self, which: np.ndarray) -> PolygonsInView:
        """Returns some instances, (I,) bool or their rows, which are drawn as they are among all."""
        names = ("member", "instance", "view_from_object", "holdout", "rectangle", "depth", "triangles")
        return replace(self, **{name: getattr(self, name)[which] for name in names})


def polygon_draws(
    device: Device, uploads: PolygonSource, view: SampleView, first_id: int, cells: tuple[int, int] | None
) -> list[Drawn]:
    """Returns what a view draws of each mesh. `first_id`: the number of the first triangle. `cells`: of the
    picture; None: the rasteriser draws all."""
    return draws_of(device, polygons_in_view(device, uploads, view, cells), first_id)


def draws_of(device: Device, shown: Sequence[PolygonsInView], first_id: int) -> list[Drawn]:
    """Returns what is drawn of each mesh and page. `first_id`: the number of the first triangle."""
    found: list[Drawn] = []
    with released_on_failure(device):
        for some in shown:
            if not len(some.instance):
                continue
            if isinstance(some.source, PolygonPage):
                about = some.member, some.instance, some.view_from_object, some.holdout
                found += block_draws(device, some.source, *about, first_id, some.small)
            else:
                one, chunks = (slice(1), some.member) if some.chunked else (slice(None), None)
                made = some.instance[one], some.view_from_object[one], some.holdout[one], first_id, some.small, chunks
                found.append(PolygonDraw(device, some.source, *made))
            first_id = found[-1].first_id + found[-1].triangles if found else first_id
    return found


def polygons_in_view(
    device: Device, uploads: PolygonSource, view: SampleView, cells: tuple[int, int] | None
) -> list[PolygonsInView]:
    """Returns the instances of each page and mesh that may lie in the picture. `cells`: see `polygon_draws`."""
    instances, shown = uploads.scene.instances, uploads.prepared.polygons
    found: list[PolygonsInView] = []

    def add(source: PolygonMesh | PolygonPage, member: np.ndarray, here: np.ndarray) -> None:
        page = isinstance(source, PolygonPage)
        origin, box = (source.origin[member], source.box[member]) if page else (source.origin, source.box)
        matrices = _from_origins(uploads.prepared.view_from_object[here], origin)
        rectangle, depth = places_in_picture(box, matrices, view)
        seen = np.flatnonzero((rectangle[:, 2:] > rectangle[:, :2]).all(axis=1))
        if not len(seen):
            return
        rectangle, here = rectangle[seen], here[seen]
        triangles = np.diff(source.first)[member[seen]] if page else np.full(len(seen), source.triangles)
        small = False
        if cells is not None and device.limits.image_atomics:
            small = are_small(int(triangles.sum()), rectangle, cells)
        holdout = _holdout(instances, here)
        about = member[seen], here, matrices[seen], holdout, rectangle, depth[seen], triangles
        made = PolygonsInView(source, *about, small, False)
        found.append(_by_chunks(made, view) if not page and len(seen) == 1 else made)

    for paged in uploads.polygons.pages:
        member = paged.member[instances.geometry[shown]]
        add(paged.page, member[member >= 0], shown[member >= 0])
    if uploads.polygons.meshes:
        is_shown = np.zeros(len(instances), bool)
        is_shown[shown] = True
        of_each = instances.of_each(len(uploads.scene.geometries), is_shown)
        for row, mesh in uploads.polygons.meshes.items():
            add(mesh, np.zeros(len(of_each[row]), np.int64), of_each[row])
    return found


def _by_chunks(whole: PolygonsInView, view: SampleView) -> PolygonsInView:
    """Returns the chunks in the picture of the one instance of a mesh; the mesh as it is if it has none."""
    groups = whole.source.groups
    boxes = [group.chunks for group in groups if group.chunks is not None]
    if not boxes:
        return whole
    box = np.concatenate(boxes)
    every = np.zeros(len(box), np.int64)
    rectangle, depth = places_in_picture(box, whole.view_from_object[every], view)
    counts = [(group.count // 3, len(of_group)) for group, of_group in zip(groups, boxes, strict=True)]
    triangles = [np.minimum(count - CHUNK * np.arange(chunks), CHUNK) for count, chunks in counts]
    chunks = replace(
        whole.those(every), member=np.arange(len(box)), rectangle=rectangle, depth=depth,
        triangles=np.concatenate(triangles), chunked=True,
    )  # fmt: skip
    return chunks.those((rectangle[:, 2:] > rectangle[:, :2]).all(axis=1))


def _from_origins(view_from_object: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Returns matrices (I, 4, 4) from positions relative to origins (3,) or (I, 3)."""
    matrices = view_from_object.copy()
    matrices[:, :3, 3] += (matrices[:, :3, :3] @ origin[..., None])[..., 0]
    return matrices


def _holdout(instances: Instances, rows: np.ndarray) -> np.ndarray:
    """Returns which instances (I,) cut holes, 1, and which are mattes, 2: (I,) int."""
    holdout = np.zeros(len(rows), int) if instances.holdout is None else instances.holdout[rows].astype(int)
    return holdout if instances.matte is None else np.where(instances.matte[rows], 2, holdout)
