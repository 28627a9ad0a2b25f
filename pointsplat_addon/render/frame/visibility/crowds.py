"""Leaves out what a view cannot see of many instances, cell by cell, before the view is prepared.

What lies beside the picture goes first. Then what is near is drawn as far as it hides much, and what lies behind it
all over its box goes too (occlusion.py). All sub-samples that will be drawn count, so that pictures stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ....core.numeric.lattice import lattice_of
from ....core.numeric.pixel_filter import filter_reach
from ....core.scene.camera import Camera
from ....core.scene.scene import Scene
from ...device.clock import Clock
from ...passes.uniforms import SampleView, view_of
from ...passes.visibility.buffer import VisibilityBuffer
from ...plan.frame_plan import MOST_MARGIN, FramePlan, make_frame_plan
from ...plan.request import Request
from ...plan.valid import validated
from ...prepare.meshes.crowd import FEWEST, Crowd, crowd_of, with_seen
from ...prepare.prepare import Prepared
from ..resources import FrameResources
from ..sample_positions import lattice_offsets
from ..uploads.polygons import PolygonUploads
from ..uploads.scope import UploadScope
from .boxes_in_picture import places_in_picture
from .occluders import Occluders
from .occlusion import Candidates, hidden_of, is_behind
from .tiles import cells_of_tile, picture_tiles

WIDE = 128.0  # pixels: cells that are wider are looked at instance by instance from the start
MOST_TRIANGLES = 1 << 22  # that are drawn to find what they hide
MOST_LATTICES = 4  # of a picture: finding what all of them hide takes longer than it saves
BESIDE = MOST_MARGIN + 16  # pixels around the picture that count as seen: pictures may be drawn with a margin


def without_unseen(
    resources: FrameResources, scene: Scene, request: Request, clock: Clock, presented: bool, picture: bool
) -> tuple[Scene, bool]:
    """Returns a scene without instances that a view cannot see, and whether all that others may hide was looked at.

    `presented`, `picture`: see make_frame_plan.
    """
    store, limits = resources.store, resources.device.limits
    streamed = any(geometry.streamed is not None for geometry in scene.geometries)
    if len(scene.instances) < FEWEST or streamed or request.camera.aperture is not None:
        return scene, False
    scene, camera = validated(scene, request.camera, store)
    crowd = crowd_of(scene, store)
    if crowd is None:
        return scene, False
    cells, wide = _cells_in_view(crowd, view_of(_with_margin(camera, BESIDE)))
    near, every = crowd.members(cells[wide]), crowd.members(cells)
    in_view = with_seen(scene, crowd, every)
    fits = request.settings.technique in ("AUTO", "VISIBILITY") and request.moment[1] == 1
    if not fits or len(near) == 0:
        return in_view, False
    plain = replace(request.settings, use_shadows=False, use_indirect=False)
    asked = replace(request, passes=frozenset({"combined"}), settings=plain)
    plan = make_frame_plan(
        with_seen(scene, crowd, near), asked, store, limits, resources.costs, clock, presented, picture
    )
    drawn = plan.plan.polygons and plan.plan.sub_samples > 0 and plan.technique.name == "VISIBILITY"
    if not drawn or plan.request.samples > MOST_LATTICES or plan.prepared.out_of_focus is not None:
        return in_view, False
    others = np.ones(len(plan.scene.instances), bool)
    others[crowd.row] = False
    others = plan.prepared.polygons[others[plan.prepared.polygons]]
    seen = _not_hidden(resources, crowd, cells, plan, others, clock.run)
    # All that is drawn was looked at, where there is nothing else.
    return with_seen(scene, crowd, np.flatnonzero(seen)), len(others) == 0


@dataclass(eq=False)
class _Near:
    """What may hide others, on the device."""

    scene: Scene
    prepared: Prepared
    polygons: PolygonUploads
    others: np.ndarray  # (n,) int64: instances that are not of the crowd


def _not_hidden(
    resources: FrameResources,
    crowd: Crowd,
    cells: np.ndarray,
    plan: FramePlan,
    others: np.ndarray,
    run: Callable[[str, Callable[[], None]], None],
) -> np.ndarray:
    """Returns which of a crowd's instances are not known to be hidden in a picture, (N,) bool. cells: (c,) int, of
    those that may be seen. others: (n,) int, polygons that are not of the crowd, which hide it too."""
    device, of_plan, samples = resources.device, plan.plan, plan.request.samples
    lattice, reach = lattice_of(of_plan.sub_samples), filter_reach(of_plan.filter_size)
    most = cells_of_tile(plan.splats + plan.triangles, of_plan.presented, plan.streamed is not None)
    tiles = picture_tiles(plan.view.window[2:], lattice, device.limits.texture_size, most, reach)
    offsets = lattice_offsets(samples, lattice) if samples > 1 else np.zeros((1, 2))
    seen = np.zeros(len(crowd.row), bool)
    scope = UploadScope(resources.kept)
    buffer = None
    try:
        uploads = PolygonUploads(scope, resources.store, plan.scene, plan.prepared, of_plan, plan.view)
        near = _Near(plan.scene, plan.prepared, uploads, others)
        buffer = VisibilityBuffer(device, lattice, tiles[0].size)
        for number, (x, y) in enumerate(offsets):
            for tile in tiles:
                view = tile.view(view_of(plan.view, (float(x), float(y)), number))
                occluders = Occluders(device, buffer, of_plan.variant.normal, view, {}, run)
                try:
                    seen[_seen_in(crowd, cells, view, near, occluders)] = True
                finally:
                    occluders.release()
    finally:
        if buffer is not None:
            buffer.release()
        scope.release()
    return seen


def _seen_in(crowd: Crowd, cells: np.ndarray, view: SampleView, near: _Near, occluders: Occluders) -> np.ndarray:
    """Returns the items of a crowd, (n,) int, that are not known to be hidden in a view."""
    here, wide = _cells_in_view(crowd, view, cells)
    whole, items = here[~wide], crowd.members(here[wide])
    of_cells, _ = _candidates(*_places(crowd.cell_box[whole], view), crowd.cell_triangles[whole], view)
    of_items, shown = _items(crowd, items, view)
    items = items[shown]
    given = Candidates(*(
        np.concatenate([getattr(part, name) for part in (of_cells, of_items)])
        for name in ("low", "high", "nearest", "farthest", "work")
    ))  # fmt: skip
    found: list[np.ndarray] = []

    def draw(which: np.ndarray) -> np.ndarray:
        drawn = np.zeros(len(near.scene.instances), bool)
        drawn[crowd.row[items[which[len(whole) :]]]] = True
        drawn[near.others] = not found
        polygons = near.prepared.polygons[drawn[near.prepared.polygons]]
        found.append(occluders.draw_some(replace(near, prepared=replace(near.prepared, polygons=polygons))))
        return found[-1]

    hidden = hidden_of(given, view.size, draw, MOST_TRIANGLES)
    inside = crowd.members(whole[~hidden[: len(whole)]])
    if found:
        single, shown = _items(crowd, inside, view)
        inside = inside[shown][~is_behind(single, found[-1])]
    return np.concatenate([items[~hidden[len(whole) :]], inside])


def _cells_in_view(crowd: Crowd, view: SampleView, cells: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Returns the cells of a crowd, (c,) int, that may lie in a picture, and which of them are wide there, (c,) bool.
    cells: those that are asked about; None: all."""
    cells = np.arange(len(crowd.cell_box)) if cells is None else cells
    rectangle, _ = _places(crowd.cell_box[cells], view)
    size = (rectangle[:, 2:] - rectangle[:, :2]) * view.size
    shown = (size > 0).all(axis=1)
    return cells[shown], (size[shown] > WIDE).any(axis=1)


