"""Dicing of strands that are out of focus into patches: flat ellipses that face the eye (core/lens/kernel.py)."""

from __future__ import annotations

import numpy as np

from ..numeric.segments import owners, ranks
from ..numeric.vectors import basis, unit_rows
from ..scene.camera import Camera
from ..scene.cloud import PointCloud
from ..scene.strands import Strands
from ..splat.blur import IN_FOCUS, OUT_OF_FOCUS, Blur
from ..strand.levels import StrandLevels
from ..strand.projection import tube_radius_scale

LEAST_BEND_COSINE = 0.5  # cosine of half the sharpest bend whose sides meet
MOST_STRIPS = 16  # strips of a wide tube
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
END_FINENESS = 2.0  # widths of strips over those of the patches that close ends, which have an outline of their own
MOST_PATCHES = 1 << 21  # patches of one instance: beyond it they are not made shorter
RECTANGLE_SHARE = 3 / np.pi  # of the ellipse with its moments, that a rectangle covers


def dice_strands(
    strands: StrandLevels,
    lines: Strands,
    ends: np.ndarray,
    view_from_object: np.ndarray,
    camera: Camera,
    tolerance: float,
    blur: Blur,
) -> PointCloud:
    """Splats of those segments `ends` (K, 2) of one instance that may be out of focus, in object space.

    view_from_object: (4, 4); tolerance: pixels. The cloud's `kernel` is 1 for splats that are shaded as whole strands,
    whose major axes are the tangents, and 0 for those shaded as surfaces: ribbons, and tubes that are wider than
    patches may be, in strips along them, with disks that close their ends.

    Patches are at most as long as their disks of confusion allow (`Blur.largest_splat`).
    """
    matrix = np.asarray(view_from_object, np.float64)
    linear = matrix[:3, :3]
    scale = float(tube_radius_scale(matrix[None])[0])
    position = strands.position.astype(np.float64) + strands.origin
    low, high = _depths(strands, ends, matrix, camera)
    least, most = blur.radius_range(low, high)
    keep = (most > IN_FOCUS) & (high > camera.nearest)
    ends, least, low = ends[keep], least[keep], low[keep]
    per_pixel = (low if camera.perspective else 1.0) / max(abs(f) for f in camera.pixel_from_view()[:2])
    largest = blur.largest_splat(least, tolerance) * per_pixel  # view space
    along = (position[ends[:, 1]] - position[ends[:, 0]]) @ linear.T
    count = np.ceil(np.linalg.norm(along, axis=1) / largest)
    count = np.maximum(np.minimum(count, MOST_PATCHES / max(len(ends), 1)), 1).astype(np.int64)
    of, number = owners(count), ranks(count)
    part = ((number + 0.5) / count[of])[:, None]
    first, second = ends[of].T
    middle = position[first] * (1 - part) + position[second] * part
    axis = (position[second] - position[first]) / count[of][:, None]
    radius = (strands.radius[first] * (1 - part[:, 0]) + strands.radius[second] * part[:, 0]).astype(np.float64)

    # Towards the eye, in object space, across the strand.
    inverse = np.linalg.inv(linear) if abs(np.linalg.det(linear)) > 1e-300 else np.eye(3)
    toward = -(inverse @ matrix[:3, 3]) - middle if camera.perspective else np.broadcast_to(inverse[:, 2], middle.shape)
    length = np.linalg.norm(axis, axis=1)
    unit = axis / np.maximum(length, 1e-300)[:, None]
    if strands.side is None:
        facing = unit_rows(toward - (toward * unit).sum(axis=1, keepdims=True) * unit)
        side = np.cross(facing, unit)
        across = np.clip(np.ceil(2 * radius * scale / largest[of]), 1, MOST_STRIPS).astype(np.int64)
    else:
        side = unit_rows(strands.side[first] * (1 - part) + strands.side[second] * part)
        side = unit_rows(side - (side * unit).sum(axis=1, keepdims=True) * unit)
        facing = np.cross(unit, side)
        across = np.ones(len(of), np.int64)
    strip, which = owners(across), ranks(across)
    shift = ((2 * which + 1) / across[strip] - 1)[:, None]
    round_ = strands.side is None
    rising = np.sqrt(1 - shift**2) if round_ else np.ones_like(shift)
    normal = facing[strip] * rising + side[strip] * shift if round_ else facing[strip]
    wide = across[strip] > 1
    middle, length = middle[strip] + radius[strip, None] * (normal if round_ else 0.0) * wide[:, None], length[strip]
    if round_:
        begin, end = (
            np.where(
                wide & (number == last)[strip],
                radius[strip] * _mitre_length(strands, at[strip], unit[strip], normal),
                0.0,
            )
            for at, last in ((first, 0), (second, count[of] - 1))
        )
        begin, end = np.minimum(begin, length / 2), np.maximum(end, -length / 2)
        middle += unit[strip] * ((begin + end) / 2)[:, None]
        length = length + end - begin
    # Strips are as wide as each other where they are seen, and wider where they lean.
    half = np.stack([length / np.sqrt(3), 2 * radius[strip] / (across[strip] * rising[:, 0] * np.sqrt(3))], axis=1)
    # The wider of both half-axes comes first.
    turned = half[:, 1] > half[:, 0]
    major = np.where(turned[:, None], np.cross(normal, unit[strip]), unit[strip])
    whole = across[strip] == 1
    whole &= round_
    # What is shaded as a whole keeps its tangent and its area, however short it is.
    half[whole & turned] = np.sqrt(half[whole & turned].prod(axis=1, keepdims=True))
    major[whole] = unit[strip][whole]
    points, part = np.stack([first, second], axis=1)[strip], part[strip]
    if round_:
        closing, at, outward, wide = _end_disks(strands, ends, largest / scale)
        # What faces away closes nothing that is seen.
        eye = -(inverse @ matrix[:3, 3]) - at if camera.perspective else inverse[:, 2]
        seen = (outward * eye).sum(axis=1) > 0
        closing, at, outward, wide = closing[seen], at[seen], outward[seen], wide[seen]
        middle, normal = np.concatenate([middle, at]), np.concatenate([normal, outward])
        major = np.concatenate([major, basis(outward.T)[0].T])
        half = np.concatenate([half, np.stack([wide, wide], axis=1)])
        points = np.concatenate([points, np.stack([closing, closing], axis=1)])
        part = np.concatenate([part, np.zeros((len(closing), 1))])
        whole = np.concatenate([whole, np.zeros(len(closing), bool)])
    return PointCloud(
        (middle - strands.origin).astype(np.float32),
        strands.origin,
        normal=np.ascontiguousarray(normal, np.float32),
        axis=np.ascontiguousarray(major, np.float32),
        radii=-np.sort(-half, axis=1).astype(np.float32),
        material=strands.material[strands.strand[points[:, 0]]].astype(np.uint16),
        color=_interpolate(lines.color, points, part),
        surface=_interpolate(lines.surface, points, part),
        emission=_interpolate(lines.emission, points, part),
        kernel=whole.astype(np.uint8) if whole.any() else None,
    )


