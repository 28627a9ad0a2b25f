"""What a view shows of meshes: instances of one, or blocks of triangles of a page of many."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np

from ....core.numeric.segments import owners, ranges
from ...device.packing import paged
from ...device.protocol import Device, Texture
from ..uniforms import Values
from .polygon_mesh import BLOCK, BLOCK_SHIFT, CHUNK, Group, PolygonMesh
from .polygon_page import Kind, PolygonPage

GAP = 2  # chunks that are drawn with those around them: another draw takes longer
MOST_RUNS = 64  # of a group: each is a draw, or three dispatches


def instance_rows(
    view_from_object: np.ndarray, holdout: np.ndarray, instance: np.ndarray, first: np.ndarray | int = 0
) -> np.ndarray:
    """Returns the four rows of each slot in `ps_instances`, (I, 4, 4) float32: transform; holdout, instance, whether it
    mirrors, and the first triangle of its mesh on a page.

    view_from_object: (I, 4, 4) float64. holdout, instance, first: (I,).
    """
    rows = np.zeros((len(instance), 4, 4), np.float32)
    rows[:, :3] = view_from_object[:, :3]
    rows[:, 3, 0], rows[:, 3, 1], rows[:, 3, 3] = holdout, instance, first
    rows[:, 3, 2] = np.linalg.det(view_from_object[:, :3, :3]) < 0
    return rows


class PolygonDraw:
    """All instances of one mesh that a view shows: slots, of which each has the number of a mesh's triangles."""

    def __init__(
        self,
        device: Device,
        mesh: PolygonMesh,
        instance: np.ndarray,
        view_from_object: np.ndarray,
        holdout: np.ndarray,
        first_id: int,
        small: bool,
        chunks: np.ndarray | None = None,
    ) -> None:
        """instance: (I,) int. view_from_object: (I, 4, 4) float64, from positions relative to the mesh's origin.
        holdout: (I,), 1 where it cuts a hole, 2 where it is a matte. `small`: most triangles cover few cells. chunks:
        (C,) rising, those of the mesh that are drawn, of one instance; None: all.
        """
        self.mesh, self.groups, self.first_id, self.small = mesh, mesh.groups, first_id, small
        self.instance, self.repeats, self.of_slot = instance, len(instance), mesh.triangles
        self._view_from_object = view_from_object
        self.one = self.repeats == 1
        self._chunks = chunks
        self.textures: dict[str, Texture] = {}
        self.values: Values = {}
        rows = instance_rows(view_from_object, holdout, instance)
        if self.one:
            self.values = {
                "view_from_object": view_from_object[0],
                "instance": int(instance[0]),
                "holdout": int(holdout[0]),
                "mirrored": bool(rows[0, 3, 2]),
            }
            return
        size, data = paged(rows.reshape(-1, 4), 4)
        self.textures["ps_instances"] = device.texture(size, "RGBA32F", data)

    @property
    def triangles(self) -> int:
        """Of all slots."""
        return self.repeats * self.of_slot

    def runs(self, group: Group) -> list[Group]:
        """Returns the ranges of a group's triangles that are drawn."""
        return [group] if self._chunks is None else chunk_runs(self.groups, group, self._chunks)

    @cached_property
    def object_from_view(self) -> np.ndarray:
        """The transforms of slots to their object's space, (I, 4, 4) float64."""
        return _to_objects(self._view_from_object, self.mesh.origin)

    def locate(self, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the slots (N,) and the triangles of their meshes (N,), by numbers (N,) in this draw."""
        slot, triangle = np.divmod(number, self.of_slot)
        return slot, triangle if self.mesh.order is None else self.mesh.order[triangle]

    def identify(self, number: np.ndarray) -> np.ndarray:
        """Returns the instance and the material, (N, 2), of triangles by their numbers (N,) in this draw."""
        slot, triangle = np.divmod(number, self.of_slot)
        starts = np.array([group.first // 3 for group in self.groups])
        materials = np.array([group.material for group in self.groups])
        group = np.searchsorted(starts, triangle, side="right") - 1
        return np.stack([self.instance[slot], materials[group]], axis=1)

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


def _to_objects(view_from_object: np.ndarray, origin: np.ndarray) -> np.ndarray:
    """Returns the inverses of transforms (I, 4, 4) from positions relative to origins (3,) or (I, 3), zeros of those
    that have none."""
    regular = np.abs(np.linalg.det(view_from_object[:, :3, :3])) > 0
    found = np.zeros_like(view_from_object)
    found[regular] = np.linalg.inv(view_from_object[regular])
    found[:, :3, 3] += origin
    return found


def chunk_runs(groups: list[Group], group: Group, chunks: np.ndarray) -> list[Group]:
    """Returns the ranges of one of the `groups` of a mesh that chunks of the mesh, (C,) rising, lie in."""
    before = 0
    for other in groups:
        assert other.chunks is not None
        if other is group:
            break
        before += len(other.chunks)
    assert group.chunks is not None
    mine = chunks[(chunks >= before) & (chunks < before + len(group.chunks))] - before
    if len(mine) == 0:
        return []
    gap = np.diff(mine)
    apart = np.flatnonzero(gap > GAP + 1)
    if len(apart) >= MOST_RUNS:
        apart = np.sort(apart[np.argsort(-gap[apart], kind="stable")[: MOST_RUNS - 1]])
    first, last = mine[np.append(0, apart + 1)], mine[np.append(apart, len(mine) - 1)] + 1
    begin, end = 3 * CHUNK * first, np.minimum(3 * CHUNK * last, group.count)
    return [
        replace(group, first=group.first + low, count=high - low)
        for low, high in zip(begin.tolist(), end.tolist(), strict=True)
    ]


class BlockDraw:
    """What a view shows of a kind of a page: slots, each an instance of a mesh, and blocks of their triangles."""

    one = False
    values: Values = {}

    def __init__(
        self,
        page: PolygonPage,
        kind: Kind,
        blocks: np.ndarray,
        first: int,
        instance: np.ndarray,
        member: np.ndarray,
        view_from_object: np.ndarray,
        first_id: int,
        small: bool,
    ) -> None:
        """blocks: (B, 4), first triangle on the page, number of triangles, slot and material; `first`: the first of
        them among those of all kinds. instance: (I,) int, of each slot, and which mesh of the page it is, member (I,).
        `small`: most triangles cover few cells."""
        self.small, self._view_from_object, self._member = small, view_from_object, member
        self.mesh, self.instance, self.first_id, self.repeats, self._blocks = page, instance, first_id, 1, blocks
        self.groups = [replace(kind.group, first=first, count=3 * BLOCK * len(blocks))]
        self.triangles = self.of_slot = BLOCK * len(blocks)  # numbers of triangles, of which some have none
        self.textures: dict[str, Texture] = {}
        self._owned: list[Texture] = []

    def runs(self, group: Group) -> list[Group]:
        """Returns the ranges of a group's triangles that are drawn."""
        return [group]

    @cached_property
    def object_from_view(self) -> np.ndarray:
        """The transforms of slots to their object's space, (I, 4, 4) float64."""
        return _to_objects(self._view_from_object, self.mesh.origin[self._member])

    def locate(self, number: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns the slots (N,) and the triangles of their meshes (N,), by numbers (N,) in this draw."""
        block = self._blocks[number >> BLOCK_SHIFT]
        slot = block[:, 2]
        triangle = block[:, 0] + (number & (BLOCK - 1)) - self.mesh.first[self._member[slot]]
        for member in np.unique(self._member[slot]).tolist():
            order = self.mesh.orders[member]
            if order is not None:
                mine = self._member[slot] == member
                triangle[mine] = order[triangle[mine]]
        return slot, triangle

    def identify(self, number: np.ndarray) -> np.ndarray:
        """Returns the instance and the material, (N, 2), of triangles by their numbers (N,) in this draw."""
        block = self._blocks[number >> BLOCK_SHIFT]
        return np.stack([self.instance[block[:, 2]], block[:, 3]], axis=1)

    def bind(self, textures: dict[str, Texture], owned: bool) -> None:
        """Gives it the textures of slots and blocks; those that it has `owned` are released with it."""
        self.textures, self._owned = textures, list(textures.values()) if owned else []

    def release(self) -> None:
        for texture in self._owned:
            texture.release()


def block_draws(
    device: Device,
    page: PolygonPage,
    member: np.ndarray,
    instance: np.ndarray,
    view_from_object: np.ndarray,
    holdout: np.ndarray,
    first_id: int,
    small: bool,
) -> list[BlockDraw]:
    """Returns what a view shows of a page, kind by kind. `small`: most triangles cover few cells.

    member: (I,) int, the mesh of each instance that is shown. instance, holdout: (I,). view_from_object: (I, 4, 4)
    float64, from positions relative to the origins of the meshes. first_id: the number of the first triangle.
    """
    found, lists, first = [], [], 0
    for kind in page.kinds:
        count = (kind.start[1:] - kind.start[:-1])[member]
        blocks = kind.blocks[ranges(kind.start[member], count)]
        if len(blocks):
            rows = np.column_stack([blocks[:, :2], owners(count), blocks[:, 2]])
            found.append(BlockDraw(page, kind, rows, first, instance, member, view_from_object, first_id, small))
            lists.append(rows)
            first, first_id = first + len(rows), first_id + found[-1].triangles
    if found:
        rows = instance_rows(view_from_object, holdout, instance, page.first[member])
        named = {"ps_instances": rows.reshape(-1, 4), "ps_blocks": np.concatenate(lists)}
        textures = {}
        for name, values in named.items():
            size, data = paged(values, 4)
            textures[name] = device.texture(size, "RGBA32F", data)
        for draw in found:
            draw.bind(textures, owned=draw is found[0])
    return found


Drawn = PolygonDraw | BlockDraw
