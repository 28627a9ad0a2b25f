"""Textures of the light tree and of receivers: shaders/lib/indirect/tree.glsl reads them."""

from __future__ import annotations

import numpy as np

from ....core.indirect.sites import quantised_directions
from ....core.indirect.tree import LightTree
from ....core.numeric.vectors import each_block
from ...device.packing import OCT_STEPS, octahedral
from ...device.protocol import Device, Texture

NODE_WIDTH = 1024  # nodes in a row of the texture, of four texels each
MEDIA_WIDTH = 1024  # cells of media in a row, of one texel each
RECEIVER_WIDTH = 1024  # receivers in a row, of three texels each
EDGE_STEPS, EDGE_OCTAVE = 1024, 64  # of how far edges are turned, and of their lengths; of these in an octave
LEVELS = 63  # steps of shares that are packed into six bits
MANTISSA = 4096  # steps of radiance below the largest of its channels' power of two
ROUND = 2.0**21  # the bit of nodes whose surfels are all balls
CAPTURED = 2.0**22  # and of nodes that hold mostly captured splats
SHINING = 2.0**23  # and of those that mostly emit light
LEVEL_BITS = 31  # of the radius, which hold how many times the tree's cube is halved to a node's cell
LEAST_LENGTH = 1e-12  # of `facing`, where it has a sign
FLOAT_BIAS, FLOAT_BITS = 127, 23  # of the exponent of a float32; of its mantissa
EXPONENTS = 1024  # half the range of exponents


def node_rows(tree: LightTree, radiance: np.ndarray) -> np.ndarray:
    """Returns the texels of nodes, (M, 16) float32; radiance: (3, M, 3), as of LightTree.radiance.

    texel 0  place and radius of the node, whose last five bits are its level
          1  area, less than 0 where it only stands for fine triangles near it; its first child, or for a leaf -1 less
             the code of its edge, 0: it has none; its octants, 8 bits,
             whether it is scattered, 1 bit, how far normals lie along the axis and how thick it is along that over
             its radius, 6 bits each, whether it holds balls alone, captured splats, and what emits light, 1
             bit each; the axis
          2  direction and length of `facing`, which is less than 0 where leaves or hairs are bodies; radiance before,
             in two numbers
          3  radiance behind and inside, in two numbers each
    """
    return with_radiance(node_shapes(tree), radiance)


def with_radiance(shapes: np.ndarray, radiance: np.ndarray) -> np.ndarray:
    """Returns such texels from those of node_shapes, (M, 16)."""
    found = np.empty_like(shapes)

    def pack(block: slice) -> None:
        found[block, :10] = shapes[block, :10]
        for column, side in enumerate(radiance):
            found[block, 10 + 2 * column : 12 + 2 * column] = packed_radiance(side[block])

    each_block(len(found), pack)
    return found


def node_shapes(tree: LightTree) -> np.ndarray:
    """Returns what the texels of nodes hold beside radiance, as node_rows."""
    found = np.zeros((len(tree), 16), np.float32)
    found[:, :3], found[:, 4] = tree.position, tree.area
    found[:, 3] = ((tree.radius.view(np.int32) + LEVEL_BITS & ~LEVEL_BITS) | tree.level).view(np.float32)
    if tree.rough is not None:
        found[:, 4] *= np.where(tree.rough, -1, 1)
    found[:, 5] = np.where(tree.first < 0, -1, tree.first)
    leaves = np.flatnonzero((tree.first < 0) & tree.edge.any(axis=1))

    def turn(block: slice) -> None:
        found[leaves[block], 5] -= _edge_codes(tree, leaves[block])

    each_block(len(leaves), turn)
    thickness = np.ceil(LEVELS * np.minimum(tree.thickness / tree.radius * (1 + 1e-6), 1.0))
    found[:, 6] = (
        tree.octants + 256.0 * (tree.scattered > 0.5) + 512.0 * np.rint(LEVELS * tree.along) + 32768.0 * thickness
    )
    # Leaves of two sheets may face no side either, but hairs are only what has no normals.
    of_hairs = np.zeros(len(tree), bool) if tree.round is None else tree.round
    found[:, 6] += ROUND * (~tree.facing.any(axis=1) & (of_hairs | (tree.scattered <= 0.5)))
    if tree.captured is not None:
        found[:, 6] += CAPTURED * tree.captured
    if tree.shining is not None:
        found[:, 6] += SHINING * tree.shining
    found[:, 7], found[:, 8] = octahedral(tree.axis), octahedral(tree.facing)
    found[:, 9] = np.sqrt((tree.facing**2).sum(axis=1))
    if tree.solid is not None:
        found[tree.solid, 9] = -np.maximum(found[tree.solid, 9], LEAST_LENGTH)
    return found


def _edge_codes(tree: LightTree, leaves: np.ndarray) -> np.ndarray:
    """(n,): whole numbers for edges of leaves (n,), from 1 on: whether they are of triangles, how far they are turned
    about the axis, and the binary logarithm of their lengths over those of squares."""
    # The axis as the device reads it.
    axis = quantised_directions(tree.axis[leaves].astype(np.float64), OCT_STEPS)[1]
    edge, half = tree.edge[leaves], tree.half[leaves]
    x, y, z = axis.T
    none = np.zeros_like(x)
    first = np.where(np.abs(z) < 0.7, (y, -x, none), (none, z, -y)).T
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis, first)
    along, beside = ((edge * one).sum(axis=1) for one in (first, second))
    length = np.hypot(along, beside)
    turn = np.rint(np.arctan2(beside, along) / (2 * np.pi) * EDGE_STEPS) % EDGE_STEPS
    square = np.sqrt(np.maximum(tree.area[leaves] * np.where(half, 2, 1), 1e-30))
    ratio = np.log2(np.maximum(length, 1e-30) / square)
    steps = np.clip(np.rint(ratio * EDGE_OCTAVE) + EDGE_STEPS // 2, 0, EDGE_STEPS - 1)
    return 1 + (half * EDGE_STEPS + turn) * EDGE_STEPS + steps


def packed_radiance(radiance: np.ndarray) -> np.ndarray:
    """Packs radiance (N, 3) into two whole numbers below 2^24, (N, 2): exponent and red, green and blue."""
    values = np.clip(radiance.T, 0.0, 1e30, dtype=np.float32)
    exponent = np.frexp(np.maximum(values.max(axis=0), np.float32(1e-30)))[1]
    # As ldexp, which takes several times longer.
    scale = (FLOAT_BIAS - exponent << FLOAT_BITS).view(np.float32) * MANTISSA
    red, green, blue = np.minimum(np.rint(values * scale), MANTISSA - 1)
    return np.column_stack([(exponent + EXPONENTS) * np.float32(MANTISSA) + red, green * MANTISSA + blue])


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
