"""Traces rays in a tree of triangles: shaders/indirect/trace.frag."""

from __future__ import annotations

import numpy as np

from ....core.indirect.triangle_tree import TriangleTree
from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..uniforms import block
from .pages import NODE_WIDTH, RECEIVER_WIDTH, paged_texture

TRACE_BLOCK = block("Trace", (("int", "leaves"), ("int", "in_leaf")))
TRACE = Interface(
    "trace", fragment="indirect/trace.frag", block=TRACE_BLOCK, outputs=(("vec4", "out_hit"),),
    samplers=tuple(("FLOAT_2D", name) for name in ("ps_boxes", "ps_triangles", "ps_origins", "ps_directions")),
    defines=(("PS_NODE_WIDTH", str(NODE_WIDTH)),),
)  # fmt: skip


class TracedTriangles:
    """A tree of triangles on the device."""

    def __init__(self, device: Device, corners: np.ndarray, tree: TriangleTree) -> None:
        """corners: (T, 3, 3) float32, from which the tree was built."""
        self._device, self._order = device, tree.order
        self._uniforms = TRACE_BLOCK.record(leaves=tree.leaves, in_leaf=tree.in_leaf)
        boxes = np.zeros((2 * tree.leaves, 8), np.float32)
        boxes[:, :3], boxes[:, 4:7] = tree.low, tree.high
        edges = np.zeros((len(tree.order), 3, 4), np.float32)
        edges[..., :3] = corners[tree.order]
        edges[:, 1:, :3] -= edges[:, :1, :3]
        self._textures: dict[str, Texture] = {"ps_boxes": paged_texture(device, boxes, NODE_WIDTH)}
        self._textures["ps_triangles"] = paged_texture(device, edges.reshape(-1, 12), NODE_WIDTH)

    def trace(
        self, origin: np.ndarray, direction: np.ndarray, rows: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Traces rays from origins (N, 3) in directions (N, 3).

        rows: (N,), of coherent_rows. Returns the triangles that they meet first, (N,) int64, -1 where there is none;
        how far away these are in lengths of the directions, (N,) float32; and the weights of their corners 1 and 2,
        (N, 2) float32.
        """
        device = self._device
        if not len(origin):
            return np.zeros(0, np.int64), np.zeros(0, np.float32), np.zeros((0, 2), np.float32)
        height = int(rows.max()) // RECEIVER_WIDTH + 1
        laid = np.zeros((2, RECEIVER_WIDTH * height, 4), np.float32)
        laid[0, rows, :3], laid[0, rows, 3], laid[1, rows, :3] = origin, 1, direction
        rays = [device.texture((RECEIVER_WIDTH, height), "RGBA32F", one.reshape(-1)) for one in laid]
        hits = device.texture((RECEIVER_WIDTH, height), "RGBA32F")
        target = device.target([hits])
        try:
            textures = {**self._textures, "ps_origins": rays[0], "ps_directions": rays[1]}
            device.draw(TRACE, target, uniforms=self._uniforms, textures=textures)
            found = device.read(hits).reshape(-1, 4)[rows]
        finally:
            for item in (target, hits, *rays):
                item.release()
        number = np.rint(found[:, 0]).astype(np.int64)
        return np.where(number < 0, -1, self._order[number]), found[:, 1], found[:, 2:]

    def release(self) -> None:
        for texture in self._textures.values():
            texture.release()