def _items(crowd: Crowd, items: np.ndarray, view: SampleView) -> tuple[Candidates, np.ndarray]:
    """Returns those of some items of a crowd that may lie in a picture, and which they are, (n,) int."""
    row = crowd.row[items]
    geometry, matrices = crowd.geometry[row], view.camera.view_from_world @ crowd.world_from_object[row]
    return _candidates(*places_in_picture(crowd.box[geometry], matrices, view), crowd.triangles[geometry], view)


def _candidates(
    rectangle: np.ndarray, depth: np.ndarray, work: np.ndarray, view: SampleView
) -> tuple[Candidates, np.ndarray]:
    """Returns what lies in a picture, and which it is, (n,) int. `rectangle`, `depth`: see places_in_picture."""
    shown = np.flatnonzero((rectangle[:, 2:] > rectangle[:, :2]).all(axis=1))
    rectangle, (nearest, farthest) = rectangle[shown], depth[shown].T
    low, high = rectangle[:, :2] * view.size, rectangle[:, 2:] * view.size
    return Candidates(low, high, nearest, farthest, work[shown].astype(np.float64)), shown


def _places(box: np.ndarray, view: SampleView) -> tuple[np.ndarray, np.ndarray]:
    """Returns `places_in_picture` of boxes in the world, (N, 2, 3)."""
    matrix = np.broadcast_to(view.camera.view_from_world, (len(box), 4, 4))
    return places_in_picture(box, matrix, view)


def _with_margin(camera: Camera, pixels: int) -> Camera:
    x, y, width, height = camera.window
    return replace(camera, region=(x - pixels, y - pixels, width + 2 * pixels, height + 2 * pixels))
