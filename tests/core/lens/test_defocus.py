"""Splats that are out of focus, against closed forms and the convolution that they stand for."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.lens import dicing, strand_splats
from pointsplat_addon.core.lens.thin_lens import camera_through, circle_of_confusion, lens_points
from pointsplat_addon.core.lod import area_share, cut, node_table
from pointsplat_addon.core.lod.hierarchy import build
from pointsplat_addon.core.scene.camera import Aperture, Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat import blur as blur_module
from pointsplat_addon.core.strand.preparation import with_levels
from pointsplat_addon.core.surface.evaluation import evaluate
from pointsplat_addon.core.surface.sample_areas import sample_areas
from pointsplat_addon.core.surface.sampling import sample_mesh
from pointsplat_addon.core.surface.triangles import measure_triangles
from scripts.scenes.build import moved, strand_lines
from scripts.scenes.cameras import camera
from scripts.scenes.meshes import flat_mesh, plane_mesh, sphere_mesh
from tests.reference import defocus


def lens(radius: float = 0.1, focus: float = 4.0, **more) -> Camera:
    return replace(camera(**more), aperture=Aperture(radius, focus))


def blur(of: Camera) -> blur_module.Blur:
    found = blur_module.defocus_blur(of)
    assert found is not None
    return found


# The disk


@pytest.mark.parametrize("parallel", [None, 5.0])
def test_disks_are_the_thin_lens(parallel):
    seen = lens(parallel=parallel)
    depth = np.geomspace(0.2, 1e6, 50)
    np.testing.assert_allclose(blur(seen).radius(depth), circle_of_confusion(seen, depth), rtol=1e-10)  # measured 0


@pytest.mark.parametrize("parallel", [None, 5.0])
def test_bounds_hold_all_depths_between_and_are_met(parallel):
    of = blur(lens(parallel=parallel))
    rng = np.random.default_rng(0)
    near, far = np.sort(rng.uniform(0.1, 12.0, (2, 1000)), axis=0)
    least, most = of.radius_range(near, far)
    between = of.radius(near + (far - near) * np.linspace(0, 1, 101)[:, None])
    assert (between >= least * (1 - 1e-12)).all()
    assert (between <= most * (1 + 1e-12)).all()
    np.testing.assert_allclose(between.max(axis=0), most, rtol=1e-9)


@pytest.mark.parametrize("parallel", [None, 5.0])
def test_depths_of_a_radius_are_its_inverse(parallel):
    of = blur(lens(parallel=parallel))
    for radius in (0.1, 0.5, 1.0):
        np.testing.assert_allclose(of.radius(np.array(of.depth_range(radius))), radius, rtol=1e-9)
    assert of.depth_range(1e9)[1] == np.inf or parallel  # all that is far


def test_what_is_no_lens_blurs_nothing():
    for aperture in (None, Aperture(0.0, 4.0), Aperture(np.nan, 4.0), Aperture(0.1, 0.0), Aperture(np.inf, 4.0)):
        assert blur_module.defocus_blur(replace(camera(), aperture=aperture)) is None


def test_extreme_depths_have_finite_or_infinite_disks_and_no_nan():
    of = blur(lens(1e-3, 1e-3))
    radius = of.radius(np.array([-1.0, 0.0, 1e-300, 1e300, np.inf]))
    assert np.isfinite(radius).all()
    assert radius[3] == pytest.approx(of.scale)


@pytest.mark.parametrize("ratio", [1.0, 0.5])
@pytest.mark.parametrize("parallel", [None, 5.0])
def test_the_middle_of_what_leans_is_where_the_lens_sees_most_of_it(parallel, ratio):
    """Means and variances of a point's places in the picture, over the lens, by how large its surface is seen."""
    seen = replace(camera(parallel=parallel), aperture=Aperture(0.4, 4.0, ratio=ratio))
    rng = np.random.default_rng(1)
    place = np.asarray(rng.uniform(-1, 1, (60, 3))) - np.array([0, 0, 4.5])
    normal = rng.normal(size=(60, 3))
    world = (place - seen.view_from_world[:3, 3]) @ seen.view_from_world[:3, :3]
    moved_to, seen_as = [], []
    for point in lens_points(4097, seen.aperture):
        of = camera_through(seen, point)
        view = world @ of.view_from_world[:3, :3].T + of.view_from_world[:3, 3]
        fx, fy, cx, cy = of.pixel_from_view()
        moved_to.append(view[:, :2] * [fx, fy] / (np.abs(view[:, 2:]) if parallel is None else 1.0) + [cx, cy])
        toward = np.append(point, 0.0) - place if parallel is None else np.append(point / 4.0, 1.0)
        seen_as.append((normal * toward).sum(axis=1))
    places, sizes = np.array(moved_to), np.array(seen_as)
    one_side = (np.sign(sizes) == np.sign(sizes[0])).all(axis=0)
    assert one_side.sum() > 30
    share = sizes / sizes.sum(axis=0)
    middle = (share[..., None] * places).sum(axis=0)
    spread = (share[..., None] * (places - middle) ** 2).sum(axis=0)
    depth = -place[:, 2]
    disk = (blur(seen).radius(depth) * np.where(depth < 4.0, -1.0, 1.0))[:, None] / np.array([ratio, 1.0])
    lean = defocus.lens_mean(seen, place, normal)
    error = (middle - places[0] - disk * lean) / np.abs(disk)
    assert np.abs(error[one_side]).max() < 2e-3  # measured 8.5e-4, of the lens's 4,097 places
    error = spread / disk**2 - (0.25 - lean**2)
    assert np.abs(error[one_side]).max() < 1e-3  # measured 3.3e-4
    assert np.abs(lean[one_side]).max() > 0.1
    assert (np.linalg.norm(lean, axis=1) <= 0.25 * (1 + 1e-12)).all()


