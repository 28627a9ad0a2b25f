"""Textures of the light tree and of receivers: shaders/lib/indirect/tree.glsl reads them."""

from __future__ import annotations

import numpy as np

from ....core.indirect.tree import LightTree
from ...device.protocol import Device, Texture

NODE_WIDTH = 2048  # nodes in a row of textures, of two texels each
RECEIVER_WIDTH = 1024  # receivers in a row, of three texels each


def node_texture(device: Device, tree: LightTree) -> Texture:
    """Returns the texture of where nodes are: place and radius; normal times share, and area."""
    rows = np.column_stack([tree.position, tree.radius, tree.facing, tree.area])
    return _texture(device, rows, NODE_WIDTH)


def light_texture(device: Device, tree: LightTree, outside: np.ndarray, inside: np.ndarray) -> Texture:
    """Returns the texture of nodes' radiance, (M, 3) of either side, with what says where their children are."""
    bits = tree.octants + 256.0 * (tree.scattered > 0.5) + np.minimum(0.5 * tree.closed, 0.499)
    return _texture(device, np.column_stack([outside, bits, inside, tree.first]), NODE_WIDTH)


def receiver_texture(
    device: Device, position: np.ndarray, normal: np.ndarray, mirror: np.ndarray, sharpness: np.ndarray
) -> Texture:
    """Returns the texture of N receivers: places, normals and mirrored views (N, 3), in the tree's space, and how sharp
    the lobes around these are, (N,)."""
    count = len(position)
    zero = np.zeros(count, np.float32)
    return _texture(device, np.column_stack([position, sharpness, normal, zero, mirror, zero]), RECEIVER_WIDTH)


def _texture(device: Device, rows: np.ndarray, width: int) -> Texture:
    """Of rows (N, 4 k), so many of them side by side."""
    height = max(-(-len(rows) // width), 1)
    data = np.zeros((width * height, rows.shape[1]), np.float32)
    data[: len(rows)] = rows
    return device.texture((width * rows.shape[1] // 4, height), "RGBA32F", data.reshape(-1))
