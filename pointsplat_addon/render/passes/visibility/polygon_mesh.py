"""Meshes on the device: corners of triangles in textures, in groups by material, and baked material pictures."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from ....core.material.graph import MaterialGraph, needs
from ....core.numeric.record import value_record
from ....core.scene.bounds import bounding_box, used_positions
from ....core.scene.materials import MaterialTable
from ....core.scene.mesh import Mesh
from ....core.surface.appearance import at_corners, graphs_of, interpolates, pictured, uv_of
from ....core.surface.density import PART, Parts
from ...device.packing import PAGE_WIDTH, paged
from ...device.protocol import CHANNELS, Device, Texture, WriteTexels
from .corners import corner_texels
from .pictures import baked_defines

STRETCHED = 4096  # triangles of a group that are asked how much UV changes
CHUNK = 1024  # triangles that are drawn or left out together: enough for a draw of their own
FEWEST_CHUNKS = 16  # of a mesh: one of fewer is drawn as a whole
BLOCK_SHIFT = 4
BLOCK = 1 << BLOCK_SHIFT  # triangles: few, so that meshes of few do not fill a block with nothing
BLOCK_DEFINES = (("PS_BLOCKS", "1"), ("PS_BLOCK_SHIFT", str(BLOCK_SHIFT)))
# What may vary from corner to corner: texture, and GLSL type and name between the stages.
CORNERS = {
    "ps_corner_color": ("vec4", "v_color"),
    "ps_corner_surface": ("vec2", "v_surface"),
    "ps_corner_emission": ("vec3", "v_emission"),
}
# Formats of the textures of what is known at corners.
LOOKS = {
    "ps_corner_color": "RGBA16F",
    "ps_corner_surface": "RG32F",
    "ps_corner_emission": "RGBA16F",
    "ps_corner_uv": "RG32F",
}
# Formats of the textures of what is evaluated where it is seen, one texel for each group of sub-samples.
PLACED = {
    "ps_placed_color": "RGBA16F",
    "ps_placed_surface": "RG32F",
    "ps_placed_emission": "RGBA16F",
    "ps_placed_normal": "RGBA16F",
    "ps_placed_tangent": "RGBA16F",
}
THROUGH = "ps_through"  # what passes there: a share of light of each channel, and alpha


@dataclass
class Group:
    """Triangles of one material: a range of corners, and what its shader reads."""

    material: int
    first: int  # corner
    count: int  # corners
    cull: bool
    defines: tuple[str, ...]
    graph: MaterialGraph | None = None  # whose pictures it shows
    textures: dict[str, Texture] = field(default_factory=dict)  # these pictures, and their levels where there are any
    stretch: float = 0.0  # that UV changes along a unit of object space, on a twentieth of the surface more
    start: np.ndarray | None = None  # (B + 1,) int64: the first corner of each part of the mesh
    chunks: np.ndarray | None = None  # (C, 2, 3) float64: boxes around CHUNK triangles each, relative to the origin
    placed: tuple[str, ...] = ()  # of PLACED, what its graphs are evaluated for at each group of sub-samples
    blocks: bool = False  # a range of blocks of triangles that a view lists, of any meshes and materials of a page

    def rows(self, parts: np.ndarray) -> np.ndarray:
        """(P, 4) float32 of those of the parts that have corners here: texel (x, y) of the first one, how many."""
        assert self.start is not None
        first, count = self.start[parts], self.start[parts + 1] - self.start[parts]
        columns = first % PAGE_WIDTH, first // PAGE_WIDTH, count, np.zeros_like(first)
        return np.stack(columns, axis=1)[count > 0].astype(np.float32)


@dataclass
class PartList:
    """Parts of a group that one instance draws in one view."""

    texture: Texture
    count: int


@value_record
class Arranged:
    """The triangles of a mesh in the order in which they are drawn, by material, and what varies at their corners."""

    origin: np.ndarray  # (3,) float64 that float32 holds: positions are relative to it
    box: np.ndarray  # (2, 3) float64: low and high corner, relative to the origin
    triangles: int
    corners: WriteTexels  # of the texture ps_corner
    looks: dict[str, np.ndarray]  # (3T, C) by sampler name, in the formats of LOOKS
    groups: list[Group]
    order: np.ndarray | None = None  # (T,) int: triangles of the mesh in this order; None: as they come


def arrange(
    mesh: Mesh,
    table: MaterialTable,
    emission: bool,
    parts: Parts | None = None,
    order: np.ndarray | None = None,
    chunked: bool = False,
    placing: bool = False,
    translucent: bool = False,
) -> Arranged:
    """Returns what is uploaded of a mesh. `emission`: something glows. `chunked`: chunks of it may be left out.
    `placing`: graphs are evaluated where they are seen unless pictures show them as well. `translucent`: light passes
    through it, of which both sides are seen; all graphs are evaluated where they are seen.

    `order`: (T,) triangles in the order of the parts, or without parts in any; None: as they come.
    """
    low, high = bounding_box(used_positions(mesh))
    origin = ((low.astype(np.float32) + high.astype(np.float32)) / 2).astype(np.float64)
    box = (np.array([low, high]) - origin).astype(np.float32).astype(np.float64)
    by_material: np.ndarray | None = None
    if mesh.material is not None:
        by_material = np.argsort(mesh.material if order is None else mesh.material[order], kind="stable")
        order = by_material if order is None else order[by_material]
    graphs = graphs_of(mesh, table)
    shown = {row: graph for row, graph in graphs.items() if pictured(mesh, graph)}
    if placing:  # pictures of functions are as coarse as they are made; but their alpha is needed at all sub-samples
        shown = {row: graph for row, graph in shown.items() if needs(graph).images or graph.alpha is not None}
    if translucent:
        shown = {}
    flat = {row: graph for row, graph in graphs.items() if row not in shown}
    placed = {row: graph for row, graph in flat.items() if translucent or (placing and not interpolates(graph))}
    at_places = _placed(list(placed.values())) + ((THROUGH,) if translucent else ())
    # Of these, alpha alone is needed at corners, where it cuts out.
    flat |= {row: MaterialGraph(alpha=None if translucent else graph.alpha) for row, graph in placed.items()}
    flat = {row: graph for row, graph in flat.items() if graph.channels}
    looks, at_each_corner, normals = _looks(mesh, order, table, flat, emission) if flat else ({}, (), None)
    if shown:
        looks["ps_corner_uv"] = np.zeros((3 * len(mesh.triangles), 2), np.float32)
    groups = []
    for row, first, end in _ranges(mesh, order):
        defines: tuple[str, ...] = ()
        graph = shown.get(row)
        if graph is not None:
            looks["ps_corner_uv"][3 * first : 3 * end] = _ordered(uv_of(mesh, graph), order, slice(first, end))
            defines = baked_defines(graph, emission)
        elif row in flat:
            defines = at_each_corner
        begins = None
        if parts is not None:
            part = np.arange(first, end) if by_material is None else by_material[first:end]
            begins = 3 * (first + np.searchsorted(part // PART, np.arange(len(parts) + 1)))
        made = Group(
            row, 3 * first, 3 * (end - first), bool(table.cull[row]) and not translucent, defines, graph, start=begins
        )
        made.placed = at_places if row in placed else ()
        if chunked:
            made.chunks = _chunk_boxes(mesh, slice(first, end) if order is None else order[first:end]) - origin
        if graph is not None:
            made.stretch = _stretch(mesh, order, range(first, end), looks["ps_corner_uv"])
        groups.append(made)
    texels = corner_texels(mesh, order, origin, normals)
    return Arranged(origin, box, len(mesh.triangles), texels, looks, groups, order)


def _placed(graphs: list[MaterialGraph]) -> tuple[str, ...]:
    """Returns which of PLACED graphs vary."""
    channels = {name for graph in graphs for name in graph.channels}
    kinds = {"color": {"base_color"}, "surface": {"roughness", "metallic"}}
    kinds |= {name: {name} for name in ("emission", "normal", "tangent")}
    return tuple(f"ps_placed_{kind}" for kind, names in kinds.items() if names & channels)


def _looks(
    mesh: Mesh, order: np.ndarray | None, table: MaterialTable, graphs: dict[int, MaterialGraph], emission: bool
) -> tuple[dict[str, np.ndarray], tuple[str, ...], np.ndarray | None]:
    """Returns what graphs vary from corner to corner, the defines of shaders that read it, and the normals of corners,
    (3T, 3), where graphs bend them."""
    rows = np.full(len(mesh.triangles), mesh.materials[0]) if mesh.material is None else mesh.material.astype(int)
    look, found = at_corners(mesh, table, graphs, rows), {}
    alpha = np.ones(len(rows) * 3, np.float32) if look.alpha is None else look.alpha
    color = np.repeat(table.base_color[rows], 3, axis=0) if look.color is None else look.color
    if not (look.alpha is None and look.color is None):
        found["ps_corner_color"] = _ordered(np.column_stack([color, alpha]), order)
    if look.surface is not None:
        found["ps_corner_surface"] = _ordered(look.surface, order)
    if emission and look.emission is not None:
        found["ps_corner_emission"] = _ordered(look.emission, order)
    names = *map(str.upper, found), *(("PS_CORNER_ALPHA",) if look.alpha is not None else ())
    return found, names, look.normal


class PolygonMesh:
    """One mesh on the device, its triangles sorted by material, and within one by parts where there are any.

    `with_pictures` gives its groups the pictures that they show, before it is drawn.
    """

    def __init__(
        self,
        device: Device,
        mesh: Mesh,
        table: MaterialTable,
        emission: bool,
        parts: Parts | None = None,
        order: np.ndarray | None = None,
        placing: bool = False,
        translucent: bool = False,
    ) -> None:
        """`emission`, `parts`, `order`, `placing`, `translucent`: see arrange."""
        chunked = parts is None and len(mesh.triangles) >= FEWEST_CHUNKS * CHUNK
        arranged = arrange(mesh, table, emission, parts, order, chunked, placing, translucent)
        self.triangles, self.origin, self.box = arranged.triangles, arranged.origin, arranged.box
        self.groups = arranged.groups
        self.order = arranged.order if any(group.placed for group in arranged.groups) else None
        size = PAGE_WIDTH, max(1, -(-3 * self.triangles // PAGE_WIDTH))
        self.textures: dict[str, Texture] = {"ps_corner": device.texture(size, "RGBA32F", arranged.corners)}
        for name, values in arranged.looks.items():
            size, data = paged(values, CHANNELS[LOOKS[name]])
            self.textures[name] = device.texture(size, LOOKS[name], data)

    def with_pictures(self, pictures: Callable[[Group], dict[str, Texture]]) -> PolygonMesh:
        """Returns the mesh, on the same textures, with groups that show what `pictures` returns of those with some.

        Views share meshes, but not which levels of pictures they need.
        """
        shown = copy(self)
        shown.groups = [replace(g, textures=pictures(g)) if g.graph is not None else g for g in self.groups]
        return shown

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def _chunk_boxes(mesh: Mesh, which: np.ndarray | slice) -> np.ndarray:
    """Returns boxes (C, 2, 3) float64 around each CHUNK of some triangles of a mesh, in their order."""
    vertices = mesh.triangles[which].reshape(-1)
    begin = np.arange(0, len(vertices), 3 * CHUNK)
    found = np.empty((len(begin), 2, 3))
    for axis, values in enumerate(mesh.position.T):
        corners = values[vertices]
        found[:, 0, axis] = np.minimum.reduceat(corners, begin)
        found[:, 1, axis] = np.maximum.reduceat(corners, begin)
    return found


def _stretch(mesh: Mesh, order: np.ndarray | None, range_: range, uv: np.ndarray) -> float:
    """Group.stretch, of some of the triangles in a range of a mesh's order. uv: (3 T, 2) in that order."""
    some = np.unique(np.linspace(range_.start, range_.stop - 1, min(len(range_), STRETCHED), dtype=np.int64))
    corners = mesh.position[mesh.triangles[some if order is None else order[some]]].astype(np.float64)
    edges = corners[:, 1:] - corners[:, :1]
    along = uv.reshape(-1, 3, 2)[some].astype(np.float64)
    with np.errstate(all="ignore"):
        along = along[:, 1:] - along[:, :1]
        metric, change = (edge @ edge.swapaxes(1, 2) for edge in (edges, along))
        area = np.linalg.det(metric)
        trace = (metric[:, 1, 1] * change[:, 0, 0] + metric[:, 0, 0] * change[:, 1, 1]) / area
        trace -= 2 * metric[:, 0, 1] * change[:, 0, 1] / area
        found = 0.5 * trace + np.sqrt(np.maximum(0.25 * trace**2 - np.linalg.det(change) / area, 0))
    found[~np.isfinite(found)] = 0  # of triangles without an area nothing is seen
    rising = np.argsort(found)
    share = np.cumsum(np.sqrt(np.maximum(area, 0))[rising])
    return float(np.sqrt(found[rising[min(np.searchsorted(share, 0.95 * share[-1]), len(share) - 1)]]))


def _ranges(mesh: Mesh, order: np.ndarray | None) -> list[tuple[int, int, int]]:
    """(row of the material table, first triangle in this order, the one after the last) of each material."""
    if mesh.material is None:
        return [(mesh.materials[0], 0, len(mesh.triangles))]
    rows = mesh.material[order]
    firsts, ends = (np.searchsorted(rows, list(mesh.materials), side=side).tolist() for side in ("left", "right"))
    return [found for found in zip(mesh.materials, firsts, ends, strict=True) if found[2] > found[1]]


def _ordered(corners: np.ndarray, order: np.ndarray | None, which: slice = slice(None)) -> np.ndarray:
    """Values (3T, C) of a mesh's corners, with its triangles put in order; `which`: of these."""
    values = corners.reshape(-1, 3, corners.shape[-1])
    found = values[which] if order is None else values[order[which]]
    return found.reshape(-1, corners.shape[-1])