# The kernel


@pytest.mark.parametrize("k", [0.0, 0.3, 1.0, 4.0])
def test_kernels_weigh_one_and_have_the_variance_of_their_covariance(k):
    x = (np.arange(801) - 400) * 0.02
    xx, yy = np.meshgrid(x, x)
    covariance = np.array([[2.0, 0.6], [0.6, 1.0]])
    inverse = np.linalg.inv(covariance)
    q = inverse[0, 0] * xx**2 + 2 * inverse[0, 1] * xx * yy + inverse[1, 1] * yy**2
    values = defocus.kernel(q, np.array(k), np.array(np.linalg.det(covariance))) * 0.02**2
    assert abs(values.sum() - 1) < 1e-3  # measured 6.2e-4, k = 0: the rim's pixels
    found = [(values * a).sum() for a in (xx**2, xx * yy, yy**2)]
    np.testing.assert_allclose(found, [2.0, 0.6, 1.0], atol=3e-3)  # measured 2.2e-3, k = 0: the rim's pixels


@pytest.mark.parametrize(("radius", "variance"), [(30, 0.11), (10, 0.3), (3, 0.5), (1, 0.3)])
def test_kernels_are_nearer_to_the_convolved_disk_than_gaussians_are(radius, variance):
    """The absolute difference summed: at most a third of that of the Gaussian that Křivánek draws (equation 5.10), from
    disks as wide as a pixel's neighbours on; and the radius that holds half the energy within 3 %."""
    step = radius / 100
    x = np.arange(-300, 300) * step * max(1.0, 3 / radius)
    step = x[1] - x[0]
    r = np.hypot(*np.meshgrid(x, x))
    frequency = np.fft.fftfreq(len(x), step)
    low_pass = np.exp(-2 * np.pi**2 * variance * (frequency[:, None] ** 2 + frequency**2))
    disk = (r < radius) / np.sum(r < radius) / step**2
    exact = np.fft.ifft2(np.fft.fft2(disk) * low_pass).real
    total = radius**2 / 4 + variance
    k = defocus.kernel_exponent(np.array(float(radius)), np.array(variance))
    ours = defocus.kernel(r**2 / total, k, np.array(total**2))
    wide = radius**2 / (2 * np.log(4)) + variance
    gauss = np.exp(-0.5 * r**2 / wide) / (2 * np.pi * wide)
    error, of_gauss = (np.abs(values - exact).sum() * step**2 for values in (ours, gauss))
    assert error < of_gauss * (0.35 if radius >= 3 else 0.6)  # measured 0.033, 0.165, 0.338 and 0.524
    order = np.argsort(r, axis=None)

    def half(values: np.ndarray) -> float:
        return float(r.ravel()[order][np.searchsorted(np.cumsum(values.ravel()[order]), values.sum() / 2)])

    assert abs(half(ours) / half(exact) - 1) < 0.03  # measured 0.028 at a radius of 1


