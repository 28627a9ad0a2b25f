"""The reference of translucency against closed forms and adaptive quadrature."""

import numpy as np
import pytest
from scipy import integrate

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.splat.kernel import EVEN_SPACING, kernel
from scripts.common import media_truth as ref

Z = np.array([0.0, 0, 1])


def f32(values) -> np.ndarray:
    return np.asarray(values, np.float32)


def towards(angle: float) -> np.ndarray:
    """A unit direction that leaves +Z by degrees."""
    return np.array([np.sin(np.radians(angle)), 0, np.cos(np.radians(angle))])


def lamp(position, **changes) -> Light:
    return Light(
        **{"kind": "POINT", "color": np.ones(3), "position": np.array(position, float), "direction": -Z, **changes}
    )


# ---------------------------------------------------------------------------- media


@pytest.mark.parametrize("angle", [0, 30, 75])
def test_a_slab_follows_beers_law(angle):
    sigma = np.array([0.01, 1.0, 20.0])
    slab = ref.box([-np.inf, -np.inf, 1], [np.inf, np.inf, 3], sigma)
    depth = ref.optical_depth(slab, np.zeros((1, 3)), towards(angle)[None])
    np.testing.assert_allclose(depth[0], 2 * sigma / np.cos(np.radians(angle)), rtol=1e-13)  # measured 2e-16


def test_a_sphere_has_the_depth_of_its_chord():
    x = np.linspace(0, 1.2, 25)
    origins = np.stack([x, 0 * x, 0 * x - 5], axis=1)
    depth = ref.optical_depth(ref.sphere([0, 0, 0], 1.0, 3.0), origins, np.tile(Z, (25, 1)))
    expected = 6 * np.sqrt(np.maximum(1 - x**2, 0))
    np.testing.assert_allclose(depth[:, 0], expected, atol=1e-12)  # measured 4e-15


def test_a_ray_that_starts_or_ends_inside_takes_its_part():
    ball = ref.sphere([0, 0, 0], 1.0, 2.0)
    depth = ref.optical_depth(ball, np.array([[0.0, 0, 0.25], [0, 0, -3]]), np.stack([Z, Z]), np.array([np.inf, 2.5]))
    np.testing.assert_allclose(depth[:, 0], [1.5, 1.0], atol=1e-12)  # measured 2e-16


def test_a_blob_integrates_to_a_gaussian_of_the_offset():
    x = np.linspace(0, 2, 9)
    origins = np.stack([x, 0 * x, 0 * x - 8], axis=1)
    depth = ref.optical_depth(ref.blob([0, 0, 0], 0.5, 4.0), origins, np.tile(Z, (9, 1)))
    expected = 4 * 0.5 * np.sqrt(2 * np.pi) * np.exp(-(x**2) / 0.5)
    np.testing.assert_allclose(depth[:, 1], expected, atol=1e-12)  # measured 9e-16


def test_voxels_are_linear_between_their_centres():
    values = np.add.outer(np.add.outer(2.0 * np.arange(6), 3.0 * np.arange(5)), np.arange(4)) + 1
    world = np.diag([0.5, 0.25, 2.0, 1.0])
    world[:3, 3] = 1, 2, 3
    field = ref.voxels(values, world, [1.0, 0, 0])
    p = np.array([[3.3, 1.7, 0.4]]) @ world[:3, :3] + world[:3, 3]
    np.testing.assert_allclose(field.extinction(p)[0], [2 * 3.3 + 3 * 1.7 + 0.4 + 1, 0, 0], rtol=1e-12)
    # One ray along x through voxel centres: half a cell of each neighbour's slope outside of the first and the last.
    depth = ref.optical_depth(field, np.array([[-9.0, 2.5, 5.0]]), np.array([[1.0, 0, 0]]), tolerance=1e-6)
    assert depth[0, 0] == pytest.approx(0.5 * values[:, 2, 1].sum(), rel=1e-5)  # measured 2e-7


