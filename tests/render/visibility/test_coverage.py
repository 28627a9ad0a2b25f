"""The visibility buffer covers what primitives cover: areas by closed forms, edges by the filter's integral."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.pixel_filter import FILTER_SIZE, blackman_harris
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from scripts.scenes import build, cameras
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

SIDE = 128  # pixels, and units of the parallel camera
SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
SUB_SAMPLES = 17
COMBINED = frozenset({"combined"})


def alpha(geometry: Geometry, samples: int = 16, side: int = SIDE, settings: Settings = SETTINGS) -> np.ndarray:
    """(side, side) float64 of one geometry before a transparent film, seen along +Y with one unit a pixel."""
    eye = cameras.camera((0, -100, 0), resolution=(side, side), parallel=float(side), near=1, far=300)
    drawn = build.scene((geometry, np.eye(4)), lights=[build.sun()], transparent=True)
    result = render(Case(drawn, eye, settings), COMBINED, samples)
    assert result.report["technique"]["name"] == "VISIBILITY"
    return result.pixels["combined"][..., 3].astype(np.float64)


def apart(radius: float, seed: int) -> tuple[np.ndarray, np.random.Generator]:
    """Random places (N, 3) in the picture, farther than twice the radius from each other and from the rim."""
    rng = np.random.default_rng(seed)
    count = min(int(SIDE / (2.2 * radius)), 100)
    cell = SIDE / count
    corner = np.stack(np.meshgrid(np.arange(count), np.arange(count)), axis=-1).reshape(-1, 2) * cell
    xz = corner + radius + rng.uniform(0, 1, corner.shape) * (cell - 2 * radius) - SIDE / 2
    return np.column_stack([xz[:, 0], rng.uniform(-5, 5, len(xz)), xz[:, 1]]), rng


def shape(kind: str, radius: float) -> tuple[Geometry, float]:
    """Balls, disks, tilted disks or triangles, and the area in pixels that all of them cover."""
    at, rng = apart(radius, seed=7)
    key, count = f"{kind} of {radius}", len(at)
    if kind == "triangles":
        turn = rng.uniform(0, 2 * np.pi, (count, 1)) + np.arange(3) * 2 * np.pi / 3
        corners = at[:, None] + radius * np.stack([np.cos(turn), np.zeros_like(turn), np.sin(turn)], axis=-1)
        normal = np.tile(np.array([0, -1, 0], np.float32), (3 * count, 1))
        triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
        mesh = Mesh(key, key, corners.reshape(-1, 3).astype(np.float32), triangles, normal)
        return Geometry(key, key, mesh=mesh), count * 0.75 * np.sqrt(3) * radius**2
    normal, seen = None, np.ones(count)
    if kind != "balls":
        tilt = rng.uniform(0, 1.4, count) if kind == "tilted disks" else np.zeros(count)
        turn = rng.uniform(0, 2 * np.pi, count)
        seen = np.cos(tilt)
        normal = np.stack([np.sin(tilt) * np.cos(turn), -seen, np.sin(tilt) * np.sin(turn)], axis=1).astype(np.float32)
    radii = np.full((count, 2), radius, np.float32)
    cloud = PointCloud(origin=np.zeros(3), position=at.astype(np.float32), normal=normal, radii=radii)
    return Geometry(key, key, cloud=cloud), float(np.pi * radius**2 * seen.sum())


@pytest.mark.parametrize("radius", [0.05, 0.15, 0.4, 1.0, 2.9, 3.1, 8.0, 50.0])
@pytest.mark.parametrize("kind", ["balls", "disks", "tilted disks", "triangles"])
def test_what_is_covered_is_what_primitives_cover(kind, radius):
    """No bias with size: within three standard deviations of as many points thrown at random. Measured: at most
    2.1; of what is wider than a pixel, whose edges alone are uncertain, at most 0.9."""
    geometry, area = shape(kind, radius)
    found = alpha(geometry, side=SIDE + 4).sum()  # with the rim that the pixel filter spreads over
    assert abs(found / area - 1) < 3 / np.sqrt(area * SUB_SAMPLES)


def filtered_balls(at: np.ndarray, radius: float, points: int = 48) -> np.ndarray:
    """(SIDE, SIDE) float64: the filter's integral over balls, by so many points a pixel along each axis."""
    fine = np.zeros((SIDE * points, SIDE * points), bool)
    middle = (at[:, [2, 0]] + SIDE / 2) * points - 0.5
    reach = int(radius * points) + 1
    step = np.arange(-reach, reach + 2)
    row = np.floor(middle[:, :1]).astype(int) + step
    column = np.floor(middle[:, 1:]).astype(int) + step
    away = (row - middle[:, :1])[:, :, None] ** 2 + (column - middle[:, 1:])[:, None, :] ** 2
    rows, columns = np.broadcast_arrays(row[:, :, None], column[:, None, :])
    inside = away < (radius * points) ** 2
    fine[rows[inside], columns[inside]] = True
    t = (np.arange(3 * points) + 0.5) / points - 1.5
    weight = blackman_harris(t, FILTER_SIZE)
    blur = np.zeros((SIDE, SIDE * points))
    for y in range(SIDE):
        low = (y - 1) * points
        taken = slice(max(low, 0), min(low + 3 * points, SIDE * points))
        blur[y, taken] = weight[taken.start - low : taken.stop - low] / weight.sum()
    return blur @ fine @ blur.T