# Compositing


def splats(count: int = 1, **more) -> defocus.Splats:
    """Splats at the origin that are even over many pixels: `weight` is what they cover there."""
    wide = np.tile(np.eye(2) * 1e4, (count, 1, 1))
    given = {
        "centre": np.zeros((count, 2)), "depth": np.arange(count, dtype=float), "covariance": wide,
        "exponent": np.zeros(count), "weight": np.ones(count), "color": np.eye(4)[:count, :3],
        "reach": np.full(count, 0.1), "back": np.zeros(count, bool), "translucent": np.zeros(count, bool),
        "disconnected": np.zeros(count, bool),
    }  # fmt: skip
    given |= more
    given["weight"] = np.asarray(given["weight"], float) * np.pi * 4e4
    return defocus.Splats(**given)


MIDDLE = np.full((1, 2), 5.0)


def shares(of: defocus.Splats) -> np.ndarray:
    return defocus.composite(MIDDLE, of)[0]


def covered(a: float) -> float:
    return a + defocus.EVEN * a**8


def test_surfaces_apart_cover_on_their_own():
    a, b = 0.5, 0.4
    found = shares(splats(2, weight=[a, b]))
    np.testing.assert_allclose(found[:2], [covered(a), (1 - covered(a)) * covered(b)], rtol=1e-9)


def test_splats_of_one_surface_add_up():
    found = shares(splats(2, weight=[0.5, 0.4], reach=np.full(2, 0.6)))
    np.testing.assert_allclose(found[3], covered(0.9), rtol=1e-9)
    np.testing.assert_allclose(found[0] / found[1], 0.5 / 0.4, rtol=1e-9)


def test_no_surface_covers_more_than_all():
    found = shares(splats(3, weight=[0.7, 0.7, 0.7], reach=np.full(3, 0.6)))
    np.testing.assert_allclose(found, [0.7, 0.3, 0.0, 1.0], atol=1e-9)


def test_backs_show_where_fronts_leave_them():
    back = np.array([False, True])
    closed = shares(splats(2, weight=[0.5, 0.5], reach=np.full(2, 0.6), back=back))
    np.testing.assert_allclose(closed, [covered(0.5), 0, 0, covered(0.5)], atol=1e-9)
    folded = shares(splats(2, weight=[0.2, 0.5], reach=np.full(2, 0.6), back=back))
    # Beside fronts backs count for less.
    np.testing.assert_allclose(folded[:2] / folded[3], [0.5, 0.5], rtol=1e-9)


def test_translucent_splats_follow_beers_law_before_within_and_behind_a_surface():
    depth = 0.7
    for order in ([True, False, False], [False, True, False], [False, False, True]):
        translucent = np.array(order)
        weight = np.where(translucent, depth, 0.5)
        found = shares(splats(3, weight=weight, reach=np.full(3, 5.0), translucent=translucent))
        alpha, place = 1 - np.exp(-depth), order.index(True)
        before = 0.5 * place
        np.testing.assert_allclose(found[place], (1 - before) * alpha, atol=1e-9)
        behind = [0.5 * (alpha if i > place else 0) for i in range(3) if i != place]
        opaque = [found[i] for i in range(3) if i != place]
        np.testing.assert_allclose(opaque, 0.5 - np.array(behind), atol=1e-9)


