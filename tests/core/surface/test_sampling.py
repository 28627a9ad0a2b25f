"""Samples cover their triangles, wherever those lie and however thin they are."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.vectors import each_block
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.valid.geometry import DroppedTriangles, valid_mesh, valid_triangles
from pointsplat_addon.core.surface.area_sampling import estimate_by_part, sample_area
from pointsplat_addon.core.surface.density import PART, make_parts, required_spacing
from pointsplat_addon.core.surface.evaluation import evaluate
from pointsplat_addon.core.surface.samples import Samples, corner_of_sample, interpolate, material_ids
from pointsplat_addon.core.surface.sampling import choose_method, sample_mesh
from pointsplat_addon.core.surface.spacing import limit_spacing, quantise_spacing
from pointsplat_addon.core.surface.triangles import measure_triangles
from pointsplat_addon.core.surface.vertex_sampling import sample_vertices

METHODS = ("VERTICES", "AREA")


# --- Shapes -------------------------------------------------------------------------------------------------


def make(position, triangles, **attributes) -> Mesh:
    position = np.asarray(position, np.float32).reshape(-1, 3)
    return Mesh("key", "Test", position, np.asarray(triangles, np.int32).reshape(-1, 3), **attributes)


def soup(corners) -> Mesh:
    """A mesh of triangles (T, 3, 3) that share no vertex."""
    return make(corners, np.arange(3 * len(corners)))


def rotation(seed: int) -> np.ndarray:
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


def cube() -> Mesh:
    position = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, -1).T
    quads = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return make(position, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))


def wave(n: int, height: float = 0.3) -> Mesh:
    """A square of n x n vertices with a wavy height."""
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    i = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([i, i + n, i + 1], 1), np.stack([i + 1, i + n, i + n + 1], 1)])
    return make(np.stack([x, y, height * np.sin(3 * x) * np.cos(4 * y)], -1), triangles)


def sphere(n: int) -> Mesh:
    """Latitudes and longitudes; the triangles at the poles are thin."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 2 * n), np.linspace(0.01, np.pi - 0.01, n), indexing="ij")
    position = np.stack([np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)], -1)
    i = (np.arange(2 * n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + n], 1), np.stack([i + 1, i + n + 1, i + n], 1)])
    return make(position, triangles)


def needles(aspect: float, turn: np.ndarray | None = None) -> Mesh:
    """Five triangles of length 1 and height 1/aspect, the apex at different places over the base."""
    foot = np.array([0.0, 0.1, 0.5, 0.73, 1.0])
    corners = np.zeros((5, 3, 3))
    corners[:, 1, 0] = 1
    corners[:, 2, 0] = foot
    corners[:, 2, 1] = 1 / aspect
    for row, shift in enumerate((0, 1, 2, 0, 1)):
        corners[row] = np.roll(corners[row], shift, axis=0)
    return soup(corners if turn is None else corners @ turn.T)


def random_soup(count: int, seed: int) -> Mesh:
    rng = np.random.default_rng(seed)
    size = 10 ** rng.uniform(-3, 0, (count, 1, 1))
    return soup(rng.uniform(-1, 1, (count, 1, 3)) + size * rng.normal(size=(count, 3, 3)))


SHAPES = {
    "cube": (cube(), 0.23),
    "cube on the grid": (cube(), 0.25),  # grid points on the faces' diagonals
    "sphere": (sphere(8), 0.15),
    "dense sphere": (sphere(16), 0.3),
    "wave": (wave(9), 0.1),
    "soup": (random_soup(100, 1), 0.2),
    "huge": (replace(wave(9), position=wave(9).position * np.float32(1e5)), 1e4),
    "tiny": (replace(wave(9), position=wave(9).position * np.float32(1e-6)), 1e-7),
    "far": (replace(wave(9), position=wave(9).position * np.float32(50) + np.float32(1e7)), 5.0),
    "turned": (replace(cube(), position=(cube().position @ rotation(3).T).astype(np.float32)), 0.23),
}
for exponent in (3, 4, 6, 8):
    SHAPES[f"needles 1e{exponent}"] = (needles(10.0**exponent), 0.02)
    SHAPES[f"turned needles 1e{exponent}"] = (needles(10.0**exponent, rotation(5)), 0.02)


# --- Coverage -----------------------------------------------------------------------------------------------


