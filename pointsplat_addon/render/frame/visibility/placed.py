"""Evaluates material graphs that no picture shows at the places that stand for groups of sub-samples.

Procedural textures, and images that are mapped by other coordinates than a UV map, change within triangles. They are
evaluated where they are seen, once for each group, over the footprint of a pixel, by the processor: material graphs are
expressions of NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial

import numpy as np

from ....core.numeric.lattice import Lattice
from ....core.numeric.vectors import each_block, unit_rows
from ....core.scene.mesh import Mesh
from ....core.scene.scene import Scene
from ....core.surface.appearance import graphs_of
from ....core.surface.footprints import footprints, over_footprints
from ....core.surface.samples import Samples
from ...device.protocol import CHANNELS, EMPTY, Device, Texture
from ...passes.gbuffer import Variant
from ...passes.grouping.groups import Groups, Leaders
from ...passes.shading.terms import OCCLUSION, TRANSMISSION, Term
from ...passes.uniforms import SampleView
from ...passes.visibility.buffer import RASTERISED
from ...passes.visibility.polygon_draw import Drawn
from ...passes.visibility.polygon_mesh import PLACED, THROUGH
from ...shadow.panes import pane_shares

BLOCK = 1 << 14  # groups: the scratch of one block stays in the cache
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
    translucent: bool = False,
    term: Term | None = None,
) -> dict[str, Texture]:
    """Returns what graphs are at the places that stand for groups, in textures as long as the list of these, by sampler
    name; those of PLACED that are needed. `translucent`: also THROUGH, of which the first three channels are the share
    of light that passes, and the fourth is alpha. `term`: of light, that is drawn alone. The caller releases them."""
    shown = [draw for draw in draws if translucent or any(group.placed for group in draw.groups)]
    if not shown:
        return {}
    ids, depths, members = (device.read(texture).reshape(-1) for texture in leaders.textures.values())
    count = len(ids) if leaders.central else groups.total
    number = (ids[:count] & ~np.uint32(RASTERISED)).astype(np.int64)
    number[ids[:count] == EMPTY] = -1
    names = {name for draw in shown for group in draw.groups for name in group.placed}
    names = sorted(name for name in names & PLACED.keys() if getattr(variant, name.removeprefix("ps_placed_")))
    texels = leaders.size[0] * leaders.size[1]
    formats = {name: PLACED[name] for name in names} | ({THROUGH: "RGBA32F"} if translucent else {})
    found = {name: np.zeros((texels, CHANNELS[format]), np.float32) for name, format in formats.items()}
    constants = pane_shares(scene.materials)
    glass = np.zeros(texels if translucent else 0, bool)
    width = leaders.size[0] if leaders.central else view.size[0]

    def evaluate(draw: Drawn, mesh: Mesh, places: tuple[np.ndarray, ...], block: slice) -> None:
        """Writes into `found` what graphs are at a block of places on a mesh: slots of the draw (N,), triangles of the
        mesh (N,), and the groups that show these (N,)."""
        slot, triangle, here = (array[block] for array in places)
        graphs = graphs_of(mesh, scene.materials)
        if not draw.groups[0].blocks:  # all triangles of a page that are drawn alike are placed
            graphs = {group.material: graphs[group.material] for group in draw.groups if group.placed}
        pixel = here if leaders.central else groups.entries[here, 0].astype(np.int64)
        row, column = np.divmod(pixel, width)
        where = np.stack([column, row], axis=1) + 0.5 + lattice.positions[members[here]]
        depth = depths[here].view(np.float32).astype(np.float64) + view.near
        samples, scale = footprints_in_view(view, where, depth, mesh, triangle, draw.object_from_view, slot)
        mesh, samples = on_objects(scene, mesh, samples, draw.instance[slot])
        look, through = over_footprints(mesh, samples, graphs, scene.materials, scale, translucent)
        for name, out in found.items():
            values = through if name == THROUGH else getattr(look, name.removeprefix("ps_placed_"))
            if values is None:
                continue
            if name == "ps_placed_normal":
                # The variance of slopes, as in lib/visibility/normal_spread.glsl.
                length = np.einsum("nc,nc->n", values, values)
                spread = np.maximum(1 / np.maximum(length, 1e-4) - 1, 0)
                values = np.column_stack([unit_rows(values), spread])
            if name == "ps_placed_tangent":
                # Across the normal in view space too
                turn = np.ascontiguousarray(draw.object_from_view[:, :3, :3].swapaxes(1, 2))
                values = unit_rows(_turned(turn, slot, values)) * np.linalg.norm(values, axis=1, keepdims=True)
            out[here, : values.shape[1]] = values

    for draw in shown:
        mine = np.flatnonzero((number >= draw.first_id) & (number < draw.first_id + draw.triangles))
        if translucent:
            material = draw.identify(number[mine] - draw.first_id)[:, 1]
            alpha = scene.materials.alpha[material]
            found[THROUGH][mine] = np.column_stack([np.broadcast_to(constants[material], (len(mine), 3)), alpha])
            if scene.materials.glass is not None:
                glass[mine] = scene.materials.glass[material]
            if not any(group.placed for group in draw.groups):
                continue
        slot, triangle = draw.locate(number[mine] - draw.first_id)
        geometry = scene.instances.geometry[draw.instance][slot]
        for row in np.unique(geometry).tolist():
            mesh = scene.geometries[row].mesh
            assert mesh is not None
            own = np.flatnonzero(geometry == row)
            if mesh.material is not None and not draw.groups[0].blocks:
                materials = [group.material for group in draw.groups if group.placed]
                own = own[np.isin(mesh.material[triangle[own]], materials)]
            places = slot[own], triangle[own], mine[own]
            each_block(len(own), partial(evaluate, draw, mesh, places), BLOCK)
    if translucent and term is not None:
        _only_term(found[THROUGH], glass, term)
    with ExitStack() as unfinished:
        textures: dict[str, Texture] = {}
        for name, values in found.items():
            textures[name] = device.texture(leaders.size, formats[name], values.reshape(-1))
            unfinished.callback(textures[name].release)
        unfinished.pop_all()
    return textures


def _only_term(through: np.ndarray, glass: np.ndarray, term: Term) -> None:
    """Changes what passes (N, 4), and alpha, to what a term of light needs. `glass`: (N,) bool."""
    if term.color and term.light == TRANSMISSION:
        through[:, 3] = glass
    elif not term.through:
        through[glass, :3] = 0
    if term.light == OCCLUSION:
        through[glass, 3] = 1  # glass is a surface as others are


def on_objects(scene: Scene, mesh: Mesh, samples: Samples, instance: np.ndarray) -> tuple[Mesh, Samples]:
    """Returns a mesh and samples of it that know which of the scene's instances (N,) they lie on, where materials read
    that. Scenes of casters, of which that is not known, show all with the values of the first."""
    if not mesh.objects or not scene.instances.objects:
        return mesh, samples
    return replace(mesh, objects=scene.instances.objects), replace(samples, object=instance)


def footprints_in_view(
    view: SampleView,
    where: np.ndarray,
    depth: np.ndarray,
    mesh: Mesh,
    triangle: np.ndarray,
    object_from_view: np.ndarray,
    slot: np.ndarray,
) -> tuple[Samples, np.ndarray]:
    """Returns the footprints of pixels on triangles (N,) of a mesh, and world units of one of object space there, (N,)
    float32.

    where: (N, 2) float64, places in the picture in pixels. depth: (N,) float64. object_from_view: (I, 4, 4) float64, of
    slots; slot: (N,).
    """
    turn, move = object_from_view[:, :3, :3], object_from_view[:, :3, 3]
    perspective, focal = view.camera.perspective, np.array(view.camera.pixel_from_view()[:2])
    xy = (where - view.principal_point) / focal
    position = np.column_stack([xy * depth[:, None] if perspective else xy, -depth])
    corners = mesh.position[mesh.triangles[triangle]].astype(np.float64)
    plane = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    plane = unit_rows(_turned(turn.swapaxes(1, 2), slot, plane))  # in view space
    toward = position if perspective else np.broadcast_to([0.0, 0.0, -1.0], position.shape)
    towards = np.einsum("nc,nc->n", plane, toward)
    least = GRAZING * np.sqrt(np.einsum("nc,nc->n", toward, toward))
    backfacing = towards > 0
    towards = np.where(towards < 0, np.minimum(towards, -least), np.maximum(towards, least))
    half = 0.5 * view.footprint * (depth if perspective else np.ones_like(depth))
    ways = []
    for axis in range(2):
        # A ray that moves across meets the plane farther along.
        way = -toward * (plane[:, axis] / towards)[:, None]
        way[:, axis] += 1
        ways.append(_turned(turn, slot, way * (half / focal[axis])[:, None]))
    scale = np.cbrt(np.abs(np.linalg.det(turn))).astype(np.float32)
    scale = np.divide(1, scale, out=np.ones_like(scale), where=scale > 0)
    found = footprints(mesh, triangle, _turned(turn, slot, position) + move[slot], *ways)
    return replace(found, backfacing=backfacing, eye=view.camera), scale[slot]


def _turned(matrices: np.ndarray, slot: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) by the matrices, of (I, 3, 3), of their slots (N,)."""
    if len(matrices) == 1:
        return vectors @ matrices[0].T
    return np.einsum("nij,nj->ni", matrices[slot], vectors)