def test_leaves_cover_on_their_own_however_near_they_are():
    found = shares(splats(2, weight=[0.5, 0.4], reach=np.full(2, 5.0), disconnected=np.ones(2, bool)))
    np.testing.assert_allclose(found[:2], [0.5, 0.5 * 0.4], rtol=1e-9)


# What a view needs


def grid(cells: int, size: float = 2.0) -> PointCloud:
    """A plane of points whose disks go around their cells."""
    u = ((np.arange(cells) + 0.5) / cells * 2 - 1) * size
    x, y = (a.ravel() for a in np.meshgrid(u, u))
    position = np.stack([x, y, 0 * x], axis=1).astype(np.float32)
    normal = np.tile(np.array([0, 0, 1], np.float32), (len(x), 1))
    return PointCloud(position, normal=normal, radii=np.full((len(x), 1), size / cells * np.sqrt(2), np.float32))


@pytest.mark.parametrize("parallel", [None, 5.0])
def test_cuts_of_what_is_sharp_and_of_what_is_blurred_hold_all_points(parallel):
    """And nodes that are blurred are no larger than their disks allow, and stand for the more the wider the lens is."""
    tree = build(grid(128))
    seen = camera((0, -4, 1), parallel=parallel)
    trees, zero, view = node_table.node_table({0: tree}), np.zeros(1, int), seen.view_from_world[None]
    stands_for = []
    for radius in (0.1, 0.5, 1.5):
        of = blur(replace(seen, aperture=Aperture(radius, 4.0)))
        held = np.zeros(len(tree.cloud), bool)
        for wanted in ("SHARP", "BLURRED"):
            found = cut.select_cut(trees, zero, view, seen, blur=of, wanted=wanted)
            for first, count in zip(found.first, found.count, strict=True):
                for row in range(first, first + count):
                    if row < len(held):
                        held[row] = True
                    else:
                        node = row - len(held)
                        begin = tree.tree.first_point[node]
                        held[begin : begin + tree.tree.point_count[node]] = True
        whole = cut.select_cut(trees, zero, view, seen)
        inside = np.zeros(len(held), bool)
        for first, count in zip(whole.first, whole.count, strict=True):
            for row in range(first, first + count):
                node = row - len(held)
                begin, number = (
                    (row, 1) if row < len(held) else (tree.tree.first_point[node], tree.tree.point_count[node])
                )
                inside[begin : begin + number] = True
        assert held[inside].all()
        nodes = np.concatenate([np.arange(a, a + n) for a, n in zip(found.first, found.count, strict=True)]) - len(held)
        nodes = nodes[nodes >= 0]
        stands_for.append(tree.tree.point_count[nodes].mean())
        depth = -(tree.center[nodes] @ view[0, 2, :3] + view[0, 2, 3])
        size = tree.size[nodes]
        pixels = 2 * size * seen.pixel_from_view()[0] / (depth if parallel is None else 1.0)
        assert (pixels <= of.largest_splat(of.radius(depth), 1.0) * 1.0001).all()  # measured 0.966 of it
    assert stands_for[2] > stands_for[1] > stands_for[0]


