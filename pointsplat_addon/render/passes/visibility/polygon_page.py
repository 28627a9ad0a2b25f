"""Many small meshes on the device as one: what is drawn alike is one draw, whichever mesh and material it is of.

A draw lists blocks of triangles, of which each belongs to one mesh, one material and one instance. What a view does not
show of a page is not listed.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace

import numpy as np

from ....core.numeric.record import value_record
from ....core.numeric.segments import offsets, ranks
from ....core.scene.materials import MaterialTable
from ....core.scene.mesh import Mesh
from ....core.surface.density import coherent_order
from ...device.packing import PAGE_WIDTH
from ...device.protocol import CHANNELS, Device, Texture
from .polygon_mesh import BLOCK, LOOKS, Arranged, Group, arrange

MOST_TRIANGLES = 1 << 17  # of a page: a mesh that changes takes along those on its page


@value_record
class Kind:
    """What is drawn alike of a page: its shader, and blocks sorted by mesh."""

    group: Group
    start: np.ndarray  # (M + 1,) int64: the first block of each mesh
    blocks: np.ndarray  # (B, 3) int64: first triangle on the page, number of triangles, row of the material table
    stretch: np.ndarray  # (M,) float64: Group.stretch of each mesh, 0 where it has none of these triangles


class PolygonPage:
    """The triangles of several meshes, one after another.

    `with_pictures` gives its kinds the pictures that they show, before it is drawn.
    """

    def __init__(self, device: Device, meshes: list[Mesh], table: MaterialTable, emission: bool) -> None:
        """`emission`: something glows."""
        arranged = [arrange(one, table, emission, order=coherent_order(one), placing=True) for one in meshes]
        self.origin = np.array([mesh.origin for mesh in arranged])  # (M, 3) float64
        self.box = np.array([mesh.box for mesh in arranged])  # (M, 2, 3) float64, relative to the origins
        self.first = offsets([mesh.triangles for mesh in arranged])  # (M + 1,) triangle of each mesh
        self.kinds = _kinds(arranged, self.first)
        self.orders = [one.order if any(group.placed for group in one.groups) else None for one in arranged]
        self.textures: dict[str, Texture] = {}
        for name, format in {"ps_corner": "RGBA32F", **LOOKS}.items():
            if name == "ps_corner" or any(name in mesh.looks for mesh in arranged):
                size = PAGE_WIDTH, max(1, -(-3 * int(self.first[-1]) // PAGE_WIDTH))
                texels = _texels(name, arranged, self.first, size[0] * size[1], CHANNELS[format])
                self.textures[name] = device.texture(size, format, texels.reshape(-1))

    def with_pictures(self, pictures: Callable[[Kind], dict[str, Texture]]) -> PolygonPage:
        """Returns the page, on the same textures, with kinds that show what `pictures` returns of those with some."""
        shown = copy(self)
        shown.kinds = [
            replace(kind, group=replace(kind.group, textures=pictures(kind))) if kind.group.graph is not None else kind
            for kind in self.kinds
        ]
        return shown

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def _kinds(arranged: list[Arranged], first: np.ndarray) -> list[Kind]:
    """Returns what is drawn alike of meshes whose first triangles on their page are (M + 1,)."""
    kinds: dict[tuple, list[tuple]] = {}  # to mesh, first triangle, the one after the last, material, stretch
    groups: dict[tuple, Group] = {}
    for number, mesh in enumerate(arranged):
        for group in mesh.groups:
            # Pictures are those of a graph over constants of its material.
            pictured = None if group.graph is None else (group.graph.digest, group.material)
            alike = (group.cull, group.defines, group.placed, pictured)
            begin = int(first[number]) + group.first // 3
            kinds.setdefault(alike, []).append((number, begin, begin + group.count // 3, group.material, group.stretch))
            groups.setdefault(alike, replace(group, first=0, count=0, blocks=True))
    found = []
    for alike, rows in kinds.items():
        *columns, stretches = zip(*rows, strict=True)
        mesh, begin, end, material = np.array(columns, np.int64)
        count = -(-(end - begin) // BLOCK)
        begins = np.repeat(begin, count) + BLOCK * ranks(count)
        sizes = np.minimum(np.repeat(end, count) - begins, BLOCK)
        start = offsets(np.bincount(mesh, count, len(arranged)).astype(np.int64))
        stretch = np.zeros(len(arranged))
        np.maximum.at(stretch, mesh, stretches)
        blocks = np.stack([begins, sizes, np.repeat(material, count)], axis=1)
        found.append(Kind(groups[alike], start, blocks, stretch))
    return found


def _texels(name: str, arranged: list[Arranged], first: np.ndarray, count: int, channels: int) -> np.ndarray:
    """Returns `count` texels of a texture of a page, (count, channels) float32."""
    found = np.zeros((count, channels), np.float32)
    for mesh, begin in zip(arranged, first[:-1].tolist(), strict=True):
        own = found[3 * begin : 3 * (begin + mesh.triangles)]
        if name == "ps_corner":
            mesh.corners(own, slice(0, len(own)))
        elif name in mesh.looks:
            own[:, : mesh.looks[name].shape[1]] = mesh.looks[name]
    return found
