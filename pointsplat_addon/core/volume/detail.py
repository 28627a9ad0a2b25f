"""Level of detail of voxels: blocks of them that a view shows no larger than its pixels become one splat each, where
they are nearly even.

Merging keeps mass. What it changes is where in a block the mass is, and that matters by how much the optical depths of
the block's voxels differ: so dense outlines stay fine, and what is thin or even within becomes coarse.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numeric.linear import largest_singular_value
from ..scene.camera import Camera
from ..scene.cloud import PointCloud
from ..splat.kernel import EVEN_SPACING
from .lattice import group_equal_rows
from .normals import normalise

CONTRAST = 0.01  # optical depth, or radiance, across a voxel by which those of a block may differ
MOST_DEPTH = 0.15  # across a block: light may not end within it
NEAREST_LAMP = 4.0  # edges of a block that a lamp is away at least: within it, light changes by a few per cent
CHILDREN = 8


def voxel_edge(cloud: PointCloud) -> float:
    """Returns the mean edge in object units of the voxels that the points of a cloud (N, ...) stand for, N > 0."""
    assert cloud.radii is not None
    return float(np.prod(cloud.radii[0].astype(np.float64)) ** (1 / cloud.radii.shape[1])) / (2 * EVEN_SPACING)


def widest_voxel(cloud: PointCloud, view_from_object: np.ndarray, camera: Camera) -> float:
    """Returns how many pixels long the edge of a volume's voxel is at most.

    Of voxels that instances (I, 4, 4) show in the whole picture, whichever part of it is drawn; 0 where they show none.
    """
    fx, fy, cx, cy = camera.pixel_from_view()
    edge = voxel_edge(cloud) * max(abs(fx), abs(fy)) * largest_singular_value(view_from_object[:, :3, :3])
    if not camera.perspective:
        return float(edge.max(initial=0.0))
    (x0, y0, _, _), (width, height) = camera.window, camera.resolution
    widest = 0.0
    for matrix, own in zip(view_from_object, edge.tolist(), strict=True):
        rows = matrix[:3, :3].astype(np.float32)
        place = (matrix[:3, :3] @ cloud.origin + matrix[:3, 3]).astype(np.float32)
        x, y, z = (cloud.position @ row + at for row, at in zip(rows, place, strict=True))
        with np.errstate(all="ignore"):
            # Rims of voxels reach into the picture from outside.
            column, row, rim = cx + x0 - fx * x / z, cy + y0 - fy * y / z, 2 * own / -z
            seen = (z < -camera.near) & (column > -rim) & (column < width + rim) & (row > -rim) & (row < height + rim)
        widest = max(widest, own / -float(z.max(where=seen, initial=-np.inf)))
    return widest


def widened(level: int) -> float:
    """Returns by how much a splat that has the moments of 2^level voxels to a side is wider than that of one.

    Variances add up: a voxel's is EVEN_SPACING^2, and that of places 0 to 2^L - 1 is (4^L - 1) / 12.
    """
    return float(np.sqrt(1 + (4.0**level - 1) / (12 * EVEN_SPACING**2)))


def merged_where_even(cloud: PointCloud, cells: np.ndarray, levels: int, lamps: np.ndarray) -> PointCloud:
    """Returns a volume's points with those of even blocks, up to 2^levels voxels to a side, merged into one each.

    cloud: as of `volume_splats`, with N > 0 points of equal half-axes. cells: (N, 3) int of the lattice. lamps: (L, 4)
    places in object space and radii. Blocks lie on the lattice wherever voxels are, and do not swim in animations. In a
    block, optical depths along a voxel's edge, of what scatters too, and radiances differ by at most CONTRAST; all of
    it has a depth of at most MOST_DEPTH, and it is no wider than a NEAREST_LAMP-th of its distance to a lamp.
    """
    edge, found = voxel_edge(cloud), []
    whole = np.ones(len(cloud), bool)
    for level in range(1, levels + 1):
        order, first = group_equal_rows(cells >> 1)
        cells = (cells >> 1)[order[first]]
        even = _even(cloud, order, first, whole, edge)
        for lamp in lamps - [*cloud.origin, 0]:
            away = np.linalg.norm(cloud.position[order[first]] - lamp[:3], axis=1) - lamp[3]
            even &= away > NEAREST_LAMP * 2 * edge
        if not even.any():
            break
        inside = np.diff(np.append(first, len(order)))
        taken = np.empty(len(order), bool)
        taken[order] = np.repeat(even, inside)
        found.append(cloud.take(whole & ~taken))
        growth = widened(level) / widened(level - 1)
        cloud, whole, edge = _merged(cloud, order, first, inside, growth), even, 2 * edge
    found.append(cloud.take(whole))
    return _joined([part for part in found if len(part)])


def _even(cloud: PointCloud, order: np.ndarray, first: np.ndarray, whole: np.ndarray, edge: float) -> np.ndarray:
    """Returns which blocks may be merged, (K,) bool. order (N,), first (K,): of `group_equal_rows`. whole: (N,) bool,
    which points stand for all that lies in their cell. edge: of these cells."""
    assert cloud.extinction is not None
    assert cloud.radii is not None
    full = np.diff(np.append(first, len(order))) == CHILDREN
    even = np.logical_and.reduceat(whole[order], first)
    matter = cloud.extinction if cloud.extinction.ndim == 2 else cloud.extinction[:, None]
    shown = [matter[:, k] for k in range(matter.shape[1])]
    if cloud.color is not None and (cloud.color != cloud.color[0]).any():
        shown += [cloud.color[:, k] * matter[:, min(k, matter.shape[1] - 1)] for k in range(3)]
    volume = 4 / 3 * np.pi * (2 * EVEN_SPACING * voxel_edge(cloud)) ** 3  # over which a splat's extinction counts
    scale = np.float32(volume / edge**2)
    for values in shown + ([] if cloud.emission is None else list(cloud.emission.T)):
        values = values[order] * scale
        low = np.where(full, np.minimum.reduceat(values, first), 0)
        even &= np.maximum.reduceat(values, first) - low <= CONTRAST
    depth = np.add.reduceat(matter.max(axis=1)[order] * scale, first) * (2 / CHILDREN)
    return even & (depth <= MOST_DEPTH)


def _merged(cloud: PointCloud, order: np.ndarray, first: np.ndarray, inside: np.ndarray, growth: float) -> PointCloud:
    """Returns one point for each block, (K, ...), at its centre of mass. inside: (K,) how many it has. `growth`: of
    half-axes."""
    assert cloud.extinction is not None
    assert cloud.radii is not None
    matter = cloud.extinction
    depth = matter if matter.ndim == 1 else matter.mean(axis=1)
    weight = depth if cloud.emission is None else depth + cloud.emission.mean(axis=1)
    # What neither dims nor shines still has a position.
    weight = np.maximum(weight, max(float(weight.max()), 1e-30) * np.float32(1e-12))

    def total(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[order], first, axis=0, dtype=np.float64)

    mass = total(weight)[:, None]
    made = {
        "position": total(cloud.position * weight[:, None]) / mass,
        "radii": growth * cloud.radii[order[first]],
        "extinction": total(matter) / growth**3,
    }
    if cloud.color is not None:
        across = total(matter if matter.ndim == 2 else matter[:, None])
        scattering = total(cloud.color * (matter if matter.ndim == 2 else matter[:, None]))
        made["color"] = np.divide(scattering, across, out=np.zeros_like(scattering), where=across > 0)
    if cloud.emission is not None:
        made["emission"] = total(cloud.emission) / growth**3
    if cloud.value is not None:
        made["value"] = total(cloud.value) / inside
    if cloud.shading_normal is not None:
        made["shading_normal"] = normalise(total(cloud.shading_normal * weight[:, None]))
    kept = {name: array[order[first]] for name, array in cloud.arrays().items() if name not in made}
    return replace(cloud, **kept, **{name: array.astype(np.float32) for name, array in made.items()})


def _joined(parts: list[PointCloud]) -> PointCloud:
    """Returns the points of clouds with the same attributes."""
    if len(parts) == 1:
        return parts[0]
    return replace(parts[0], **{
        name: np.concatenate([part.arrays()[name] for part in parts]) for name in parts[0].arrays()
    })  # fmt: skip