def test_pieces_of_triangles_have_their_area_and_moments():
    """All of a plane that is out of focus as a whole."""
    mesh = flat_mesh("plane in pieces", plane_mesh("in pieces").position, plane_mesh("in pieces").triangles)
    seen = lens(0.05, 2.0)
    matrix = seen.view_from_world
    samples = dicing.dice_triangles(mesh, np.arange(len(mesh.triangles)), matrix, seen, 1.0, blur(seen))
    found = evaluate(mesh, samples)
    assert found.axis is not None
    area = np.pi * found.radii.prod(axis=1).astype(float) * dicing.TRIANGLE_SHARE
    assert len(samples) > 100
    assert abs(area.sum() / 4 - 1) < 5e-5  # measured 1.2e-5: half-axes are rounded outwards
    place = found.position.astype(float) + found.origin
    axis = found.axis.astype(float)
    other = np.cross(found.plane.astype(float), axis)
    own = sum(
        0.25 * found.radii[:, i, None, None].astype(float) ** 2 * (a[:, :, None] * a[:, None])
        for i, a in enumerate((axis, other))
    )
    second = (area[:, None, None] * (place[:, :, None] * place[:, None] + own)).sum(axis=0) / area.sum()
    expected = np.zeros(3)
    expected[np.ptp(mesh.position, axis=0) > 0] = 1 / 3
    np.testing.assert_allclose(np.diag(second), expected, atol=1e-5)  # measured 5.7e-7
    depth = -(place @ matrix[2, :3] + matrix[2, 3])
    widest = 4 / np.sqrt(3) * found.radii[:, 0] * seen.pixel_from_view()[0] / depth
    assert (widest <= blur(seen).largest_splat(blur(seen).radius(depth), 1.0)).all()  # measured 0.76 of it


def test_pieces_in_view_have_their_own_areas_though_others_of_their_triangles_are_not():
    """Of a floor of two triangles a small part is in view, and all of it, in focus or not, is diced."""
    mesh = plane_mesh("floor, of which a part is in view", 50.0)
    matrix = lens().view_from_world @ moved((0, 0, -0.5)) @ np.diag([1.0, 1, 1, 1])[[0, 2, 1, 3]]
    seen = lens(0.05, 5.0)
    samples = dicing.dice_triangles(mesh, np.arange(2), matrix, seen, 1.0, blur(seen), in_focus=True)
    assert samples.ellipse is not None
    found = evaluate(mesh, samples)
    own = np.pi * found.radii.prod(axis=1).astype(float) * dicing.TRIANGLE_SHARE
    area = sample_areas(mesh, samples)
    np.testing.assert_allclose(area, own, rtol=2e-4)  # measured 8.0e-5
    assert area.sum() < 0.2 * 100.0**2  # measured 0.113
    sharp = dicing.dice_triangles(mesh, np.arange(2), matrix, seen, 1.0, blur(seen))
    assert len(sharp) < len(samples)


def test_pieces_of_what_reaches_behind_the_eye_are_finite_and_few():
    mesh = plane_mesh("floor in pieces", 50.0)
    matrix = lens().view_from_world @ moved((0, 0, -0.5)) @ np.diag([1.0, 1, 1, 1])[[0, 2, 1, 3]]
    seen = lens(0.05, 5.0)
    samples = dicing.dice_triangles(mesh, np.arange(2), matrix, seen, 1.0, blur(seen))
    assert np.isfinite(samples.barycentric).all()
    assert 0 < len(samples) < 100_000


def test_facets_of_balls_cover_their_disks():
    rng = np.random.default_rng(0)
    position = rng.uniform(-0.5, 0.5, (20, 3)).astype(np.float32)
    radii = rng.uniform(0.01, 0.3, (20, 1)).astype(np.float32)
    seen = lens(0.5, 2.0, parallel=5.0)
    found = dicing.dice_balls(PointCloud(position, radii=radii), seen.view_from_world, seen, 1.0, blur(seen))
    assert found.radii is not None
    assert found.normal is not None
    facing = found.normal @ seen.view_from_world[2, :3]
    area = np.pi * found.radii.astype(float).prod(axis=1) * dicing.DISK_SHARE * facing
    assert (facing > 0).all()
    assert abs(area.sum() / (np.pi * radii.astype(float) ** 2).sum() - 1) < 1e-6  # measured 3e-10


