"""Captured splats in shadow tables: against the optical depth of single rays in float64."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.shadow import builder
from pointsplat_addon.core.shadow.captured import entries
from pointsplat_addon.core.shadow.captured.casters import captured_casters
from scripts.common.shadow_truth import transmittance
from scripts.scenes.captured_cases import SHEARED, one_splat, random_splats
from tests.reference.captured import rotations

DOWN = np.array([0.0, 0.0, -1.0])
LIGHTS = {
    "sun": Light("SUN", np.ones(3), np.zeros(3), np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])),
    "lamp": Light("POINT", np.ones(3), np.array([0.5, 0.2, 4.0]), DOWN),
    "lamp among them": Light("POINT", np.ones(3), np.array([0.02, 0.03, 0.01]), DOWN),
}


def through(splats: CapturedSplats, matrix: np.ndarray, light: Light, points: np.ndarray) -> np.ndarray:
    """(P,): what reaches points from a light along straight rays, whose nearest place to each centre decides."""
    linear = matrix[:3, :3]
    centre = splats.position.astype(float) @ linear.T + matrix[:3, 3]
    inverse = np.linalg.inv(
        linear @ (rotations(splats.rotation.astype(float)) * np.maximum(splats.scale, 1e-7).astype(float)[:, None])
    )
    found = np.ones(len(points))
    for k, point in enumerate(points):
        ray = light.direction if light.kind == "SUN" else point - light.position
        # In units of standard deviations, from the receiver.
        offset, along = ((inverse @ v[..., None])[..., 0] for v in (centre - point, np.broadcast_to(ray, centre.shape)))
        t = np.einsum("nc,nc->n", offset, along) / np.einsum("nc,nc->n", along, along)
        q = ((offset - t[:, None] * along) ** 2).sum(axis=1)
        alpha = np.minimum(splats.opacity, 0.99) * np.exp(-0.5 * q)
        before = (t < 0) & ((t > -1) | (light.kind == "SUN"))
        found[k] = np.prod(1 - np.where(before & (alpha >= 1 / 255), alpha, 0))
    return found


def stacked(splat: CapturedSplats, heights: np.ndarray) -> CapturedSplats:
    """One splat at several heights."""
    names = ("position", "scale", "rotation", "base", "opacity")
    arrays = {name: np.repeat(getattr(splat, name), len(heights), axis=0) for name in names}
    arrays["position"][:, 2] = heights
    return replace(splat, **arrays)


def looked_up(splats: CapturedSplats, matrix: np.ndarray, light: Light, points: np.ndarray, resolution: int = 1024):
    table = builder.build_table(light, [captured_casters(splats, matrix)], resolution)
    return transmittance(table, points).reshape(len(points))


# Scales of one splat, with the greatest and the root mean square error of the share of light below it; measured: half
# of that and more. What a light sees as a needle is blurred by cells of an eighth of its length.
SHAPES = {
    "ball": ((0.3, 0.3, 0.3), 0.06, 0.02),
    "disk": ((0.4, 0.25, 0.02), 0.25, 0.04),
    "needle": ((0.5, 0.03, 0.03), 0.2, 0.03),
}


@pytest.mark.parametrize("matrix", [np.eye(4), SHEARED], ids=["as it is", "sheared"])
@pytest.mark.parametrize("light", ["sun", "lamp"])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_splat_leaves_what_its_opacity_says(light, shape, matrix):
    scale, worst, rms = SHAPES[shape]
    splat = one_splat((0.05, -0.02, 0.1), scale, 0.9, rotation=(0.6, 0.5, -0.3, 0.55))
    splat = replace(splat, rotation=splat.rotation / np.linalg.norm(splat.rotation))
    points = np.column_stack([np.random.default_rng(3).uniform(-1.5, 1.5, (600, 2)), np.full(600, -1.5)])
    expected = through(splat, matrix, LIGHTS[light], points)
    error = looked_up(splat, matrix, LIGHTS[light], points) - expected
    assert expected.min() < 0.9
    assert np.abs(error).max() < worst
    assert np.sqrt(np.mean(error**2)) < rms


@pytest.mark.parametrize("light", ["sun", "lamp"])
def test_depths_of_many_splats_add_up(light):
    splats = random_splats(3000, 0, size=0.12)
    splats = replace(splats, opacity=splats.opacity * np.float32(0.3))
    unit = np.random.default_rng(1).normal(size=(500, 3))
    points = 6 * unit / np.linalg.norm(unit, axis=1, keepdims=True)
    points[:, 2] = -np.abs(points[:, 2])
    expected = -np.log(through(splats, np.eye(4), LIGHTS[light], points))
    found = -np.log(looked_up(splats, np.eye(4), LIGHTS[light], points))
    # Measured 0.2 % and 0.008 of 0.5 for the sun; 3 % and 0.11 of 2.6 for the lamp, of splats near to it.
    assert found.mean() == pytest.approx(expected.mean(), rel=0.05)
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.07 * expected.mean()


def test_a_lamp_within_splats_is_not_hidden_by_them():
    lamp = replace(LIGHTS["lamp"], position=np.array([0.05, 0, 0]))
    unit = np.random.default_rng(1).normal(size=(100, 3))
    np.testing.assert_array_equal(looked_up(one_splat((0, 0, 0), 0.2, 0.9), np.eye(4), lamp, 3 * unit), 1.0)


@pytest.mark.parametrize("opacity", [0.05, 0.3, 0.9])
def test_a_stack_of_wide_splats_leaves_a_power(opacity):
    """Between five disks, each of which leaves as much as its middle."""
    splats = stacked(one_splat((0, 0, 0), (2.0, 2.0, 0.01), opacity), 0.2 * np.arange(5))
    points = np.column_stack([np.zeros((6, 2)), [-0.4, 0.1, 0.3, 0.5, 0.7, 1.2]])
    found = looked_up(splats, np.eye(4), replace(LIGHTS["sun"], direction=DOWN), points)
    np.testing.assert_allclose(found, (1 - opacity) ** np.arange(5, -1, -1.0), atol=0.02)  # measured 0.009


def test_wider_cells_keep_the_optical_mass(monkeypatch):
    """Of so many splats that cells must be wider than they: shadows are softer, and as dark in the mean."""
    splats = replace(random_splats(400, 0, size=0.02), opacity=np.full(400, 0.05, np.float32))
    sun = replace(LIGHTS["sun"], direction=DOWN)
    x = np.linspace(-4, 4, 400)
    points = np.stack(np.meshgrid(x, x, [-5.0]), axis=-1).reshape(-1, 3)
    means = []
    for most in (entries.MOST_ENTRIES, 6000):
        monkeypatch.setattr(entries, "MOST_ENTRIES", most)
        means.append(-np.log(looked_up(splats, np.eye(4), sun, points)).mean())
    assert means[1] == pytest.approx(means[0], rel=0.005)  # measured 0.0005


@pytest.mark.parametrize("light", LIGHTS)
def test_extreme_splats_cast_finite_shadows(light):
    splats = random_splats(200, 0, size=0.1)
    scale = splats.scale.copy()
    scale[:50], scale[50:100], scale[100:150, 0] = 1e-9, 1e9, 0.0
    points = np.random.default_rng(2).normal(size=(200, 3))
    found = looked_up(replace(splats, scale=scale), np.eye(4), LIGHTS[light], points, 64)
    assert np.isfinite(found).all()
    assert (found >= 0).all()
    assert (found <= 1).all()
