"""Meshes on the device: corners of triangles in textures, in groups by material, and baked material pictures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ....core.material.graph import MaterialGraph
from ....core.scene.materials import MaterialTable
from ....core.scene.mesh import Mesh
from ....core.surface.appearance import at_corners, baked, corner_normals, graphs_of, pictured, uv_of
from ....core.surface.density import PART, Parts
from ...device.packing import PAGE_WIDTH, pack_normal, paged
from ...device.protocol import Device, Texture
from ..gbuffer import Variant

LARGEST_PICTURE = 4096  # texels along a side of a baked picture
# What may vary from corner to corner: texture, and GLSL type and name between the stages.
CORNERS = {
    "ps_corner_color": ("vec4", "v_color"),
    "ps_corner_surface": ("vec2", "v_surface"),
    "ps_corner_emission": ("vec3", "v_emission"),
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
    on = graph.channels.keys()
    names = {
        "PS_UV": True,
        "PS_BAKED_COLOR": bool(on & {"base_color", "alpha"}),
        "PS_BAKED_ALPHA": "alpha" in on,
        "PS_BAKED_SURFACE": bool(on & {"roughness", "metallic"}),
        "PS_BAKED_EMISSION": emission and "emission" in on,
        "PS_BAKED_NORMAL": "normal" in on,
    }
    return tuple(name for name, there in names.items() if there)


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
            add("ps_baked_emission", "RGBA16F", "emission", "")
        if "PS_BAKED_NORMAL" in names:
            add("ps_baked_normal", "RGBA16F", "normal", "")

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


class PolygonMesh:
    """One mesh on the device, its triangles sorted by material, and within one by parts where there are any.

    `hang` gives it the pictures that it shows, before it is drawn.
    """

    def __init__(
        self,
        device: Device,
        mesh: Mesh,
        table: MaterialTable,
        variant: Variant,
        parts: Parts | None = None,
    ) -> None:
        self.origin = _origin(mesh)
        self.triangles = len(mesh.triangles)
        rows = np.full(len(mesh.triangles), mesh.materials[0]) if mesh.material is None else mesh.material.astype(int)
        triangle = np.arange(len(mesh.triangles))
        if parts is not None and parts.order is not None:
            triangle = parts.order
        by_material = np.argsort(rows[triangle], kind="stable")
        order = triangle[by_material]
        corners = (3 * order[:, None] + np.arange(3)).reshape(-1)
        corner_rows = np.empty((len(corners), 4), np.float32)
        corner_rows[:, :3] = mesh.position[mesh.triangles[order].reshape(-1)] - self.origin
        corner_rows[:, 3] = pack_normal(corner_normals(mesh)[corners])
        self.textures: dict[str, Texture] = {}
        # Low and high corner (2, 3), relative to the origin.
        self.box = np.array([corner_rows[:, :3].min(axis=0), corner_rows[:, :3].max(axis=0)], np.float64)

        def upload(name: str, format: str, channels: int, values: np.ndarray) -> None:
            size, data = paged(values, channels)
            self.textures[name] = device.texture(size, format, data)

        upload("ps_corner", "RGBA32F", 4, corner_rows)
        graphs = graphs_of(mesh, table)
        shown = {row: graph for row, graph in graphs.items() if pictured(mesh, graph)}
        flat = {row: graph for row, graph in graphs.items() if row not in shown}
        alpha_names: list[str] = []
        if flat:
            look = at_corners(mesh, table, flat, rows)
            alpha = np.ones(len(rows) * 3, np.float32) if look.alpha is None else look.alpha
            color = np.repeat(table.base_color[rows], 3, axis=0) if look.color is None else look.color
            if not (look.alpha is None and look.color is None):
                upload("ps_corner_color", "RGBA16F", 4, np.column_stack([color, alpha])[corners])
            if look.surface is not None:
                upload("ps_corner_surface", "RG32F", 2, look.surface[corners])
            if variant.emission and look.emission is not None:
                upload("ps_corner_emission", "RGBA16F", 4, look.emission[corners])
            if look.alpha is not None:
                alpha_names.append("PS_CORNER_ALPHA")
        at_each_corner = (*(name.upper() for name in CORNERS if name in self.textures), *alpha_names)
        uv = np.zeros((len(corners), 2), np.float32)
        starts = np.searchsorted(rows[order], list(mesh.materials))
        ends = np.searchsorted(rows[order], list(mesh.materials), side="right")
        self.groups: list[Group] = []
        for row, start, end in zip(mesh.materials, 3 * starts, 3 * ends, strict=True):
            if end == start:
                continue
            defines: tuple[str, ...] = ()
            graph = shown.get(row)
            if graph is not None:
                uv[start:end] = uv_of(mesh, graph)[corners[start:end]]
                defines = baked_defines(graph, variant.emission)
            elif row in flat:
                defines = at_each_corner
            begins = None
            if parts is not None:
                part = by_material[start // 3 : end // 3] // PART
                begins = start + 3 * np.searchsorted(part, np.arange(len(parts) + 1))
            cull = bool(table.cull[row])
            self.groups.append(Group(row, int(start), int(end - start), cull, defines, graph, start=begins))
        if shown:
            upload("ps_corner_uv", "RG32F", 2, uv)

    def hang(self, pictures: Callable[[MaterialGraph, int], Pictures]) -> None:
        """Give each group that shows pictures those of its graph and row of the material table."""
        for group in self.groups:
            if group.graph is not None:
                group.textures = pictures(group.graph, group.material).textures

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def _origin(mesh: Mesh) -> np.ndarray:
    used = mesh.position[mesh.triangles.reshape(-1)]
    return ((used.min(axis=0) + used.max(axis=0)) / 2).astype(np.float64) if len(used) else np.zeros(3)