def points_on(mesh: Mesh, origin: np.ndarray, per_triangle: int, seed: int = 0):
    """Random points on valid triangles (n, 3), their triangles' unit normals and indices: half of them on edges."""
    rng = np.random.default_rng(seed)
    rows = np.repeat(np.arange(len(mesh.triangles)), per_triangle)
    weights = rng.dirichlet((1, 1, 1), len(rows))
    weights[::2, 0] = 0
    weights[::6] = np.eye(3)[rng.integers(0, 3, len(weights[::6]))]
    weights /= weights.sum(axis=1, keepdims=True)
    weights = weights[:, rng.permutation(3)]
    corners = mesh.position.astype(np.float64)[mesh.triangles[rows]] - origin
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.einsum("nk,nkc->nc", weights, corners), normal / np.linalg.norm(normal, axis=1)[:, None], rows


def worst_cover(mesh: Mesh, samples: Samples) -> float:
    """Largest elliptical distance (1 is the rim) of a point on the mesh from the splat that covers it best.

    Splats whose plane misses the point by more than 1e-4 of their major half-axis and a rounding error do not
    count. Disks at vertices are tilted against the triangle: they count where the triangle's normal through the
    point meets them.
    """
    e = evaluate(mesh, samples)
    points, normals, _ = points_on(mesh, e.origin, max(1, 2000 // len(mesh.triangles)))
    position, plane, radii = (a.astype(np.float64) for a in (e.position, e.plane, e.radii))
    worst = 0.0
    for block in range(0, len(points), 256):
        d = points[block : block + 256, None] - position
        off = (d * plane).sum(axis=2)
        if e.axis is None:
            cosine = normals[block : block + 256] @ plane.T
            shift = off / np.where(np.abs(cosine) > 1e-3, cosine, 1e-3)
            hit = d - shift[..., None] * normals[block : block + 256, None]
            distance = np.linalg.norm(hit, axis=2) / radii[:, 0]
            distance[np.linalg.norm(d, axis=2) > 2.01 * radii[:, 0]] = np.inf  # the other side of a closed body
        else:
            major = e.axis.astype(np.float64)
            u, v = (d * major).sum(axis=2), (d * np.cross(plane, major)).sum(axis=2)
            distance = np.hypot(u / radii[:, 0], v / radii[:, 1])
            distance[np.abs(off) > 1e-4 * radii[:, 0] + 1e-6 * np.abs(position).max()] = np.inf
        worst = max(worst, float(distance.min(axis=1).max()))
    return worst


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", SHAPES)
def test_splats_cover_every_triangle(shape, method):
    mesh, spacing = SHAPES[shape]
    samples = sample_mesh(mesh, spacing, method)
    assert worst_cover(mesh, samples) <= 1  # measured 0.999998: rounding is part of the radii


@pytest.mark.parametrize("method", METHODS)
def test_splats_still_cover_a_deformed_mesh(method):
    mesh = wave(9)
    samples = sample_mesh(mesh, 0.1, method)
    # Stretched, sheared and bent: triangles of up to four times their length.
    x, y, z = mesh.position.T
    bent = replace(mesh, position=np.stack([3 * x + y, 0.4 * y, z + x * x], 1).astype(np.float32))
    assert worst_cover(bent, samples) <= 1  # measured 0.999999


@pytest.mark.parametrize(
    "corners", [[(0, 0), (1, 0), (0.5, 0.8)], [(0, 0), (1, 0), (0.3, 0.1)], [(0, 0), (1, 0), (0, 1)]]
)
def test_vertex_disks_are_the_least_that_cover(corners):
    mesh = soup(np.array([[(*c, 0.0) for c in corners]]))
    radius = evaluate(mesh, sample_vertices(mesh)).radii.max()
    grid = np.linspace(0, 1, 1001)
    u, v = (a.ravel() for a in np.meshgrid(grid, grid))
    u, v = u[u + v <= 1], v[u + v <= 1]
    a, b, c = np.array(corners)
    points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
    nearest = np.min([np.linalg.norm(points - p, axis=1) for p in (a, b, c)], axis=0)
    # The lattice of test points is 1e-3 wide and misses the farthest point by as much.
    assert nearest.max() <= radius <= nearest.max() + 1e-3  # measured 6e-4


def test_radii_keep_to_the_spacing():
    for mesh, spacing in SHAPES.values():
        area = evaluate(mesh, sample_area(mesh, spacing)).radii.max()
        assert area <= spacing * np.sqrt(0.5) * (1 + 1e-4)  # measured 1 + 3.2e-5, from the slack for float32 weights


# --- Counts -------------------------------------------------------------------------------------------------


def area_of(mesh: Mesh) -> float:
    a, b, c = mesh.position.astype(np.float64)[mesh.triangles].transpose(1, 0, 2)
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def test_finer_spacing_gives_more_samples_and_about_one_per_cell():
    mesh = cube()
    counts = np.array([len(sample_area(mesh, 0.5**k)) for k in range(-2, 8)])
    assert np.all(np.diff(counts) >= 0)
    per_cell = counts[-1] * (0.5**7) ** 2 / area_of(mesh)
    assert per_cell == pytest.approx(1, abs=0.02)  # measured 1.014


def test_area_count_is_bounded_by_area_and_edges():
    for mesh, spacing in SHAPES.values():
        m = measure_triangles(mesh)
        count = len(sample_area(mesh, spacing))
        # Each row of cells rounds up once along itself, each triangle once across its rows.
        bound = (m.base * m.height / 2 + (m.base + m.height) * spacing) / spacing**2 + 1
        assert len(m.triangle) <= count <= bound.sum()
        # Ellipses of at most spacing / sqrt(2) cannot cover with fewer.
        assert count >= m.area / (np.pi / 2 * spacing**2)


def test_slivers_are_sampled_along_their_length_only():
    mesh = needles(1e5)
    assert len(sample_area(mesh, 0.01)) == pytest.approx(5 * 100, abs=5)  # one more where 1 / 0.01 rounds up


def test_triangles_smaller_than_a_splat_give_one_sample_each():
    mesh = wave(20)
    assert np.array_equal(sample_area(mesh, 1.0).triangle, np.arange(len(mesh.triangles)))
    vertices = sample_vertices(mesh)
    assert len(vertices) == len(mesh.position)
    assert np.array_equal(mesh.position, mesh.position[mesh.triangles[vertices.triangle, corner_of_sample(vertices)]])


def test_auto_takes_vertices_only_of_dense_connected_meshes():
    assert choose_method(wave(20), 1.0) == "VERTICES"
    assert choose_method(wave(20), 0.01) == "AREA"
    assert choose_method(random_soup(50, 0), 1e3) == "AREA"  # three vertices for each triangle
    assert sample_mesh(wave(20), 1.0).method == "VERTICES"


def test_estimates_by_part_add_up_to_about_the_count():
    for mesh, spacing in SHAPES.values():
        measures = measure_triangles(mesh)
        part = np.arange(len(measures.triangle)) % 3
        estimate = estimate_by_part(measures, spacing, part, 3)
        assert estimate.shape == (3,)
        count = len(sample_area(mesh, spacing))
        assert count <= estimate.sum() <= 2 * count  # measured 1.43 at most


def test_sampling_is_deterministic():
    mesh = random_soup(60, 4)
    for method in METHODS:
        a, b = (sample_mesh(mesh, 0.1, method) for _ in range(2))
        assert np.array_equal(a.triangle, b.triangle)
        assert np.array_equal(a.barycentric, b.barycentric)
        assert np.all(np.diff(a.triangle) >= 0)


def test_weights_lie_within_the_triangle():
    for mesh, spacing in SHAPES.values():
        for method in METHODS:
            w = sample_mesh(mesh, spacing, method).barycentric
            assert w.min() >= 0
            assert w.sum(axis=1).max() <= 1 + 2e-7  # measured 1


# --- What is dropped ----------------------------------------------------------------------------------------


def bad_mesh() -> tuple[Mesh, list[int]]:
    position = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (np.nan, 0, 0), (0, np.inf, 0), (2, 0, 0), (3e20, 0, 0)]
    position += [(1e-25, 0, 0), (0, 1e-25, 0)]
    good = [0, 1, 2]
    bad = [[0, 1, 3], [0, 4, 2], [0, 0, 0], [0, 1, 5], [1, 1, 2], [0, 6, 2], [0, 7, 8], [0, 1, 9], [-1, 1, 2]]
    return make(position, [good, *bad]), [0]


def test_bad_triangles_are_dropped_and_counted():
    mesh, good = bad_mesh()
    ok, dropped = valid_triangles(mesh)
    assert np.flatnonzero(ok).tolist() == good
    assert dropped == DroppedTriangles(bad_index=2, non_finite=2, huge=1, tiny=2, degenerate=2)
    assert dropped.total == len(mesh.triangles) - 1
    assert dropped.message.startswith("9 triangles are not drawn (2 with an index out of range")
    assert valid_triangles(cube())[1].message == ""


@pytest.mark.parametrize("method", METHODS)
def test_bad_triangles_leave_the_rest_right(method):
    mesh, _ = bad_mesh()
    alone = make(mesh.position[:3], [[0, 1, 2]])
    with np.errstate(all="raise", under="ignore"):
        bad, good = (evaluate(m, sample_mesh(m, 0.2, method)) for m in (valid_mesh(mesh)[0], alone))
    assert np.allclose(bad.position + bad.origin, good.position + good.origin, atol=1e-7)  # measured 3e-8
    assert np.allclose(bad.radii, good.radii, rtol=2e-6)  # measured 5e-7
    assert np.allclose(bad.normal, (0, 0, 1))


@pytest.mark.parametrize("method", ["AUTO", *METHODS])
@pytest.mark.parametrize("mesh", [make([], []), make([(0, 0, 0)], []), soup(np.zeros((3, 3, 3)))])
def test_nothing_to_draw(mesh, method):
    mesh, _ = valid_mesh(mesh)
    samples = sample_mesh(mesh, 0.1, method)
    e = evaluate(mesh, samples)
    assert len(samples) == len(e.position) == len(e.radii) == 0
    assert interpolate(mesh, samples, np.zeros((len(mesh.triangles), 3, 2), np.float32)).shape == (0, 2)
    assert required_spacing(mesh, np.eye(4), camera()) == np.inf


@pytest.mark.parametrize("spacing", [0.0, -1.0, np.nan, np.inf])
def test_spacing_must_be_a_positive_number(spacing):
    with pytest.raises(ValueError, match="spacing"):
        sample_area(cube(), spacing)


def test_too_many_samples_are_refused_before_memory_is_taken():
    with pytest.raises(ValueError, match="larger spacing"):
        sample_area(cube(), 1e-7)


def test_a_pose_without_area_gives_finite_splats():
    mesh = wave(5)
    e = evaluate(replace(mesh, position=np.zeros_like(mesh.position)), sample_area(mesh, 0.2))
    assert e.axis is not None
    for array in (e.position, e.normal, e.plane, e.radii, e.axis):
        assert np.isfinite(array).all()
    assert np.allclose(np.linalg.norm(e.normal, axis=1), 1)


def test_a_pose_with_a_nan_loses_only_what_touches_it():
    mesh = replace(wave(6), topology="wave")
    broken = mesh.position.copy()
    broken[14] = np.nan
    found, dropped = valid_mesh(replace(mesh, position=broken))
    touched = (mesh.triangles == 14).any(axis=1)
    assert dropped == DroppedTriangles(non_finite=int(touched.sum()))
    assert np.array_equal(found.triangles, mesh.triangles[~touched])
    assert np.isfinite(found.position).all()
    # Samples of poses with other triangles are others; the same ones are shared.
    assert found.topology not in ("", "wave")
    again, _ = valid_mesh(replace(mesh, position=2 * broken))
    assert again.topology == found.topology
    assert valid_mesh(mesh)[0] is mesh


# --- Attributes ---------------------------------------------------------------------------------------------


def exact(mesh: Mesh, samples: Samples, per_corner: np.ndarray) -> np.ndarray:
    w = samples.barycentric.astype(np.float64)
    weights = np.column_stack([1 - w.sum(axis=1), w])
    return np.einsum("nk,nkc->nc", weights, per_corner.astype(np.float64)[samples.triangle])


@pytest.mark.parametrize("method", METHODS)
def test_attributes_are_interpolated_linearly(method):
    mesh = sphere(10)
    rng = np.random.default_rng(2)
    count = len(mesh.triangles)
    corner_normal = rng.normal((0, 0, 4), 1, (count, 3, 3)).astype(np.float32)
    mesh = replace(mesh, corner_normal=corner_normal, material=np.arange(count, dtype=np.uint16))
    samples = sample_mesh(mesh, 0.2, method)
    colors = rng.random((count, 3, 4)).astype(np.float32)
    error = np.abs(interpolate(mesh, samples, colors) - exact(mesh, samples, colors)).max()
    assert error < 2e-7  # measured 1.1e-7
    assert np.array_equal(material_ids(mesh, samples), samples.triangle)

    e = evaluate(mesh, samples)
    place = exact(mesh, samples, mesh.position[mesh.triangles])
    assert np.abs(e.position + e.origin - place).max() < 1e-7  # measured 3e-8
    if method != "VERTICES":
        n = exact(mesh, samples, corner_normal)
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        assert np.abs(e.normal - n).max() < 1e-7  # measured 6e-8


def test_vertex_normals_are_the_mesh_s_own():
    mesh = sphere(10)
    mesh = replace(mesh, vertex_normal=mesh.position / np.linalg.norm(mesh.position, axis=1, keepdims=True))
    samples = sample_vertices(mesh)
    e = evaluate(mesh, samples)
    assert np.allclose(e.normal, e.position + e.origin, atol=1e-6)  # the unit sphere; measured 2e-7
    assert np.einsum("nk,nk->n", e.normal, e.plane).min() > 0.97  # the one-ring's mean; measured 0.985


def test_a_mesh_without_material_indices_takes_its_only_material():
    mesh = replace(cube(), materials=(7,))
    assert material_ids(mesh, sample_vertices(mesh)).tolist() == [7] * 8


def test_axes_are_unit_and_in_the_plane():
    for mesh, spacing in SHAPES.values():
        e = evaluate(mesh, sample_area(mesh, spacing))
        assert e.axis is not None
        assert np.allclose(np.linalg.norm(e.axis, axis=1), 1, atol=2e-7)  # measured 6e-8
        assert np.abs(np.einsum("nk,nk->n", e.axis, e.plane)).max() < 2e-7  # measured 9e-8
        assert np.all(e.radii[:, 0] >= e.radii[:, 1])
        assert e.radii.min() > 0


def test_coordinates_far_from_zero_keep_the_mesh_s_precision():
    mesh, spacing = SHAPES["far"]
    samples = sample_area(mesh, spacing)
    e = evaluate(mesh, samples)
    place = exact(mesh, samples, mesh.position[mesh.triangles])
    # float32 at 1e7 has a spacing of 1; relative to the origin the error is that of float32 at 50.
    assert np.abs(e.position + e.origin - place).max() < 4e-6  # measured 1.9e-6
    held = evaluate(mesh, samples, origin=e.origin + 8)
    assert np.allclose(held.position + 8, e.position, atol=1e-5)  # measured 3.8e-6


# --- Spacing ------------------------------------------------------------------------------------------------


def test_octaves_only_refine():
    values = 10 ** np.random.default_rng(0).uniform(-9, 9, 500)
    for value in (*values, 1.0, 0.5, 2.0**-30):
        octave = quantise_spacing(value)
        assert octave <= value < 2 * octave
        assert np.log2(octave) == np.round(np.log2(octave))
        assert quantise_spacing(octave) == octave
    assert quantise_spacing(np.inf) == np.inf
    with pytest.raises(ValueError, match="positive"):
        quantise_spacing(np.nan)


def camera(perspective=True, shift=(0.0, 0.0), near=0.1, far=100.0, focal=1.4, resolution=(320, 200)) -> Camera:
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1] = focal, focal * resolution[0] / resolution[1]
    if perspective:
        clip[:2, 2] = shift
        clip[2:, 2:] = [[-(far + near) / (far - near), -2 * far * near / (far - near)], [-1, 0]]
    else:
        clip[:2, 3] = shift
        clip[2:, 2:] = [[-2 / (far - near), -(far + near) / (far - near)], [0, 1]]
    return Camera(np.eye(4), clip, resolution, near=near, far=far)