def test_an_emitting_slab():
    sigma, emitted = 1.7, np.array([1.0, 0.5, 0.0])
    slab = ref.box([-9, -9, 0], [9, 9, 2], sigma, emission=lambda p: np.broadcast_to(emitted, p.shape))
    seen = ref.march(slab, np.array([[0.0, 0, -1]]), Z[None])
    np.testing.assert_allclose(
        seen.radiance[0], emitted / sigma * (1 - np.exp(-2 * sigma)), atol=1e-6
    )  # measured 9e-11
    np.testing.assert_allclose(seen.transmittance[0], np.exp(-2 * sigma), atol=1e-9)


@pytest.mark.parametrize("g", [-0.5, 0.0, 0.8])
def test_a_slab_in_the_sun(g):
    """Sun from behind the viewer at 40 degrees: what single scattering sends back has a closed form."""
    sigma, albedo, thick = 1.3, 0.6, 2.0
    slab = ref.box([-np.inf, -np.inf, 0], [np.inf, np.inf, thick], sigma, albedo=np.full(3, albedo), anisotropy=g)
    sun = lamp([0, 0, 0], kind="SUN", direction=towards(40))
    seen = ref.march(slab, np.array([[0.0, 0, -1]]), Z[None], [sun])
    cosine = np.cos(np.radians(40))
    path = sigma * (1 + 1 / cosine)
    phase = (1 - g**2) / (4 * np.pi * (1 + g**2 + 2 * g * cosine) ** 1.5)
    expected = sigma * albedo * phase * (1 - np.exp(-path * thick)) / path
    np.testing.assert_allclose(seen.radiance[0], expected, atol=1e-6)  # measured 4e-9
    assert seen.error <= 1e-6


def test_the_phase_function_is_normalised():
    cosine, weight = np.polynomial.legendre.leggauss(200)
    for g in (-0.9, 0.0, 0.5, 0.9):
        phase = ref.henyey_greenstein(g, cosine)
        assert 2 * np.pi * phase @ weight == pytest.approx(1, abs=1e-9)
        assert 2 * np.pi * (phase * cosine) @ weight == pytest.approx(g, abs=1e-9)  # its mean cosine


@pytest.mark.parametrize("position", [(0.3, 0.2, 0.1), (2.0, 0, -1.0)])
def test_a_lamp_and_a_sphere(position):
    """Lamp inside and outside, against scipy's adaptive quadrature along one ray."""
    sigma, albedo, x, g = 2.5, 0.7, 0.31, 0.4
    ball = ref.sphere([0, 0, 0], 1.0, sigma, albedo=np.full(3, albedo), anisotropy=g)
    seen = ref.march(ball, np.array([[x, 0, -4.0]]), Z[None], [lamp(position)], tolerance=1e-9)
    half = np.sqrt(1 - x * x)

    def sent(z: float) -> float:
        place = np.array([x, 0, z])
        to_lamp = np.array(position) - place
        distance = np.linalg.norm(to_lamp)
        wi = to_lamp / distance
        leaving = -(place @ wi) + np.sqrt((place @ wi) ** 2 + 1 - place @ place)
        cosine = wi[2]  # light travels along -wi, then along -Z
        phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
        lit = np.exp(-sigma * min(distance, leaving)) / distance**2
        return sigma * albedo * phase * lit * np.exp(-sigma * (z + half))

    expected = integrate.quad(sent, -half, half, epsabs=1e-12, epsrel=1e-12, limit=400, points=[position[2]])[0]
    assert seen.radiance[0, 0] == pytest.approx(expected, abs=1e-8)  # measured 2e-13


def test_a_lamp_without_shadow_shines_through():
    ball = ref.sphere([0, 0, 0], 1.0, 3.0, albedo=np.ones(3))
    ray = np.array([[0.1, 0.2, -4.0]]), Z[None]
    shaded, bright = (ref.march(ball, *ray, [lamp([0, 3, 0], shadow=s)]).radiance[0, 0] for s in (True, False))
    assert bright > 2 * shaded  # measured 5.7 times


