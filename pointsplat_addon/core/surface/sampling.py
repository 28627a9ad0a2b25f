"""Triangles to surface samples, two ways: the vertices, and area-uniform rows.

A sample is a place on a triangle and an ellipse in barycentric coordinates, never a place in space. Both are
affine, so a mesh that deforms without changing its topology re-evaluates its samples: they neither move over
the surface nor open holes, whatever the pose or the camera.

The ellipses of a triangle's samples cover the triangle without holes, by construction:

- AREA cuts a triangle into cells and gives each cell an ellipse around it. A rectangle of half-sides
  (w, h) lies in the ellipse of half-axes sqrt(2) (w, h); a triangle lies in its Steiner circumellipse.
- VERTICES gives each vertex a disk as large as the farthest point of its triangles that has no nearer vertex.

Paper: Gunjee et al. 2007, section 4 (subdivide until a triangle is below a splat's area).

Lengths are object units. The work is done in float64 on blocks that fit the cache; what is kept is float32.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ..numeric.vectors import blocks, cross, dot, each_block
from ..scene.mesh import Mesh

METHODS = ("AUTO", "VERTICES", "AREA")
MAX_SAMPLES = 1 << 23  # of one mesh, at a tolerance of a pixel: 0.8 GB, and 0.3 on the device
MOST_SAMPLES = 1 << 24  # of one mesh, where finer tolerances ask for more
SMALLEST, LARGEST = 1e-18, 1e18  # edge length and coordinate whose squares float32 still holds

# Splats at a spacing s are at most s / sqrt(2) in radius: the disk around a square cell of side s.
_RADIUS = math.sqrt(0.5)
# Steiner's circumellipse has a major half-axis of at most 2/3 of the longest edge (reached by a needle with two
# long edges), so that up to this many spacings one sample is enough.
_ONE_SAMPLE = 1.5 * _RADIUS
# Float32 weights are off by up to 2^-24 each; half-diameters grown by this much still cover.
_WEIGHT_SLACK = 4e-7
# Steiner's circumellipse about the centroid: corner 1 seen from there, and an edge over sqrt(3), are conjugate.
_STEINER = np.array([[2 / 3, -1 / 3], [0, 1 / math.sqrt(3)]]) * (1 + 4 * _WEIGHT_SLACK)
_MIN_ASPECT = 2.0**-20  # minor over major half-axis: keeps conics invertible in float32


@dataclass(frozen=True, eq=False)
class Samples:
    """Places on a mesh's triangles, independent of its pose and of the camera."""

    method: str  # VERTICES, AREA, or PATCHES (of core/lens/dicing.py)
    triangle: np.ndarray  # (N,) int32, rows of Mesh.triangles
    barycentric: np.ndarray  # (N, 2) float32, weights of the triangle's corners 1 and 2
    # (N, 2, 2) float32: two conjugate half-diameters of the splat's ellipse, each as weights of corners 1 and 2
    # (a vector, so that corner 0 weighs minus their sum). None for VERTICES, whose disks follow the one-ring.
    ellipse: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.triangle)

    @property
    def nbytes(self) -> int:
        arrays = (self.triangle, self.barycentric, self.ellipse)
        return sum(a.nbytes for a in arrays if a is not None)


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Samples on one pose of their mesh: what a PointCloud needs of geometry."""

    origin: np.ndarray  # (3,) float64, object space
    position: np.ndarray  # (N, 3) float32, relative to origin
    normal: np.ndarray  # (N, 3) float32, unit, for shading: the mesh's own normals, interpolated
    plane: np.ndarray  # (N, 3) float32, unit, of the splat's plane: the triangle's, or the one-ring's mean
    radii: np.ndarray  # (N, 1) float32 radius of a disk, or (N, 2) half-axes of an ellipse, major first
    axis: np.ndarray | None = None  # (N, 3) float32, unit, perpendicular to `plane`: the major half-axis


@dataclass(frozen=True)
class DroppedCounts:
    """Triangles that are not drawn, by reason. Each is counted once, under the first reason that holds."""

    bad_index: int = 0  # a corner refers to no vertex
    non_finite: int = 0  # a corner holds a NaN or an infinity
    huge: int = 0  # a coordinate beyond LARGEST
    tiny: int = 0  # all edges below SMALLEST
    degenerate: int = 0  # no area, or a height that is rounding noise

    @property
    def total(self) -> int:
        return self.bad_index + self.non_finite + self.huge + self.tiny + self.degenerate

    def message(self, name: str) -> str:
        """One warning that names the object, or "" where nothing was dropped."""
        reasons = {
            "with an index out of range": self.bad_index,
            "with NaN or infinite coordinates": self.non_finite,
            "too large": self.huge,
            "too small": self.tiny,
            "without area": self.degenerate,
        }
        parts = [f"{count} {reason}" for reason, count in reasons.items() if count]
        if not parts:
            return ""
        noun = "triangle is" if self.total == 1 else "triangles are"
        return f"{name}: {self.total} {noun} not drawn ({', '.join(parts)})"


# --- Triangles ----------------------------------------------------------------------------------------------


def _corners(mesh: Mesh, rows: np.ndarray | slice, origin: np.ndarray | float = 0.0) -> np.ndarray:
    """(3 corners, 3 coordinates, n) float64 of the triangles that `rows` selects, relative to `origin`."""
    triangles = mesh.triangles[rows] if isinstance(rows, slice) else mesh.triangles.take(rows, axis=0)
    corners = np.empty((3, 3, len(triangles)))
    for corner, vertex in zip(corners, triangles.T, strict=True):
        _to_rows(mesh.position.take(vertex, axis=0), corner)
    if np.any(origin):
        corners -= np.asarray(origin, np.float64).reshape(-1, 1)
    return corners


def _to_rows(values: np.ndarray, out: np.ndarray) -> None:
    """(n, C) into (C, n). NumPy copies a whole transposed array several times more slowly."""
    for row, column in zip(out, values.T, strict=True):
        row[:] = column


def _to_columns(values: np.ndarray, out: np.ndarray) -> None:
    """(C, n) into (n, C)."""
    for column, row in zip(out.T, values, strict=True):
        column[:] = row


def _squared_edges(corners: np.ndarray) -> np.ndarray:
    """(3, n) squared lengths of the edges opposite corners 0, 1 and 2."""
    edges = [corners[2] - corners[1], corners[0] - corners[2], corners[1] - corners[0]]
    return np.stack([dot(e, e) for e in edges])


@dataclass(frozen=True, eq=False)
class Measures:
    """Shape of the M valid triangles of a mesh."""

    triangle: np.ndarray  # (M,) int32, rows of Mesh.triangles
    apex: np.ndarray  # (M,) uint8, the corner opposite the longest edge
    base: np.ndarray  # (M,) float64, length of the longest edge
    height: np.ndarray  # (M,) float64, of the apex over the base
    foot: np.ndarray  # (M,) float64 in [0, 1], where the apex stands on the base, from corner apex + 1
    longest: float  # edge of all
    vertices: int  # that the triangles use

    @property
    def area(self) -> float:
        return float((0.5 * self.base * self.height).sum())

    @property
    def nbytes(self) -> int:
        return sum(a.nbytes for a in (self.triangle, self.apex, self.base, self.height, self.foot))


def measure(mesh: Mesh, ok: np.ndarray | None = None) -> Measures:
    """What sampling asks of a mesh. `ok` (T,) bool is what `validate` returned, where it is at hand."""
    ok = validate(mesh)[0] if ok is None else ok
    rows = np.flatnonzero(ok).astype(np.int32)
    count = len(rows)
    apex = np.empty(count, np.uint8)
    base, height, foot = np.empty((3, count))

    def look(block: slice) -> None:
        corners = _corners(mesh, rows[block])
        opposite_0, opposite_1, opposite_2 = squared = _squared_edges(corners)
        product = cross(corners[1] - corners[0], corners[2] - corners[0])
        longest = squared.max(axis=0)
        # The first of equally long ones.
        first = opposite_0 == longest
        second = ~first & (opposite_1 == longest)
        # The edges opposite the base's end and opposite its start.
        from_start = np.where(first, opposite_2, np.where(second, opposite_0, opposite_1))
        from_end = np.where(first, opposite_1, np.where(second, opposite_2, opposite_0))
        apex[block] = np.where(first, 0, np.where(second, 1, 2))
        base[block] = np.sqrt(longest)
        height[block] = np.sqrt(dot(product, product)) / base[block]
        foot[block] = np.clip(0.5 + (from_start - from_end) / (2 * longest), 0.0, 1.0)

    each_block(count, look)
    vertices = int(np.count_nonzero(used(mesh, ok)))
    return Measures(rows, apex, base, height, foot, float(base.max(initial=0.0)), vertices)


def validate(mesh: Mesh) -> tuple[np.ndarray, DroppedCounts]:
    """Which triangles can be drawn, (T,) bool, and how many were dropped for which reason.

    A triangle is degenerate when a quarter of the spacing of float32 numbers, at its corner opposite the longest
    edge and along each coordinate axis, is enough to flatten it. Needles that are exactly representable stay,
    whatever their aspect ratio; so do triangles a few such spacings large, far from the origin.
    """
    triangles, vertices = mesh.triangles, len(mesh.position)
    count = len(triangles)
    ok = np.ones(count, bool)
    if count == 0:
        return ok, DroppedCounts()
    if triangles.min() < 0 or triangles.max() >= vertices:
        ok &= ((triangles >= 0) & (triangles < vertices)).all(axis=1)
    bad_index = count - int(np.count_nonzero(ok))

    dropped: list[list[int]] = []  # appending is safe from any thread

    def look(block: slice) -> None:
        rows = np.arange(block.start, block.stop)[ok[block]] if bad_index else block
        corners = _corners(mesh, rows)
        extent = np.abs(corners).max(axis=0)  # per coordinate; NaN spreads
        largest = extent.max(axis=0)
        finite = np.isfinite(largest)
        small = largest <= LARGEST
        with np.errstate(invalid="ignore", over="ignore"):
            squared = _squared_edges(corners)
            long_enough = squared.max(axis=0) >= SMALLEST**2
            flat = _flat(corners, squared, extent)
        kinds = ~finite, finite & ~small, small & ~long_enough, small & long_enough & flat
        dropped.append([int(np.count_nonzero(kind)) for kind in kinds])
        ok[rows] = small & long_enough & ~flat

    each_block(count, look)
    return ok, DroppedCounts(bad_index, *(sum(kind) for kind in zip(*dropped, strict=True)))


def _flat(corners: np.ndarray, squared: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """(n,) bool: moving the apex by a quarter of a float32 spacing flattens the triangle."""
    normal = cross(corners[1] - corners[0], corners[2] - corners[0])
    longest = squared.max(axis=0)
    # Most triangles are far from flat. The cross product of a shift and the base is at most shift times base.
    shift = 0.25 * np.finfo(np.float32).eps * extent.max(axis=0)
    flat = ~(dot(normal, normal) > 9 * shift * shift * longest)
    rows = np.flatnonzero(flat)
    if len(rows):
        corners, extent, normal = corners[:, :, rows], extent[:, rows], normal[:, rows]
        apex = squared[:, rows].argmax(axis=0)
        every = np.arange(len(rows))
        base = np.abs(corners[(apex + 2) % 3, :, every] - corners[(apex + 1) % 3, :, every]).T
        shift = 0.25 * np.finfo(np.float32).eps * extent
        noise = np.stack(
            [shift[(c + 1) % 3] * base[(c + 2) % 3] + shift[(c + 2) % 3] * base[(c + 1) % 3] for c in (0, 1, 2)]
        )
        flat[rows] = (np.abs(normal) <= noise).all(axis=0)
    return flat


# --- Sampling -----------------------------------------------------------------------------------------------


def sample(
    mesh: Mesh,
    spacing: float,
    method: str = "AUTO",
    ok: np.ndarray | None = None,
    measures: Measures | None = None,
) -> Samples:
    """Samples of `mesh` by one of METHODS. `ok` (T,) bool and `measures` are what `validate` and `measure` returned,
    where they are at hand.

    Raises ValueError for an unknown method, a spacing that is not a positive number, or more than 2^31 samples.
    """
    if method not in METHODS:
        raise ValueError(f"unknown sampling method {method!r}, expected one of {', '.join(METHODS)}")
    ok = validate(mesh)[0] if ok is None else ok
    if method == "AUTO":
        method = choose(mesh, spacing, ok, measures)
    if method == "VERTICES":
        return sample_vertices(mesh, ok)
    return sample_area(mesh, spacing, ok, measures)


def choose(mesh: Mesh, spacing: float, ok: np.ndarray | None = None, measures: Measures | None = None) -> str:
    """VERTICES where AREA would give no triangle more than one sample and vertices are fewer; else AREA."""
    _check_spacing(spacing)
    m = measure(mesh, ok) if measures is None else measures
    return "VERTICES" if m.longest <= _ONE_SAMPLE * spacing and m.vertices <= len(m.triangle) else "AREA"


def sample_vertices(mesh: Mesh, ok: np.ndarray | None = None) -> Samples:
    """One sample at each vertex that a valid triangle uses, in the order of vertices.

    The sample belongs to the first of its triangles, whose corner gives its UV and colour.
    """
    ok = validate(mesh)[0] if ok is None else ok
    rows = np.flatnonzero(ok)
    # The last assignment to a place stays; backwards, that is the first corner.
    corners = (rows[:, None] * 3 + np.arange(3))[::-1, ::-1].ravel()
    corner_of_vertex = np.full(len(mesh.position), -1, np.int64)
    corner_of_vertex[mesh.triangles.reshape(-1)[corners]] = corners
    triangle, corner = np.divmod(corner_of_vertex[corner_of_vertex >= 0], 3)
    barycentric = np.stack([corner == 1, corner == 2], axis=1).astype(np.float32)
    return Samples("VERTICES", triangle.astype(np.int32), barycentric)


def sample_area(mesh: Mesh, spacing: float, ok: np.ndarray | None = None, measures: Measures | None = None) -> Samples:
    """Samples at most `spacing` apart, one ellipse with half-axes of at most spacing / sqrt(2) for each cell.

    A triangle is cut into rows parallel to its longest edge and each row into equal columns, so that a sliver
    thinner than the spacing gets samples along its length only; a triangle smaller than a splat gets one.
    Raises ValueError for a spacing that is not a positive number, or for more than 2^31 samples.
    """
    _check_spacing(spacing)
    return _area_samples(measure(mesh, ok) if measures is None else measures, spacing)


def _area_samples(m: Measures, spacing: float) -> Samples:
    _check_count(_area_count(m, spacing))
    # Rows of cells, parallel to the base. y runs from the base (0) to the apex (1), x along the base (0 to 1).
    single = m.base <= _ONE_SAMPLE * spacing
    rows = np.where(single, 1.0, np.maximum(np.ceil(m.height / spacing), 1.0))
    triangle_of_row, k = _expand(rows)
    rows, alone, foot_of_row = rows[triangle_of_row], single[triangle_of_row], m.foot[triangle_of_row]
    low_of_row, high_of_row = k / rows, (k + 1) / rows
    columns = np.maximum(np.ceil(m.base[triangle_of_row] * (1 - low_of_row) / spacing), 1.0)
    columns[alone] = 1.0
    width_of_row = (1 - low_of_row) / columns
    row_of_sample, j = _expand(columns)

    count = len(row_of_sample)
    triangle = np.empty(count, np.int32)
    barycentric = np.empty((count, 2), np.float32)
    ellipse = np.empty((count, 2, 2), np.float32)

    def fill(block: slice) -> None:
        row = row_of_sample[block]
        t = triangle_of_row.take(row)
        triangle[block] = m.triangle.take(t)
        single = alone.take(row)
        if not single.all():
            low, foot, width = low_of_row.take(row), foot_of_row.take(row), width_of_row.take(row)
            left = foot * low + j[block] * width
            right = left + width
            # A cell ends where the triangle's roof does, so that its centre lies within the triangle.
            high = np.minimum(high_of_row.take(row), _roof(left, right, foot))
            x, y = (left + right) / 2, (low + high) / 2
            half_x = _RADIUS * width + _WEIGHT_SLACK
            half_y = _RADIUS * (high - low) + _WEIGHT_SLACK
            apex = m.apex.take(t)
            is_0, is_1 = apex == 0, apex == 1

            def to_corners(out: np.ndarray, start: np.ndarray, end: np.ndarray, top: np.ndarray | float) -> None:
                """Weights of corners 1 and 2 from those of the base's ends and of the apex."""
                out[:, 0] = np.where(is_0, start, np.where(is_1, top, end))
                out[:, 1] = np.where(is_0, end, np.where(is_1, start, top))

            end = x - foot * y
            to_corners(barycentric[block], *(np.minimum(np.maximum(w, 0.0), 1.0) for w in (1.0 - end - y, end, y)))
            to_corners(ellipse[block, 0], -half_x, half_x, 0.0)
            to_corners(ellipse[block, 1], (foot - 1) * half_y, -foot * half_y, half_y)
        if single.any():
            barycentric[block][single] = 1 / 3
            ellipse[block][single] = _STEINER

    each_block(count, fill)
    return Samples("AREA", triangle, barycentric, ellipse)