def transform(seed: int, distance: float, scale=(1.0, 1.0, 1.0)) -> np.ndarray:
    m = np.eye(4)
    m[:3, :3] = rotation(seed) * scale
    m[:3, 3] = (0.2, -0.1, -distance)
    return m


def brute_force(mesh: Mesh, view_from_object: np.ndarray, cam: Camera, count: int) -> float:
    """Least length that projects to a pixel, over random points of the mesh that the camera sees."""
    points = points_on(mesh, np.zeros(3), count)[0]
    view = points @ view_from_object[:3, :3].T + view_from_object[:3, 3]
    fx, fy, cx, cy = cam.pixel_from_view()
    d = -view[:, 2] if cam.perspective else np.ones(len(view))
    pixel = view[:, :2] / d[:, None] * (fx, fy) + (cx, cy)
    seen = (pixel >= 0).all(axis=1) & (pixel <= cam.resolution).all(axis=1)
    seen &= (-view[:, 2] >= cam.near) & (-view[:, 2] <= cam.far)
    if not seen.any():
        return np.inf
    jacobian = np.zeros((int(seen.sum()), 2, 3))
    d = d[seen]
    jacobian[:, 0, 0], jacobian[:, 1, 1] = fx / d, fy / d
    if cam.perspective:
        jacobian[:, :, 2] = (pixel[seen] - (cx, cy)) / d[:, None]
    stretch = np.linalg.svd(jacobian @ view_from_object[:3, :3], compute_uv=False)[:, 0]
    return 1 / stretch.max()