def test_a_spot_lights_its_cone_only():
    haze = ref.box([-9, -9, -9], [9, 9, 9], 0.1, albedo=np.ones(3))
    spot = lamp([0, 0, 5], kind="SPOT", spot_cos=np.cos(0.2))
    across = np.array([[-5.0, 0, 0], [-5, 2, 0]]), np.array([[1.0, 0, 0], [1, 0, 0]])
    inside, beside = ref.march(haze, *across, [spot], tolerance=1e-3).radiance[:, 0]
    assert inside > 0
    assert beside == 0


def test_what_cannot_be_marched_is_refused():
    ball = ref.sphere([0, 0, 0], 1.0, 1.0)
    with pytest.raises(ValueError, match="area lights"):
        ref.march(ball, np.zeros((1, 3)), Z[None], [lamp([0, 0, 2], kind="AREA", name="Panel")])
    with pytest.raises(ArithmeticError, match="steps"):
        ref._converged(lambda steps: np.array([float(steps)]), 1e-6)


# ---------------------------------------------------------------------------- splats


def lattice(spacing: float, extinction: float, sigma: float, half: tuple[float, float, float]) -> PointCloud:
    """A box of balls on a cubic lattice; their shares make up the extinction. sigma: in units of the spacing."""
    grid = [np.arange(-h + spacing / 2, h, spacing) for h in half]
    p = np.stack(np.meshgrid(*grid, indexing="ij"), axis=-1).reshape(-1, 3)
    radius = 2 * sigma * spacing
    share = extinction * spacing**3 / (4 / 3 * np.pi * radius**3)
    return PointCloud(
        f32(p), radii=np.full((len(p), 1), radius, np.float32), extinction=np.full(len(p), share, np.float32)
    )