def test_many_lattices_together_are_the_filters_integral():
    """Balls of 0.4 pixels: pixel by pixel, and all of them."""
    geometry, _ = shape("balls", 0.4)
    assert geometry.cloud is not None
    exact = filtered_balls(geometry.cloud.position.astype(np.float64), 0.4)
    found = alpha(geometry, samples=SUB_SAMPLES * 64)
    assert np.sqrt(np.mean((found - exact) ** 2)) < 0.01  # measured 0.003
    assert abs(found.sum() / exact.sum() - 1) < 1e-3  # measured 1e-4


def window_integral(x: np.ndarray, size: float) -> np.ndarray:
    """The filter's share, along one axis, of what lies below `x` pixels from its centre."""
    t = np.clip(x / size, -1, 1)
    waves = 0.48829 * np.sin(np.pi * t) + 0.14128 / 2 * np.sin(2 * np.pi * t) + 0.01168 / 3 * np.sin(3 * np.pi * t)
    return (t + 1) / 2 + waves / (2 * np.pi * 0.35875)


def edge_integral(angle: float, offset: float, size: float = FILTER_SIZE) -> np.ndarray:
    """(H, W) float64: the filter's integral over the half plane below an edge at an angle of 0 to pi / 2: in closed
    form along the axis that is nearer to the edge's normal, by 96 points along the other."""
    along, across = sorted((np.cos(angle), np.sin(angle)))
    t = ((np.arange(96) + 0.5) / 48 - 1) * size
    weight = blackman_harris(t, size)
    centre = np.arange(SIDE) + 0.5 - SIDE / 2
    distance = centre[None] * np.cos(angle) + centre[:, None] * np.sin(angle) - offset
    near = np.abs(distance) < np.sqrt(2) * size
    found = (distance < 0).astype(float)
    found[near] = window_integral(-(distance[near][:, None] + t * along) / across, size) @ weight / weight.sum()
    return found


def edge(angle: float, offset: float) -> Geometry:
    along, across = np.array([-np.sin(angle), 0, np.cos(angle)]), np.array([np.cos(angle), 0, np.sin(angle)])
    far = 4.0 * SIDE
    corners = np.array([offset * across - far * along, offset * across + far * along, -3 * far * across])
    key = f"edge {angle} {offset}"
    normal = np.tile(np.array([0, -1, 0], np.float32), (3, 1))
    return Geometry(key, key, mesh=Mesh(key, key, corners.astype(np.float32), np.array([[0, 1, 2]], np.int32), normal))


def edge_error(samples: int, angles: np.ndarray) -> float:
    """Root mean square over edges of the error of a picture's row or column, summed: of the pixels along an edge."""
    squares = []
    for i, angle in enumerate(angles.tolist()):
        offset = 3.7 * ((0.618 * i) % 1)
        error = alpha(edge(angle, offset), samples) - edge_integral(angle, offset)
        squares.append(np.square(error).sum() / SIDE)
    return float(np.sqrt(np.mean(squares)))


def test_edges_converge_to_the_filters_integral():
    """Faster than points thrown at random, whose error falls by N^-0.5."""
    angles = np.linspace(0.01, np.pi / 2, 12)
    few, many = edge_error(SUB_SAMPLES, angles), edge_error(16 * SUB_SAMPLES, angles)
    assert few < 0.04  # measured 0.023
    assert many < few / 16**0.7  # measured few / 16^0.75


@pytest.mark.parametrize(("size", "most"), [(0.3, 0.02), (0.75, 0.004), (2.0, 0.0013), (4.5, 0.0003)])
def test_filters_of_all_sizes_are_their_integrals(size, most):
    """Narrow ones as far as lattices allow; wide ones up to the picture's rim, and over more than the next pixels."""
    settings = replace(SETTINGS, filter_size=size)
    for angle, offset in ((0.4, 1.3), (1.2, -2.2)):
        error = alpha(edge(angle, offset), 64 * SUB_SAMPLES, settings=settings) - edge_integral(angle, offset, size)
        # Of the pixels along an edge; measured 0.011, 0.0019, 0.00064 and 0.00017.
        assert np.sqrt(np.square(error).sum() / SIDE) < most


def test_samples_are_rounded_up_to_whole_lattices():
    geometry, _ = shape("balls", 8.0)
    eye = cameras.camera((0, -100, 0), resolution=(16, 16), parallel=float(SIDE), near=1, far=300)
    case = Case(build.scene((geometry, np.eye(4)), transparent=True), eye, SETTINGS)
    for asked, lattices in ((1, 1), (17, 1), (18, 2), (64, 4)):
        report = render(replace(case), COMBINED, asked).report
        assert report["points"]["drawn"] == lattices * report["points"]["cut"]
