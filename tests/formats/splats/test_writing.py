"""Captured splats written and read again, and under transforms of the data."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pointsplat_addon.core.numeric.harmonics import harmonics
from pointsplat_addon.core.numeric.rotations import rotation_matrices
from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.formats.points.reader import PointFileError
from pointsplat_addon.formats.splats.opening import open_splats
from pointsplat_addon.formats.splats.writing.ply import write_ply
from pointsplat_addon.formats.splats.writing.spz import write_spz
from pointsplat_addon.formats.splats.writing.transform import quaternion, transformed
from tests.support.splat_files import read_all

NAMES = "position", "scale", "rotation", "base", "opacity", "sh"


def some(count=500, coefficients=15, **changes) -> Any:
    random = np.random.default_rng(count)
    rotation = random.standard_normal((count, 4))
    sh = random.uniform(-0.9, 0.9, (count, coefficients, 3)).astype(np.float32) if coefficients else None
    made = CapturedSplats(
        random.uniform(-5, 5, (count, 3)).astype(np.float32),
        np.exp(random.uniform(-9, 2, (count, 3))).astype(np.float32),
        (rotation / np.linalg.norm(rotation, axis=1, keepdims=True)).astype(np.float32),
        random.uniform(-3, 3, (count, 3)).astype(np.float32),
        random.uniform(0.01, 0.99, count).astype(np.float32),
        sh,
    )
    return replace(made, **changes)


def again(path, splats, **options) -> Any:
    (write_spz if path.suffix == ".spz" else write_ply)(path, splats, **options)
    with open_splats(path) as reader:
        return read_all(reader)


@pytest.mark.parametrize("coefficients", [0, 3, 8, 15, 24])
@pytest.mark.parametrize("antialiased", [False, True])
def test_ply_keeps_everything(tmp_path, coefficients, antialiased):
    splats = some(coefficients=coefficients, antialiased=antialiased)
    found = again(tmp_path / "a.ply", splats)
    for name in ("position", "base", "sh"):
        np.testing.assert_array_equal(getattr(found, name), getattr(splats, name))
    for name in ("scale", "rotation", "opacity"):
        np.testing.assert_allclose(getattr(found, name), getattr(splats, name), rtol=2e-6)  # measured 7.2e-7
    assert found.antialiased == antialiased
    assert [path.name for path in tmp_path.iterdir()] == ["a.ply"]


def test_ply_keeps_what_is_opaque_disks_and_far_positions(tmp_path):
    splats = some()
    opacity, scale = splats.opacity.copy(), splats.scale.copy()
    opacity[:3] = 1, 0, 0.5
    scale[:, 2] = 0
    splats = replace(splats, opacity=opacity, scale=scale, origin=np.array([500_000.0, 0, 0]))
    found = again(tmp_path / "a.ply", splats)
    np.testing.assert_allclose(found.opacity[:3], [1, 0, 0.5], atol=2e-8)  # measured 1.5e-8
    assert not found.scale[:, 2].any()
    np.testing.assert_allclose(found.position + found.origin, splats.position + splats.origin, atol=1e-6)
    for axis in (0, 2):  # one scale of zero among others
        scale = some().scale.copy()
        scale[0, axis] = 0
        assert again(tmp_path / "b.ply", some(scale=scale)).scale[0, axis] < 1e-29


# Half a step of each, as the format has them: positions 2^-17, logarithms of scales 1/32, quaternions' components
# sqrt(1/2) / 1022 and the largest component the three others' sum, colours 1 / (510 * 0.15), opacities 1/510,
# harmonics 1/256.
SPZ_STEPS = {
    "position": 2**-17,
    "rotation": 3 * math.sqrt(0.5) / 1022,
    "base": 1 / (510 * 0.15),
    "opacity": 1 / 510,
    "sh": 1 / 256,
}


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("coefficients", [0, 3, 8, 15, 24])
def test_spz_keeps_everything_to_half_a_step(tmp_path, version, coefficients):
    splats = some(coefficients=coefficients, antialiased=True)
    found = again(tmp_path / "a.spz", splats, version=version)
    sign = np.sign((found.rotation * splats.rotation).sum(axis=1, keepdims=True))
    found = replace(found, rotation=found.rotation * sign)
    for name, step in SPZ_STEPS.items():
        if name != "sh" or coefficients:
            difference = np.abs(getattr(found, name).astype(np.float64) - getattr(splats, name))
            assert difference.max() <= step * (1 + 1e-4), name
    assert np.abs(np.log(found.scale) - np.log(splats.scale)).max() <= 1 / 32 + 1e-5
    assert found.antialiased
    # What was rounded once stays as it is, but for quaternions with two components that are nearly the largest.
    last = again(tmp_path / "b.spz", found, version=version)
    for name in ("position", "base", "scale", "opacity", *(["sh"] if coefficients else [])):
        np.testing.assert_array_equal(getattr(last, name), getattr(found, name))


def test_spz_says_what_it_cuts_off_and_refuses_what_is_too_far_away(tmp_path):
    base = some().base.copy()
    base[:7] = 9
    assert write_spz(tmp_path / "a.spz", some(base=base)) == [
        "7 splats have colours or scales beyond what SPZ holds, which are cut off"
    ]
    with pytest.raises(PointFileError, match=r"b\.spz: cannot hold positions up to 9"):
        write_spz(tmp_path / "b.spz", some(origin=np.array([9e6, 0, 0])))
    far = some(origin=np.array([8e6, 0, 0]))
    np.testing.assert_allclose(again(tmp_path / "c.spz", far).position[:, 0], far.position[:, 0] + 8e6, atol=0.51)
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.spz", "c.spz"]


# Transforms


def covariance(splats):
    turned = np.moveaxis(rotation_matrices(splats.rotation.T.astype(np.float64)), 2, 0)
    axes = turned * splats.scale[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def seen(splats, direction):
    """Colours (N, 3) of splats from one direction (3,), less a half."""
    functions = harmonics(direction[None] / np.linalg.norm(direction), 3)[0]
    return functions[0] * splats.base + np.einsum("k,nkc->nc", functions[1:], splats.sh)


TURN = Rotation.from_rotvec([0.3, -1.1, 2.0]).as_matrix()
EXACT = {"turned": TURN, "scaled": 2.5 * TURN, "mirrored": 0.5 * TURN @ np.diag([1, -1, 1])}
OTHER = {"sheared": TURN @ [[1, 0.4, 0], [0, 1, 0], [0, 0.2, 1]], "stretched": TURN @ np.diag([1, 4, -0.5])}


@pytest.mark.parametrize("name", [*EXACT, *OTHER])
def test_transforms_of_data_are_those_of_gaussians_and_of_what_is_seen(name):
    linear = np.array({**EXACT, **OTHER}[name], np.float64)
    splats = some(200)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, (10, -20, 30)
    found, exact = transformed(splats, matrix)
    assert exact == (name in EXACT)
    expected = splats.position @ linear.T + matrix[:3, 3]
    np.testing.assert_allclose(found.position + found.origin, expected, atol=3e-6)  # measured 1.6e-6
    want = linear @ covariance(splats) @ linear.T
    largest = np.abs(want).max(axis=(1, 2), keepdims=True)
    assert (np.abs(covariance(found) - want) / largest).max() < 2e-6  # measured 7.3e-7
    np.testing.assert_allclose(np.linalg.norm(found.rotation, axis=1), 1, atol=1e-6)
    if exact:
        for direction in np.random.default_rng(1).standard_normal((5, 3)):
            # The direction in the object is that which its inverse makes of the world's.
            there = np.linalg.inv(linear) @ direction
            np.testing.assert_allclose(seen(found, direction), seen(splats, there), atol=1e-5)  # measured 1.9e-6


def test_quaternions_of_matrices_are_those_of_the_rotations():
    turns = Rotation.from_quat(np.random.default_rng(1).standard_normal((1000, 4)))
    half = Rotation.from_rotvec(math.pi * np.eye(3))
    matrix = np.concatenate([turns.as_matrix(), half.as_matrix(), np.eye(3)[None]])
    np.testing.assert_allclose(
        rotation_matrices(quaternion(matrix).T), np.moveaxis(matrix, 0, 2), atol=1e-12
    )  # measured 1.1e-15