@pytest.mark.parametrize("angle", [0, 35, 60])
def test_a_lattice_of_splats_is_a_slab(angle):
    """Mean over one cell: the ends along the ray are exact and the kernel keeps its sum."""
    cloud = lattice(0.25, 1.5, EVEN_SPACING, (3.0, 1.0, 0.5))
    u = (np.arange(24) + 0.5) / 24 * 0.25
    offsets = np.stack(np.meshgrid(u, u, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    depth = ref.splat_optical_depth(cloud, offsets - 5 * towards(angle), np.tile(towards(angle), (576, 1)))
    expected = 1.5 * 1.0 / np.cos(np.radians(angle))
    assert depth.mean() == pytest.approx(expected, rel=1e-4)  # measured 3e-5
    assert np.ptp(depth) < 0.02 * expected  # measured 0.014


def test_a_ball_is_the_blob_that_it_stands_for():
    radius, share = 0.8, 1.1
    cloud = PointCloud(np.zeros((1, 3), np.float32), radii=f32([[radius]]), extinction=f32([share]))
    deviation = radius / 2
    peak = 4 / 3 * np.pi * radius**3 * share / ((2 * np.pi) ** 1.5 * deviation**3)
    x = np.array([0.0, 0.3, 0.9, 1.3, 1.39])
    rays = np.stack([x, 0 * x, 0 * x - 4], axis=1), np.tile(Z, (5, 1))
    for far in (np.inf, 4.0, 4.3):
        depth = ref.splat_optical_depth(cloud, *rays, far)
        marched = ref.optical_depth(ref.blob([0, 0, 0], deviation, peak), *rays, far, tolerance=1e-9)[:, 0]
        # Across the ray the kernel is not a Gaussian, along it it is.
        across2 = (x / deviation) ** 2
        expected = marched * kernel(across2) / np.exp(-across2 / 2)
        np.testing.assert_allclose(depth[:4], expected[:4], rtol=1e-6)  # measured 2e-7: the share is float32
        assert depth[4] == 0


def test_an_ellipsoid_has_the_same_mass_from_all_sides():
    """The integral of its depth over a plane across the ray, in three colours."""
    radii, share = np.array([0.9, 0.5, 0.3]), np.array([1.0, 2.0, 0.0])
    normal = np.array([0.48, 0.6, 0.64])
    cloud = PointCloud(
        np.zeros((1, 3), np.float32),
        normal=f32([normal]),
        axis=f32([[0.8, 0, -0.6]]),
        radii=f32([radii]),
        extinction=f32([share]),
    )
    u = np.linspace(-2, 2, 161)
    for angle in (0, 25, 90):
        d = towards(angle)
        across = np.array([d[2], 0, -d[0]])
        grid = (u[:, None, None] * across + u[None, :, None] * [0, 1, 0]).reshape(-1, 3)
        depth = ref.splat_optical_depth(cloud, grid - 5 * d, np.tile(d, (len(grid), 1)))
        mass = 4 / 3 * np.pi * radii.prod() * share
        np.testing.assert_allclose(depth.sum(axis=0) * (u[1] - u[0]) ** 2, mass, rtol=1e-3)  # measured 2e-4


@pytest.mark.parametrize("angle", [0, 45, 80])
def test_samples_of_a_translucent_surface_add_up_to_its_alpha(angle):
    alpha, spacing, a, b = 0.3, 0.1, 0.13, 0.09
    grid = np.arange(-1.5, 1.5, spacing)
    p = np.stack(np.meshgrid(grid, grid, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    share = -np.expm1(np.log1p(-alpha) * spacing**2 / (np.pi * a * b))
    n = len(p)
    cloud = PointCloud(
        f32(p),
        normal=f32(np.tile(Z, (n, 1))),
        axis=f32(np.tile([1, 0, 0], (n, 1))),
        radii=f32(np.tile([a, b], (n, 1))),
        opacity=np.full(n, share, np.float32),
    )
    u = (np.arange(8) + 0.5) / 8 * spacing
    hits = np.stack(np.meshgrid(u, u, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    through = ref.splat_transmittance(cloud, hits - 2 * towards(angle), np.tile(towards(angle), (64, 1)))
    assert through.mean() == pytest.approx(1 - alpha, abs=1e-3)  # measured 8e-5
    before = ref.splat_transmittance(cloud, hits - 2 * towards(angle), np.tile(towards(angle), (64, 1)), 1.99)
    assert np.all(before == 1)


def test_opaque_splats_stop_light_inside_their_ellipse():
    cloud = PointCloud(f32([[0, 0, 0]]), normal=f32([[0, 0, 1]]), axis=f32([[1, 0, 0]]), radii=f32([[1.0, 0.5]]))
    origins = np.array([[0.9, 0, -1], [0, 0.6, -1], [0, 0.45, -1]])
    depth = ref.splat_optical_depth(cloud, origins, np.tile(Z, (3, 1)))
    np.testing.assert_array_equal(depth, [100, 0, 100])
    ball = PointCloud(f32([[0, 0, 0]]), radii=f32([[0.5]]))
    np.testing.assert_array_equal(ref.splat_optical_depth(ball, origins, np.tile(Z, (3, 1))), [0, 0, 100])


def test_a_half_covered_node_lets_half_through():
    cloud = PointCloud(f32([[0, 0, 0]]), radii=f32([[1.0]]), extinction=f32([500.0]))
    seen = ref.splat_transmittance(cloud, np.array([[0.0, 0, -3]]), Z[None], covered=np.array([0.5]))
    assert seen[0] == pytest.approx(0.5, abs=1e-12)


def test_no_splats_absorb_nothing():
    cloud = PointCloud(np.zeros((0, 3), np.float32), radii=np.zeros((0, 1), np.float32))
    np.testing.assert_array_equal(ref.splat_transmittance(cloud, np.zeros((2, 3)), np.stack([Z, Z])), [1, 1])