def _roof(left: np.ndarray, right: np.ndarray, foot: np.ndarray) -> np.ndarray:
    """Greatest height of the triangle over [left, right] of its base, as fractions."""
    smallest = np.finfo(np.float64).tiny
    rising = right / np.maximum(foot, smallest)
    falling = (1 - left) / np.maximum(1 - foot, smallest)
    return np.minimum(np.minimum(rising, falling), 1.0)


def _expand(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For counts [2, 0, 3]: owners [0, 0, 2, 2, 2] (int32) and positions within them [0, 1, 0, 1, 2] (int64)."""
    counts = counts.astype(np.int64)
    ends = np.cumsum(counts)
    total = int(ends[-1]) if len(ends) else 0
    owner = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    return owner, np.arange(total) - np.repeat(ends - counts, counts)


def _area_count(m: Measures, spacing: float) -> float:
    """At least as many samples as sample_area makes, and at most one more for each row."""
    return float(_area_counts(m, spacing).sum())


def _area_counts(m: Measures, spacing: float) -> np.ndarray:
    """(M,) the same of each triangle."""
    columns = m.base / spacing
    rows = np.maximum(np.ceil(m.height / spacing), 1.0)
    return np.where(columns <= _ONE_SAMPLE, 1.0, (columns * (rows + 1)) / 2 + rows)


def _check_spacing(spacing: float) -> None:
    if not (spacing > 0 and math.isfinite(spacing)):
        raise ValueError(f"spacing must be a positive number, not {spacing}")


def _check_count(count: float) -> None:
    if count >= 2**31:
        raise ValueError(f"{count:.3g} samples are too many; use a larger spacing")


def _take(m: Measures, rows: np.ndarray) -> Measures:
    return Measures(m.triangle[rows], m.apex[rows], m.base[rows], m.height[rows], m.foot[rows], m.longest, m.vertices)


# --- A pose of the samples ----------------------------------------------------------------------------------


def centre(mesh: Mesh) -> np.ndarray:
    """(3,) float64: the middle of the finite vertices' bounding box, rounded to float32: a sum is then exact."""
    low, high = bounding_box(mesh.position)
    if not max(np.abs(low).max(), np.abs(high).max()) <= LARGEST:
        low, high = bounding_box(mesh.position[(np.abs(mesh.position) <= LARGEST).all(axis=1)])
    return ((low + high) / 2).astype(np.float32).astype(np.float64)


def bounding_box(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner, (3,) float64, of points (V, 3); zeros where there are none."""
    if len(position) == 0:
        return np.zeros(3), np.zeros(3)
    # Column by column, which is several times faster than along the first axis.
    return np.array([c.min() for c in position.T], float), np.array([c.max() for c in position.T], float)


def evaluate(mesh: Mesh, samples: Samples, origin: np.ndarray | None = None, ok: np.ndarray | None = None) -> Evaluated:
    """Positions, normals and splats of `samples` on `mesh`: the mesh that was sampled, in this or another pose.

    `origin` (3,) float64 is what positions are relative to; None takes `centre(mesh)`, so that coordinates far
    from zero keep the precision of the mesh. `ok` is what `validate` returned for this pose, where it is at hand.
    Samples at vertices that the pose made non-finite are non-finite (`cloud.finite` drops them); those of triangles
    that lost their area have a radius of rounding size and some unit normal.
    """
    origin = centre(mesh) if origin is None else np.asarray(origin, np.float64)
    if samples.ellipse is None:
        return _evaluate_vertices(mesh, samples, origin, validate(mesh)[0] if ok is None else ok)
    return _evaluate_ellipses(mesh, samples, samples.ellipse, origin)


def _evaluate_ellipses(mesh: Mesh, samples: Samples, ellipse: np.ndarray, origin: np.ndarray) -> Evaluated:
    count = len(samples)
    position, plane, axis = (np.empty((count, 3), np.float32) for _ in range(3))
    normal = plane if mesh.vertex_normal is None and mesh.corner_normal is None else np.empty_like(plane)
    radii = np.empty((count, 2), np.float32)

    def fill(block: slice) -> None:
        triangles, own = _grouped(samples.triangle[block])
        flat, metric, normals = _per_triangle(mesh, triangles, origin, normal is not plane)
        weights = samples.barycentric[block].T.astype(np.float64, order="C")
        # What `own` holds is in range: nothing needs to be checked.
        flat, metric = flat.take(own, axis=1, mode="clip"), metric.take(own, axis=1, mode="clip")
        first, edges, face = flat[:3], (flat[3:6], flat[6:9]), flat[9:]
        place = _along(edges, weights) + first
        _to_columns(place, position[block])
        _to_columns(face, plane[block])

        shape = ellipse[block].transpose(1, 2, 0).astype(np.float64, order="C")
        major, length = _major_half_axis(edges, metric, shape)
        _to_columns(_unit(major, length, fallback=0), axis[block])
        # The product of the half-axes follows from the area, so that needles lose no digits.
        determinant = np.abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
        minor = determinant * metric[3] / np.maximum(length, np.finfo(np.float64).tiny)
        rounding = 2.0**-23 * np.abs(place).max(axis=0)  # of `position`: neighbours still meet
        radii[block, 0] = length + rounding
        radii[block, 1] = np.maximum(minor, _MIN_ASPECT * length) + rounding
        if normals is not None:
            smooth = normals.take(own, axis=1, mode="clip")
            with np.errstate(invalid="ignore"):  # as where they were taken
                mixed = smooth[:3] + _along((smooth[3:6], smooth[6:]), weights)
            _to_columns(_unit(mixed, np.sqrt(dot(mixed, mixed)), face), normal[block])

    each_block(count, fill)
    return Evaluated(origin, position, normal, plane, radii, axis)


def _grouped(triangle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles, and of which of them each sample is. Samples of a triangle follow one another."""
    first = np.ones(len(triangle), bool)
    np.not_equal(triangle[1:], triangle[:-1], out=first[1:])
    return triangle[first], np.cumsum(first) - 1


def _per_triangle(
    mesh: Mesh, triangles: np.ndarray, origin: np.ndarray, smooth: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """What the samples of M triangles share, as rows.

    (12, M) float64: corner 0 relative to `origin`, the edges from there to corners 1 and 2, the unit normal;
    (4, M) float64: the edges' dot products 1.1, 1.2, 2.2, and twice the area;
    (9, M) float32 where `smooth`: the mesh's own normal at corner 0, and how much those at 1 and 2 differ from it.
    """
    flat, metric = np.empty((12, len(triangles))), np.empty((4, len(triangles)))
    corners = _corners(mesh, triangles, origin)
    flat[:3] = corners[0]
    first, second = (np.subtract(corners[c], corners[0], out=flat[3 * c : 3 * c + 3]) for c in (1, 2))
    metric[:3] = dot(first, first), dot(first, second), dot(second, second)
    product = cross(first, second)
    metric[3] = np.sqrt(dot(product, product))
    flat[9:] = _unit(product, metric[3])
    if not smooth:
        return flat, metric, None
    normals = np.empty((3, 3, len(triangles)), np.float32)
    if mesh.corner_normal is not None:
        of_corner = mesh.corner_normal.take(triangles, axis=0).swapaxes(0, 1)
    else:
        assert mesh.vertex_normal is not None
        vertices = mesh.triangles.take(triangles, axis=0)
        of_corner = (mesh.vertex_normal.take(vertex, axis=0) for vertex in vertices.T)
    for values, out in zip(of_corner, normals, strict=True):
        _to_rows(values, out)
    with np.errstate(invalid="ignore"):  # what is no number is left out where it is used
        normals[1:] -= normals[0]
    return flat, metric, normals.reshape(9, -1)


def _along(edges: tuple[np.ndarray, np.ndarray], weights: np.ndarray | tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    return weights[0] * edges[0] + weights[1] * edges[1]


def _major_half_axis(
    edges: tuple[np.ndarray, np.ndarray], metric: np.ndarray, shape: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Major half-axes (3, n) and their lengths (n,) of ellipses with conjugate half-diameters p and q, whose weights of
    `edges` are the rows of shape (2, 2, n); metric (3.., n): the edges' dot products 1.1, 1.2, 2.2.

    The half-axis is p cos a + q sin a with tan 2a = 2 p.q / (p.p - q.q).
    """
    p, q = shape
    along_p = metric[0] * p[0] + metric[1] * p[1], metric[1] * p[0] + metric[2] * p[1]
    pp, pq = along_p[0] * p[0] + along_p[1] * p[1], along_p[0] * q[0] + along_p[1] * q[1]
    qq = metric[0] * q[0] * q[0] + 2 * metric[1] * q[0] * q[1] + metric[2] * q[1] * q[1]
    difference, twice = pp - qq, 2 * pq
    hypotenuse = np.sqrt(difference * difference + twice * twice)
    # Of cos a and sin a the larger comes from |cos 2a|, the other one from sin 2a: no digits are lost.
    circle = hypotenuse == 0
    hypotenuse[circle] = difference[circle] = 1
    large = np.sqrt(0.5 + 0.5 * np.abs(difference) / hypotenuse)
    small = pq / (hypotenuse * large)
    swap = difference < 0
    cosine, sine = np.where(swap, small, large), np.where(swap, large, small)
    major = _along(edges, (cosine * p[0] + sine * q[0], cosine * p[1] + sine * q[1]))
    return major, np.sqrt(dot(major, major))


def _unit(vectors: np.ndarray, length: np.ndarray, fallback: np.ndarray | int = 2) -> np.ndarray:
    """vectors (3, n) over their length (n,); where that is zero or no number, `fallback`: (3, n), or an axis' index."""
    good = (length > 0) & (length < np.inf)
    if good.all():
        return vectors / length
    other = np.eye(3)[fallback][:, None] if isinstance(fallback, int) else fallback
    return np.where(good, vectors / np.where(good, length, 1), other)


def _evaluate_vertices(mesh: Mesh, samples: Samples, origin: np.ndarray, ok: np.ndarray) -> Evaluated:
    vertex = mesh.triangles[samples.triangle, _corner(samples)]
    mean, radius = _one_rings(mesh, ok)
    plane = mean[vertex]
    normal = plane
    if mesh.vertex_normal is not None:
        own = mesh.vertex_normal[vertex].T
        normal = _unit(own, np.sqrt(dot(own, own)), plane.T).T.astype(np.float32)
    position = (mesh.position[vertex] - origin).astype(np.float32)
    rounding = np.float32(2.0**-23) * np.abs(position).max(axis=1)
    return Evaluated(origin, position, normal, plane, (radius[vertex] + rounding)[:, None])


def _corner(samples: Samples) -> np.ndarray:
    """(N,) the corner of its triangle where each vertex sample sits."""
    return (samples.barycentric @ np.array([1, 2], np.float32)).astype(np.int8)


def vertices_of(mesh: Mesh, samples: Samples) -> np.ndarray:
    """(N,) the vertex where each vertex sample sits."""
    return mesh.triangles[samples.triangle, _corner(samples)]


def _one_rings(mesh: Mesh, ok: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex, from its valid triangles: area-weighted mean normal (V, 3) and disk radius (V,), float32.

    The disks of a triangle's corners cover it: the radius is that of `_covering_radius`, over the cosine between
    the triangle's normal and the disk's (up to 60 degrees), because seen along the triangle's normal the disk is
    that much narrower.
    """
    rows = np.flatnonzero(ok)
    vertex_of_corner = mesh.triangles.take(rows, axis=0).T.astype(np.intp, order="C")  # (3, M)
    count, vertices = len(rows), len(mesh.position)
    covering = np.empty(count)
    product = np.empty((3, count))
    for block in blocks(count):
        corners = _corners(mesh, rows[block])
        product[:, block] = cross(corners[1] - corners[0], corners[2] - corners[0])
        covering[block] = _covering_radius(_squared_edges(corners), np.sqrt(dot(product[:, block], product[:, block])))

    total = np.zeros((3, vertices))
    for c in range(3):
        for vertex in vertex_of_corner:
            total[c] += np.bincount(vertex, product[c], vertices)
    mean = np.ascontiguousarray(_unit(total, np.sqrt(dot(total, total))).T, np.float32)

    radius = np.zeros(vertices)
    for block in blocks(count):
        face = product[:, block] / np.sqrt(dot(product[:, block], product[:, block]))
        for vertex in vertex_of_corner[:, block]:
            cosine = np.maximum(np.abs(dot(face, mean.take(vertex, axis=0).T)), 0.5)
            np.maximum.at(radius, vertex, covering[block] / cosine)
    return mean, (radius * (1 + 2.0**-22)).astype(np.float32)


def _covering_radius(squared: np.ndarray, double_area: np.ndarray) -> np.ndarray:
    """(n,) the least radius at which equal disks at its corners cover a triangle.

    Acute: the circumradius. Otherwise the bisector of the longer of the two other edges, b, meets the longest
    edge, c, at the point farthest from all corners, c b^2 / (b^2 + c^2 - a^2) from b's end.
    """
    x, y, z = squared
    a, c = np.minimum(np.minimum(x, y), z), np.maximum(np.maximum(x, y), z)
    b = np.maximum(np.minimum(x, y), np.minimum(np.maximum(x, y), z))
    c_length = np.sqrt(c)
    circumradius = np.sqrt(a) * np.sqrt(b) * c_length / np.maximum(2 * double_area, np.finfo(np.float64).tiny)
    # Of acute triangles the circumradius is between these bounds, whatever rounding makes of the area.
    acute = np.clip(circumradius, c_length / 2, c_length / math.sqrt(3))
    return np.where(a + b > c, acute, c_length * b / np.maximum(b + c - a, np.finfo(np.float64).tiny))


def areas(mesh: Mesh, samples: Samples, ok: np.ndarray | None = None) -> np.ndarray:
    """(N,) float64: the area, in object units squared, that each sample stands for on this pose of its mesh.

    A vertex stands for a third of each valid triangle around it. The others share their own triangle, by what of it
    lies in their cells (AREA) or by the sizes of their ellipses (PATCHES): the areas of a triangle's samples add up to
    the triangle's, and where a pose only stretches it, each keeps its share. `ok` is what `validate` returned.
    """
    if samples.ellipse is None:
        rows = np.flatnonzero(validate(mesh)[0] if ok is None else ok)
        area, vertices = _triangle_areas(mesh, rows), len(mesh.position)
        ring = sum((np.bincount(corner, area / 3, vertices) for corner in mesh.triangles[rows].T), np.zeros(vertices))
        return ring[mesh.triangles[samples.triangle, _corner(samples)]]
    share = np.empty(len(samples))
    for block in blocks(len(samples)):
        shape = samples.ellipse[block].transpose(1, 2, 0).astype(np.float64)
        share[block] = np.abs(shape[0, 0] * shape[1, 1] - shape[0, 1] * shape[1, 0])
        if samples.method == "AREA":
            weights = samples.barycentric[block].T.astype(np.float64)
            # What is nothing but rounding still counts.
            share[block] = np.maximum(_cell_area(weights, shape), 1e-6 * share[block])
    total = np.bincount(samples.triangle, share, len(mesh.triangles))
    used = np.flatnonzero(total)
    per_share = np.zeros(len(total))
    per_share[used] = _triangle_areas(mesh, used) / total[used]
    return share * per_share[samples.triangle]


def _triangle_areas(mesh: Mesh, rows: np.ndarray) -> np.ndarray:
    area = np.empty(len(rows))
    for block in blocks(len(rows)):
        corners = _corners(mesh, rows[block])
        product = cross(corners[1] - corners[0], corners[2] - corners[0])
        area[block] = 0.5 * np.sqrt(dot(product, product))
    return area


def _cell_area(weights: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """(n,) area of AREA's cells within their triangles, where the base and the height have length 1.

    weights (2, n) and shape (2, 2, n) are Samples.barycentric and Samples.ellipse of cells, which tell the cells'
    bounds; those of triangles with a single sample give anything.
    """
    along, up = (np.stack([-a - b, a, b]) for a, b in shape)  # half-diameters as weights of all three corners
    place = np.stack([1 - weights[0] - weights[1], *weights])
    apex = np.abs(along).argmin(axis=0)[None]
    end = (apex + 2) % 3

    def at(values: np.ndarray, corner: np.ndarray) -> np.ndarray:
        return np.take_along_axis(values, corner, axis=0)[0]

    half_y = at(up, apex)
    foot = np.clip(-at(up, end) / half_y, 0.0, 1.0)
    width = (np.abs(at(along, end)) - _WEIGHT_SLACK) / _RADIUS
    height = (half_y - _WEIGHT_SLACK) / _RADIUS
    x, y = at(place, end) + foot * at(place, apex), at(place, apex)
    low, high = y - height / 2, y + height / 2
    smallest = np.finfo(np.float64).tiny

    def missing(x: np.ndarray) -> np.ndarray:
        """The area above the roof and below `high`, from 0 to x."""
        before = np.maximum(high - x / np.maximum(foot, smallest), 0.0)
        after = np.maximum(high - (1 - x) / np.maximum(1 - foot, smallest), 0.0)
        return (foot * (high**2 - before**2) + (1 - foot) * after**2) / 2

    left, right = np.maximum(x - width / 2, 0.0), np.minimum(x + width / 2, 1.0)
    return (high - low) * (right - left) - (missing(right) - missing(left))


def interpolate(mesh: Mesh, samples: Samples, per_corner: np.ndarray) -> np.ndarray:
    """(N, C) float32: an attribute of corners, (T, 3, C), at the samples. Vertex samples take their corner's value."""
    if samples.ellipse is None:
        return np.asarray(per_corner[samples.triangle, _corner(samples)], np.float32)
    result = np.empty((len(samples), per_corner.shape[2]), np.float32)
    for block in blocks(len(samples)):
        a, b, c = per_corner.take(samples.triangle[block], axis=0).transpose(1, 2, 0)
        weights = samples.barycentric[block].T
        with np.errstate(invalid="ignore"):
            result[block] = (a + weights[0] * (b - a) + weights[1] * (c - a)).T
    return result


def along_half_axes(samples: Samples, per_corner: np.ndarray) -> np.ndarray:
    """(2, N, C) float32: how an attribute of corners, (T, 3, C), changes along two conjugate half-diameters of each
    sample's splat. Splats at vertices reach to the middles of their triangle's edges."""
    result = np.empty((2, len(samples), per_corner.shape[2]), np.float32)
    for block in blocks(len(samples)):
        a, b, c = per_corner.take(samples.triangle[block], axis=0).transpose(1, 0, 2)
        for k in range(2):
            if samples.ellipse is None:
                result[k, block] = 0.5 * ((b - a) if k == 0 else (c - a))
            else:
                weights = samples.ellipse[block, k]
                with np.errstate(invalid="ignore"):
                    result[k, block] = weights[:, :1] * (b - a) + weights[:, 1:] * (c - a)
    return result


def material_ids(mesh: Mesh, samples: Samples) -> np.ndarray:
    """(N,) uint16, rows of the scene's material table."""
    if mesh.material is None:
        return np.full(len(samples), mesh.materials[0], np.uint16)
    return mesh.material[samples.triangle]


# --- Which spacing ------------------------------------------------------------------------------------------


def quantise_spacing(spacing: float) -> float:
    """The next power of two that is not coarser, so that cameras and frames share samples; inf stays inf.

    Raises ValueError where `spacing` is not positive.
    """
    if not spacing > 0:
        raise ValueError(f"spacing must be positive, not {spacing}")
    return spacing if math.isinf(spacing) else math.ldexp(0.5, math.frexp(spacing)[1])


def estimate_by_part(m: Measures, spacing: float, part: np.ndarray, parts: int) -> np.ndarray:
    """(parts,) float64: about how many samples AREA makes of the triangles of each part; `part` (M,) names them."""
    _check_spacing(spacing)
    return np.bincount(part, _area_counts(m, spacing), parts)


def some(m: Measures, which: np.ndarray) -> Measures:
    """Of some triangles, `which` (M,) bool. What vertices they use is estimated by their share."""
    share = np.count_nonzero(which) / max(len(which), 1)
    part = _take(m, which)
    return replace(part, longest=float(part.base.max(initial=0.0)), vertices=math.ceil(share * m.vertices))


def taken(samples: Samples, rows: np.ndarray) -> Samples:
    """Some samples, in the order of `rows`."""
    ellipse = None if samples.ellipse is None else samples.ellipse.take(rows, axis=0)
    return Samples(samples.method, samples.triangle[rows], samples.barycentric.take(rows, axis=0), ellipse)


def used(mesh: Mesh, ok: np.ndarray) -> np.ndarray:
    """(V,) bool: vertices of valid triangles."""
    used = np.zeros(len(mesh.position), bool)
    used[(mesh.triangles if ok.all() else mesh.triangles[ok]).reshape(-1)] = True
    return used


def limit_spacing(
    mesh: Mesh,
    spacing: float,
    max_samples: int = MAX_SAMPLES,
    ok: np.ndarray | None = None,
    measures: Measures | None = None,
) -> float:
    """`spacing`, or the finest octave above it at which AREA makes at most `max_samples` samples.

    Where the mesh has more triangles than that, the finest octave that gives each triangle one sample.
    """
    m = measure(mesh, ok) if measures is None else measures
    if len(m.triangle) == 0 or _area_count(m, spacing) <= max_samples:
        return spacing
    one_each = m.longest / _ONE_SAMPLE
    spacing = quantise_spacing(max(spacing, math.sqrt(m.area / max_samples) / 2))
    while _area_count(m, spacing) > max_samples and spacing < one_each:
        spacing *= 2
    return spacing
