"""Textures of the light tree and of receivers: shaders/lib/indirect/tree.glsl reads them."""

from __future__ import annotations

import numpy as np

from ....core.indirect.tree import LightTree
from ...device.packing import octahedral
from ...device.protocol import Device, Texture

NODE_WIDTH = 1024  # nodes in a row of the texture, of four texels each
RECEIVER_WIDTH = 1024  # receivers in a row, of three texels each
LEVELS = 63  # steps of shares that are packed into six bits
MANTISSA = 4096  # steps of radiance below the largest of its channels' power of two
EXPONENTS = 1024  # half the range of exponents


def node_rows(tree: LightTree, radiance: np.ndarray) -> np.ndarray:
    """Returns the texels of nodes, (M, 16) float32; radiance: (3, M, 3), as of LightTree.radiance.

    texel 0  place and radius of the node
          1  area; its first child, or -1; its octants, 8 bits, whether it is scattered, 1 bit, and how far normals lie
             along the axis, 6 bits; the axis
          2  direction and length of `facing`; radiance before, in two numbers
          3  radiance behind and inside, in two numbers each
    """
    length = np.linalg.norm(tree.facing, axis=1)
    bits = tree.octants.astype(np.float64) + 256.0 * (tree.scattered > 0.5) + 512.0 * np.rint(LEVELS * tree.along)
    rows = [tree.position, tree.radius, tree.area, tree.first, bits, octahedral(tree.axis)]
    rows += [octahedral(tree.facing), length, *(packed_radiance(side) for side in radiance)]
    return np.column_stack(rows).astype(np.float32)


def packed_radiance(radiance: np.ndarray) -> np.ndarray:
    """Packs radiance (N, 3) into two whole numbers below 2^24, (N, 2): exponent and red, green and blue."""
    values = np.clip(radiance, 0.0, 1e30).astype(np.float64)
    exponent = np.frexp(np.maximum(values.max(axis=1), 1e-30))[1]
    steps = np.minimum(np.rint(np.ldexp(values, -exponent[:, None]) * MANTISSA), MANTISSA - 1)
    return np.column_stack([(exponent + EXPONENTS) * MANTISSA + steps[:, 0], steps[:, 1] * MANTISSA + steps[:, 2]])


def receiver_texture(
    device: Device, position: np.ndarray, normal: np.ndarray, mirror: np.ndarray, sharpness: np.ndarray
) -> Texture:
    """Returns the texture of N receivers: places, normals and mirrored views (N, 3), in the tree's space, and how sharp
    the lobes around these are, (N,)."""
    count = len(position)
    zero = np.zeros(count, np.float32)
    return paged_texture(device, np.column_stack([position, sharpness, normal, zero, mirror, zero]), RECEIVER_WIDTH)


def paged_texture(device: Device, rows: np.ndarray, width: int) -> Texture:
    """Returns the texture of rows (N, 4 k) of numbers, k texels each, `width` rows side by side."""
    height = max(-(-len(rows) // width), 1)
    data = np.zeros((width * height, rows.shape[1]), np.float32)
    data[: len(rows)] = rows
    return device.texture((width * rows.shape[1] // 4, height), "RGBA32F", data.reshape(-1))