def test_pieces_of_strands_have_their_area():
    u = np.linspace(-1, 1, 9)
    strand = np.stack([u, 0.2 * np.sin(3 * u), 0.3 * u], axis=1)
    given = strand_lines("in pieces", [strand], 0.01).strands
    assert given is not None
    strands = with_levels(given)
    ends = np.stack([np.arange(8), np.arange(1, 9)], axis=1)
    for size, strips in ((0.01, False), (0.3, True)):
        lines = replace(given, radius=np.full(9, size, np.float32))
        strands = with_levels(lines)
        seen = lens(0.05, 2.0)
        found = strand_splats.dice_strands(strands, lines, ends, seen.view_from_world, seen, 1.0, blur(seen))
        assert found.radii is not None
        assert (found.kernel is None or not found.kernel.any()) == strips
        assert np.isfinite(found.position).all()
        area = np.pi * found.radii.astype(float).prod(axis=1) * strand_splats.RECTANGLE_SHARE
        length = np.linalg.norm(np.diff(strand, axis=0), axis=1).sum()
        if not strips:
            assert abs(area.sum() / (2 * size * length) - 1) < 1e-6  # measured 5.4e-8


@pytest.mark.parametrize("tolerance", [0.3, 3.0])
@pytest.mark.parametrize("bend", [0.0, 0.3, 0.6])
def test_pieces_of_a_tube_cover_what_is_seen_of_it(bend, tolerance):
    """In strips half-way around it, and in pieces as wide as it is, also where segments meet: twice the radius for each
    unit of length."""
    along = np.stack([np.sin(u := np.arange(-3, 4) * max(bend, 1e-6)), 0 * u, np.cos(u)], axis=1) / max(bend, 1e-6)
    along -= along[3]
    given = strand_lines(f"tube bent by {bend}", [along], 0.3).strands
    assert given is not None
    strands = with_levels(given)
    seen = lens(0.5, 3.0, parallel=20.0)
    ends = np.stack([np.arange(6), np.arange(1, 7)], axis=1)
    found = strand_splats.dice_strands(strands, given, ends, seen.view_from_world, seen, tolerance, blur(seen))
    assert found.radii is not None
    assert found.normal is not None
    assert (found.kernel is None) == (tolerance < 1)
    facing = found.normal @ seen.view_from_world[2, :3]
    inner = facing > 0.05  # without what closes the ends
    area = np.pi * found.radii.astype(float).prod(axis=1) * strand_splats.RECTANGLE_SHARE * facing
    length = np.linalg.norm(np.diff(along, axis=0), axis=1).sum()
    assert abs(area[inner].sum() / (0.6 * length) - 1) < 1e-6  # measured 3.2e-8


# What splats cover


@pytest.mark.parametrize("wide", [1.0, 1.5])
def test_points_of_a_plane_cover_their_cells_whatever_their_radii_are(wide):
    cloud = grid(64)
    assert cloud.radii is not None
    tree = build(replace(cloud, radii=cloud.radii * np.float32(wide)))
    share = np.asarray(area_share.area_shares(tree))
    assert tree.cloud.radii is not None
    area = np.pi * tree.cloud.radii[:, 0].astype(float) ** 2 * share[: len(cloud)]
    assert abs(area.sum() / 16 - 1) < 1e-3  # measured 7e-5 and 1.4e-4
    assert np.abs(area / (4 / 64) ** 2 - 1).max() < 1e-3  # measured 7e-5 and 1.4e-4


def test_samples_of_a_mesh_cover_what_they_stand_for():
    mesh = sphere_mesh("covered sphere", 48)
    samples = sample_mesh(mesh, 0.05, "AREA")
    found = evaluate(mesh, samples)
    cloud = PointCloud(found.position, found.origin, normal=found.plane, axis=found.axis, radii=found.radii)
    tree = build(cloud)
    share = np.asarray(area_share.area_shares(tree, lambda: sample_areas(mesh, samples)))
    assert tree.cloud.radii is not None
    area = np.pi * tree.cloud.radii.astype(float).prod(axis=1) * share[: len(cloud)]
    whole = measure_triangles(mesh).area
    assert abs(area.sum() / whole - 1) < 1e-6  # measured 5e-10
