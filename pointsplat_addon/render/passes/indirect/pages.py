"""Textures of the light tree and of receivers: shaders/lib/indirect/tree.glsl reads them."""

from __future__ import annotations

import numpy as np

from ....core.indirect.sites import quantised_directions
from ....core.indirect.tree import LightTree
from ...device.packing import OCT_STEPS, octahedral
from ...device.protocol import Device, Texture

NODE_WIDTH = 1024  # nodes in a row of the texture, of four texels each
RECEIVER_WIDTH = 1024  # receivers in a row, of three texels each
EDGE_STEPS, EDGE_OCTAVE = 1024, 64  # of how far edges are turned, and of their lengths; of these in an octave
LEVELS = 63  # steps of shares that are packed into six bits
MANTISSA = 4096  # steps of radiance below the largest of its channels' power of two
EXPONENTS = 1024  # half the range of exponents


def node_rows(tree: LightTree, radiance: np.ndarray) -> np.ndarray:
    """Returns the texels of nodes, (M, 16) float32; radiance: (3, M, 3), as of LightTree.radiance.

    texel 0  place and radius of the node
          1  area; its first child, or for a leaf -1 less the code of its edge; its octants, 8 bits, whether it is
             scattered, 1 bit, and how far normals lie along the axis, 6 bits; the axis
          2  direction and length of `facing`; radiance before, in two numbers
          3  radiance behind and inside, in two numbers each
    """
    length = np.linalg.norm(tree.facing, axis=1)
    bits = tree.octants.astype(np.float64) + 256.0 * (tree.scattered > 0.5) + 512.0 * np.rint(LEVELS * tree.along)
    first = np.where(tree.first < 0, -1.0 - _edge_codes(tree), tree.first)
    rows = [tree.position, tree.radius, tree.area, first, bits, octahedral(tree.axis)]
    rows += [octahedral(tree.facing), length, *(packed_radiance(side) for side in radiance)]
    return np.column_stack(rows).astype(np.float32)


def _edge_codes(tree: LightTree) -> np.ndarray:
    """(M,): whole numbers for edges, from 1 on: whether they are of triangles, how far they are turned about the axis,
    and the binary logarithm of their lengths over those of squares; 0: there is none."""
    axis = quantised_directions(tree.axis.astype(np.float64), OCT_STEPS)[1]  # as the device reads it
    x, y, z = axis.T
    none = np.zeros_like(x)
    first = np.where(np.abs(z) < 0.7, (y, -x, none), (none, z, -y)).T
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis, first)
    along, beside = ((tree.edge * one).sum(axis=1) for one in (first, second))
    length = np.hypot(along, beside)
    turn = np.rint(np.arctan2(beside, along) / (2 * np.pi) * EDGE_STEPS) % EDGE_STEPS
    ratio = np.log2(np.maximum(length, 1e-30) / np.sqrt(np.maximum(tree.area * np.where(tree.half, 2, 1), 1e-30)))
    steps = np.clip(np.rint(ratio * EDGE_OCTAVE) + EDGE_STEPS // 2, 0, EDGE_STEPS - 1)
    return np.where(length > 0, 1 + (tree.half * EDGE_STEPS + turn) * EDGE_STEPS + steps, 0)


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
