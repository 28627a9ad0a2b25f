"""Meshes on the device: corners of triangles in textures, in groups by material, and baked material pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from ....core.material.baking import BORDER, reading, split_bumps
from ....core.material.graph import MaterialGraph
from ....core.numeric.record import value_record
from ....core.scene.bounds import bounding_box, used_positions
from ....core.scene.materials import MaterialTable
from ....core.scene.mesh import Mesh
from ....core.surface.appearance import at_corners, baked, graphs_of, pictured, uv_of
from ....core.surface.density import PART, Parts
from ...device.packing import PAGE_WIDTH, paged
from ...device.protocol import CHANNELS, Device, Texture, WriteTexels
from ..gbuffer import Variant
from .corners import corner_texels

LARGEST_PICTURE = 4096  # texels along a side of a baked picture
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


@dataclass
class Group:
    """Triangles of one material: a range of corners, and what its shader reads."""

    material: int
    first: int  # corner
    count: int  # corners
    cull: bool
    defines: tuple[str, ...]
    graph: MaterialGraph | None = None  # whose pictures it shows
    textures: dict[str, Texture] = field(default_factory=dict)  # these pictures
    start: np.ndarray | None = None  # (B + 1,) int64: the first corner of each part of the mesh
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


def baked_defines(graph: MaterialGraph, emission: bool) -> tuple[str, ...]:
    """Returns the defines of shaders that read the baked pictures of a graph."""
    on, how = graph.channels.keys(), reading(graph)
    below, heights, _ = split_bumps(graph.normal)
    names = {
        "PS_UV": True,
        "PS_BAKED_COLOR": bool(on & {"base_color", "alpha"}),
        "PS_BAKED_ALPHA": "alpha" in on,
        "PS_BAKED_SURFACE": bool(on & {"roughness", "metallic"}),
        "PS_BAKED_EMISSION": emission and "emission" in on,
        "PS_BAKED_NORMAL": below is not None,
        "PS_BAKED_HEIGHT": heights is not None,
        "PS_PICTURE_MIRROR": how.extension == "MIRROR",
        "PS_PICTURE_BORDER": how.extension == "BORDER",
        "PS_PICTURE_CLOSEST": how.closest,
    }
    for channel, kind in (("base_color", "COLOR"), ("emission", "EMISSION")):
        names[f"PS_ENCODED_{kind}"] = channel in how.encoded and names[f"PS_BAKED_{kind}"]
        names[f"PS_ASSOCIATED_{kind}"] = channel in how.associated and names[f"PS_BAKED_{kind}"]
    return tuple(name for name, there in names.items() if there)


def define_entries(names: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Returns defines with their values."""
    return tuple((name, str(BORDER) if name == "PS_PICTURE_BORDER" else "1") for name in names)


class Pictures:
    """What varies of a material over the UV square, baked as textures by sampler name. They belong to no mesh: meshes
    share them, and may move without another. Channels that share a texture with one that varies hold constants."""

    def __init__(self, device: Device, graph: MaterialGraph, table: MaterialTable, row: int, emission: bool) -> None:
        picture = baked(graph, LARGEST_PICTURE)
        height, width = next(iter(picture.values())).shape[:2]
        names = baked_defines(graph, emission)
        self.textures: dict[str, Texture] = {}

        def add(name: str, format: str, *channels: str) -> None:
            """Channels side by side; a name that is none is that of zeros."""
            values = [picture[c] if c in picture else constants.get(c, np.zeros(1)) for c in channels]
            ends = np.cumsum([value.shape[-1] for value in values])
            data = np.empty((height, width, ends[-1]), np.float32)
            for end, value in zip(ends, values, strict=True):
                data[..., end - value.shape[-1] : end] = value
            self.textures[name] = device.texture((width, height), format, data.reshape(-1))

        constants = {"base_color": table.base_color[row], "alpha": np.ones(1), "roughness": table.roughness[[row]],
                     "metallic": table.metallic[[row]]}  # fmt: skip
        if "PS_BAKED_COLOR" in names:
            add("ps_baked_color", "RGBA16F", "base_color", "alpha")
        if "PS_BAKED_SURFACE" in names:
            add("ps_baked_surface", "RG32F", "roughness", "metallic")
        if "PS_BAKED_EMISSION" in names:
            add("ps_baked_emission", "RGBA16F", "emission", "alpha" if "PS_ASSOCIATED_EMISSION" in names else "")
        if "PS_BAKED_NORMAL" in names:
            add("ps_baked_normal", "RGBA16F", "normal", "")
        if "PS_BAKED_HEIGHT" in names:
            add("ps_baked_height", "RG32F", "height")

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


@value_record
class Arranged:
    """The triangles of a mesh in the order in which they are drawn, by material, and what varies at their corners."""

    origin: np.ndarray  # (3,) float64 that float32 holds: positions are relative to it
    box: np.ndarray  # (2, 3) float64: low and high corner, relative to the origin
    triangles: int
    corners: WriteTexels  # of the texture ps_corner
    looks: dict[str, np.ndarray]  # (3T, C) by sampler name, in the formats of LOOKS
    groups: list[Group]


def arrange(
    mesh: Mesh,
    table: MaterialTable,
    emission: bool,
    parts: Parts | None = None,
    order: np.ndarray | None = None,
) -> Arranged:
    """Returns what is uploaded of a mesh. `emission`: something glows.

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
    flat = {row: graph for row, graph in graphs.items() if row not in shown}
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
        groups.append(Group(row, 3 * first, 3 * (end - first), bool(table.cull[row]), defines, graph, start=begins))
    return Arranged(origin, box, len(mesh.triangles), corner_texels(mesh, order, origin, normals), looks, groups)


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


def hang(groups: Iterable[Group], pictures: Callable[[MaterialGraph, int], Pictures]) -> None:
    """Gives each group that shows pictures those of its graph and row of the material table."""
    for group in groups:
        if group.graph is not None:
            group.textures = pictures(group.graph, group.material).textures


class PolygonMesh:
    """One mesh on the device, its triangles sorted by material, and within one by parts where there are any.

    `hang` gives its groups the pictures that they show, before it is drawn.
    """

    def __init__(
        self,
        device: Device,
        mesh: Mesh,
        table: MaterialTable,
        variant: Variant,
        parts: Parts | None = None,
        order: np.ndarray | None = None,
    ) -> None:
        """`parts`, `order`: see arrange."""
        arranged = arrange(mesh, table, variant.emission, parts, order)
        self.triangles, self.origin, self.box = arranged.triangles, arranged.origin, arranged.box
        self.groups = arranged.groups
        size = PAGE_WIDTH, max(1, -(-3 * self.triangles // PAGE_WIDTH))
        self.textures: dict[str, Texture] = {"ps_corner": device.texture(size, "RGBA32F", arranged.corners)}
        for name, values in arranged.looks.items():
            size, data = paged(values, CHANNELS[LOOKS[name]])
            self.textures[name] = device.texture(size, LOOKS[name], data)

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


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
