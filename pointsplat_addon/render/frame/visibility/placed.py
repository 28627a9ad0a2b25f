"""Evaluates material graphs that no picture shows at the places that stand for groups of sub-samples.

Procedural textures, and images that are mapped by other coordinates than a UV map, change within triangles. They are
evaluated where they are seen, once for each group, over the footprint of a pixel, by the processor: material graphs are
expressions of NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....core.numeric.lattice import Lattice
from ....core.numeric.vectors import unit_rows
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Scene
from ....core.surface.appearance import graphs_of
from ....core.surface.footprints import footprints, over_footprints
from ....core.surface.samples import Samples
from ...device.protocol import CHANNELS, EMPTY, Device, Texture
from ...passes.gbuffer import Variant
from ...passes.grouping.groups import Groups, Leaders
from ...passes.uniforms import SampleView
from ...passes.visibility.buffer import RASTERISED
from ...passes.visibility.polygon_draw import Drawn
from ...passes.visibility.polygon_mesh import PLACED

GRAZING = 1e-2  # cosine: footprints of surfaces that are seen at a lower angle are as long as at this one


def placed_textures(
    device: Device,
    scene: Scene,
    draws: Sequence[Drawn],
    variant: Variant,
    view: SampleView,
    lattice: Lattice,
    groups: Groups,
    leaders: Leaders,
) -> dict[str, Texture]:
    """Returns what graphs are at the places that stand for groups, in textures as long as the list of these, by sampler
    name; those of PLACED that are needed. The caller releases them."""
    shown = [draw for draw in draws if any(group.placed for group in draw.groups)]
    if not shown:
        return {}
    ids, depths, members = (device.read(texture).reshape(-1) for texture in leaders.textures.values())
    count = len(ids) if leaders.central else groups.total
    number = (ids[:count] & ~np.uint32(RASTERISED)).astype(np.int64)
    number[ids[:count] == EMPTY] = -1
    found: dict[str, np.ndarray] = {}
    for draw in shown:
        mine = np.flatnonzero((number >= draw.first_id) & (number < draw.first_id + draw.triangles))
        slot, triangle = draw.locate(number[mine] - draw.first_id)
        geometry = scene.instances.geometry[draw.instance]
        for row in np.unique(geometry[slot]).tolist():
            mesh = scene.geometries[row].mesh
            assert mesh is not None
            graphs = graphs_of(mesh, scene.materials)
            if not draw.groups[0].blocks:  # all triangles of a page that are drawn alike are placed
                graphs = {group.material: graphs[group.material] for group in draw.groups if group.placed}
            own = np.flatnonzero(geometry[slot] == row)
            if mesh.material is not None:
                own = own[np.isin(mesh.material[triangle[own]], list(graphs))]
            if not len(own):
                continue
            here = mine[own]
            pixel = here if leaders.central else groups.entries[here, 0].astype(np.int64)
            row_of, column = np.divmod(pixel, leaders.size[0] if leaders.central else view.size[0])
            where = np.stack([column, row_of], axis=1) + 0.5
            where += lattice.positions[members[here]]
            rays = _Rays(view, where, depths[here].view(np.float32).astype(np.float64) + view.near)
            object_from_view = draw.object_from_view(slot[own])
            samples = rays.footprints(mesh, triangle[own], object_from_view)
            scale = np.cbrt(np.abs(np.linalg.det(object_from_view[:, :3, :3]))).astype(np.float32)
            scale = np.divide(1, scale, out=np.ones_like(scale), where=scale > 0)
            look = over_footprints(mesh, samples, graphs, scene.materials, scale)
            for name in ("color", "surface", "emission", "normal"):
                values = getattr(look, name)
                if values is not None:
                    if name == "normal":
                        # The variance of slopes, as in lib/visibility/normal_spread.glsl.
                        length = np.einsum("nc,nc->n", values, values)
                        spread = np.maximum(1 / np.maximum(length, 1e-4) - 1, 0)
                        values = np.column_stack([unit_rows(values), spread])
                    channels = CHANNELS[PLACED[f"ps_placed_{name}"]]
                    out = found.setdefault(name, np.zeros((leaders.size[0] * leaders.size[1], channels), np.float32))
                    out[here, : values.shape[1]] = values
    return {
        f"ps_placed_{name}": device.texture(leaders.size, PLACED[f"ps_placed_{name}"], values.reshape(-1))
        for name, values in found.items()
        if getattr(variant, name)
    }


class _Rays:
    """Where surfaces were met by the rays through places in the picture, and how that changes from pixel to pixel."""

    def __init__(self, view: SampleView, where: np.ndarray, depth: np.ndarray) -> None:
        """where: (N, 2) float64 in pixels. depth: (N,) float64."""
        self._view, self._depth = view, depth
        (fx, fy), (cx, cy) = view.camera.pixel_from_view()[:2], view.principal_point
        self._focal = np.array([fx, fy])
        xy = (where - (cx, cy)) / self._focal
        self.position = np.column_stack([xy * depth[:, None] if view.camera.perspective else xy, -depth])  # (N, 3)

    def footprints(self, mesh: Mesh, triangle: np.ndarray, object_from_view: np.ndarray) -> Samples:
        """Returns the footprints of pixels on triangles (N,) of a mesh. object_from_view: (N, 4, 4) float64."""
        turn, move = object_from_view[:, :3, :3], object_from_view[:, :3, 3]
        corners = mesh.position[mesh.triangles[triangle]].astype(np.float64)
        plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        plane = unit_rows(np.einsum("nij,ni->nj", turn, plane))  # in view space
        position, perspective = self.position, self._view.camera.perspective
        toward = position if perspective else np.broadcast_to([0.0, 0.0, -1.0], position.shape)
        towards = np.einsum("nc,nc->n", plane, toward)
        least = GRAZING * np.linalg.norm(toward, axis=1)
        towards = np.where(towards < 0, np.minimum(towards, -least), np.maximum(towards, least))
        size = (self._depth[:, None] if perspective else 1.0) / self._focal * (0.5 * self._view.footprint)
        ways = []
        for axis in range(2):
            # A ray that moves across meets the plane farther along.
            way = -toward * (plane[:, axis] / towards)[:, None]
            way[:, axis] += 1
            ways.append(np.einsum("nij,nj->ni", turn, way * np.broadcast_to(size, (len(way), 2))[:, axis, None]))
        return footprints(mesh, triangle, np.einsum("nij,nj->ni", turn, position) + move, *ways)