def _end_disks(
    strands: StrandLevels, ends: np.ndarray, largest: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The disks across both ends of tubes that are drawn in strips, in patches as wide as `largest` (K,), in object
    units, for each segment: their point (n,), middle (n, 3), normal (n, 3) and radius (n,), of which SHARE is the area.
    """
    strand = strands.strand[ends[:, 0]]
    outer = np.stack([strands.start[strand], strands.start[strand + 1] - 1], axis=1)
    closed = (strands.position[outer[:, 0]] == strands.position[outer[:, 1]]).all(axis=1)
    of, side = np.nonzero((ends == outer) & (2 * strands.radius[ends] > largest[:, None]) & ~closed[:, None])
    point = ends[of, side]
    radius = strands.radius[point].astype(np.float64)
    count = np.clip(np.ceil((END_FINENESS * 2 * radius / largest[of]) ** 2), 1, MOST_STRIPS**2).astype(np.int64)
    which, number = owners(count), ranks(count)
    # An even spiral; a single disk lies in its middle.
    away = np.where(count[which] > 1, np.sqrt((number + 0.5) / count[which]), 0) * radius[which]
    outward = strands.tangent[point].astype(np.float64) * np.where(side, 1, -1)[:, None]
    right, up = (a.T for a in basis(outward.T))
    angle = GOLDEN_ANGLE * number
    middle = (strands.position[point].astype(np.float64) + strands.origin)[which]
    middle += away[:, None] * (np.cos(angle)[:, None] * right[which] + np.sin(angle)[:, None] * up[which])
    return point[which], middle, outward[which], radius[which] / np.sqrt(RECTANGLE_SHARE * count[which])


def _mitre_length(strands: StrandLevels, point: np.ndarray, unit: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(n,): how far, in radii, the side of a tube with this normal (n, 3) goes on along its segment (n, 3) where that
    ends at a point (n,): to the plane through the point whose normal is the tangent of the strand there. Farther on the
    outer side of a bend, and less far on the inner one."""
    tangent = strands.tangent[point].astype(np.float64)
    return -(normal * tangent).sum(axis=1) / np.maximum((unit * tangent).sum(axis=1), LEAST_BEND_COSINE)


def may_be_in_focus(
    strands: StrandLevels, ends: np.ndarray, view_from_object: np.ndarray, camera: Camera, blur: Blur
) -> np.ndarray:
    """(K,) bool: which segments, by their end points (K, 2), may be partly in focus."""
    return (
        blur.radius_range(*_depths(strands, ends, np.asarray(view_from_object, np.float64), camera))[0] < OUT_OF_FOCUS
    )


def _depths(
    strands: StrandLevels, ends: np.ndarray, matrix: np.ndarray, camera: Camera
) -> tuple[np.ndarray, np.ndarray]:
    """The least and greatest depths (K,) of segments, with their radii around both ends."""
    depth = -((strands.position.astype(np.float64) + strands.origin) @ matrix[2, :3] + matrix[2, 3])
    reach = strands.radius * float(tube_radius_scale(matrix[None])[0])
    low, high = np.maximum(depth - reach, camera.nearest)[ends], np.maximum(depth + reach, camera.nearest)[ends]
    return low.min(axis=1), high.max(axis=1)


def _interpolate(values: np.ndarray | None, rows: np.ndarray, part: np.ndarray) -> np.ndarray | None:
    """Values between two rows (n, 2), a fraction `part` of the way from the first to the second; None stays None."""
    if values is None:
        return None
    return (values[rows[:, 0]] * (1 - part) + values[rows[:, 1]] * part).astype(np.float32)