CAMERAS = {
    "perspective": camera(),
    "shifted": camera(shift=(0.4, -0.7)),
    "wide": camera(focal=0.5),
    "long": camera(focal=6.0),
    "parallel": camera(perspective=False, shift=(0.3, 0.1)),
}


@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("distance", [0.5, 1.0, 3.0, 40.0])
@pytest.mark.parametrize("shape", ["cube", "sphere", "soup"])
def test_required_spacing_projects_to_a_pixel_where_the_mesh_is_nearest(name, distance, shape):
    mesh, view_from_object = SHAPES[shape][0], transform(7, distance)
    least = brute_force(mesh, view_from_object, CAMERAS[name], 40_000 // len(mesh.triangles))
    spacing = required_spacing(mesh, view_from_object, CAMERAS[name], max_samples=None)
    assert spacing <= least * (1 + 1e-9)  # measured 1.0 exactly in parallel views
    # Random points miss the nearest one, above all on the soup's few large triangles: measured 0.645; cube 0.896.
    assert spacing >= least * 0.6


@pytest.mark.parametrize("name", CAMERAS)
def test_parts_of_a_mesh_tell_the_same_spacing(name):
    rng = np.random.default_rng(4)
    meshes = [wave(60), sphere(40), soup(rng.normal(size=(3 * PART + 1, 1, 3)) + rng.normal(size=(3 * PART + 1, 3, 3)))]
    seen = 0
    for mesh in meshes:
        parts = make_parts(mesh)
        for seed in range(40):
            m = transform(seed, rng.uniform(-1, 6))
            whole = required_spacing(mesh, m, CAMERAS[name], max_samples=None)
            assert required_spacing(mesh, m, CAMERAS[name], max_samples=None, parts=parts) == pytest.approx(
                whole, rel=1e-9
            )
            seen += np.isfinite(whole)
    assert seen > 60  # measured 88 and more of 120


def test_parts_follow_the_mesh_unless_its_triangles_lie_scattered():
    mesh = wave(400)
    parts = make_parts(mesh)
    assert np.array_equal(parts.triangles, mesh.triangles)
    shuffled = replace(mesh, triangles=np.random.default_rng(1).permutation(mesh.triangles))
    extent = [np.linalg.norm(p.high - p.low, axis=1).mean() for p in (parts, make_parts(shuffled))]
    assert extent[1] < extent[0]  # a part of the wave is a strip, one in Morton order a patch
    low, high = parts.low.min(axis=0), parts.high.max(axis=0)
    assert np.array_equal([low, high], [mesh.position.min(axis=0), mesh.position.max(axis=0)])


def test_measures_spare_the_work_and_change_nothing():
    mesh = soup(np.random.default_rng(8).normal(size=(500, 3, 3)))
    every = np.ones(len(mesh.triangles), bool)
    measures = measure_triangles(mesh, every)
    edges = np.linalg.norm(mesh.position[mesh.triangles] - mesh.position[mesh.triangles[:, [1, 2, 0]]], axis=2)
    assert measures.longest == pytest.approx(edges.max(), rel=1e-6)
    assert np.allclose(measures.base, edges.max(axis=1), rtol=1e-6)
    assert measures.vertices == len(mesh.position)
    for method in METHODS:
        one, other = sample_mesh(mesh, 0.3, method), sample_mesh(mesh, 0.3, method, every, measures)
        assert np.array_equal(one.triangle, other.triangle)
        assert np.array_equal(one.barycentric, other.barycentric)
    assert limit_spacing(mesh, 1e-3, 10_000) == limit_spacing(mesh, 1e-3, 10_000, every, measures)


@pytest.mark.parametrize("count", [0, 1, 9, 10, 11, 1000])
def test_blocks_hold_every_item_once(count):
    seen = np.zeros(count, int)

    def look(block):
        seen[block] += 1

    each_block(count, look, 10)
    assert (seen == 1).all()


def test_what_a_block_raises_arrives():
    def fail(block):
        if block.start >= 500:
            raise FloatingPointError(f"{block.start}")

    with pytest.raises(FloatingPointError, match="500"):
        each_block(1000, fail, 10)


def test_the_part_of_a_large_triangle_between_the_frustum_s_sides_counts():
    # A ground of two triangles, no vertex visible: its nearest visible point is where the lower side meets it.
    ground = make([(-50, -1, 50), (50, -1, 50), (50, -1, -50), (-50, -1, -50)], [[0, 1, 2], [0, 2, 3]])
    cam = camera(resolution=(200, 200))
    depth, half = 1.4, 1 / 1.4  # the frame's lower edge looks down at tan = 1 / focal, and meets y = -1 at 1.4
    assert required_spacing(ground, np.eye(4), cam, max_samples=None) == pytest.approx(
        depth / (140 * np.sqrt(1 + 2 * half**2)),
        rel=2e-7,  # measured 1.0e-7: singular values are rounded up
    )


def test_what_the_camera_does_not_see_needs_no_samples():
    for cam in CAMERAS.values():
        for offset in ((0, 0, 5), (60, 0, -5), (0, -60, -5), (0, 0, -200)):
            m = np.eye(4)
            m[:3, 3] = offset
            assert required_spacing(cube(), m, cam) == np.inf


def test_spacing_under_scaled_mirrored_and_flattened_transforms():
    mesh, cam = cube(), camera()
    one = required_spacing(mesh, transform(1, 6), cam)
    m = transform(1, 6) @ np.diag([1, -1, 1, 1.0])
    assert required_spacing(mesh, m, cam) == pytest.approx(one, rel=1e-12)  # the cube is symmetric
    doubled = replace(mesh, position=mesh.position * 2)
    m = transform(1, 6) @ np.diag([0.5, 0.5, 0.5, 1])
    assert required_spacing(doubled, m, cam) == pytest.approx(2 * one, rel=1e-12)
    assert required_spacing(mesh, transform(1, 6, (0, 0, 0)), cam) == np.inf
    assert np.isfinite(required_spacing(mesh, transform(1, 6, (1, 0, 1)), cam))
    assert required_spacing(mesh, np.full((4, 4), np.nan), cam) == np.inf
    assert required_spacing(mesh, transform(1, 6), cam, pixels=2) == pytest.approx(2 * one)


def test_instances_share_the_spacing_of_the_one_that_needs_the_finest():
    mesh, cam = SHAPES["sphere"][0], camera()
    rng = np.random.default_rng(3)
    for count in (7, 300):
        matrices = np.array([transform(i, 30 * d, (s, s, s)) for i, (d, s) in enumerate(rng.random((count, 2)))])
        matrices[:, :2, 3] = rng.uniform(-20, 20, (count, 2))
        each = [required_spacing(mesh, m, cam, max_samples=None) for m in matrices]
        together = required_spacing(mesh, matrices, cam, max_samples=None)
        assert together == pytest.approx(min(each), rel=1e-12)
    # So many equal instances that boxes decide: finer by the sphere's and the frustum's corners, never coarser.
    many = np.repeat(transform(0, 6)[None], 200, axis=0)
    one = required_spacing(mesh, many[0], cam, max_samples=None)
    assert 0.5 * one < required_spacing(mesh, many, cam, max_samples=None) <= one


def test_a_camera_inside_is_limited_by_the_number_of_samples():
    mesh = cube()
    cam = camera(near=1e-5)
    m = np.eye(4)
    m[2, 3] = 0.9999  # the eye is 1e-4 from the face that it looks at
    for limit in (1000, 100_000):
        spacing = required_spacing(mesh, m, cam, max_samples=limit)
        count = len(sample_area(mesh, spacing))
        assert limit / 8 < count <= limit  # an octave is a factor of four in samples
        assert spacing == quantise_spacing(spacing)
    assert limit_spacing(mesh, 0.5, 1) <= 4  # one sample for each triangle is the least
    dense = wave(30)
    assert len(sample_area(dense, limit_spacing(dense, 1e-3, 10))) == len(dense.triangles)
