"""Coarser meshes in place of dense ones far away, beside these with many sub-samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.prepare.meshes import coarse
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl, render

SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
EYE = cameras.camera((0, -6, 0), resolution=(32, 24), near=0.05, far=60)
MANY = 272  # sub-samples of a pixel


@pytest.fixture
def coarser(monkeypatch):
    """Whether dense meshes have coarser ones, however few their triangles are: set by a call."""

    def set_to(on: bool) -> None:
        monkeypatch.setattr(coarse, "FEWEST_TRIANGLES", 0 if on else 1 << 60)
        opengl().store.clear()

    return set_to


def ball(smooth: bool) -> Mesh:
    """A ball with waves, of 159,200 triangles and 15 pixels."""
    mesh = meshes.sphere_mesh("dense", 200)
    waves = 1 + 0.05 * np.sin(9 * mesh.position[:, :1]) * np.cos(7 * mesh.position[:, 2:])
    position = (mesh.position * waves).astype(np.float32)
    make = meshes.with_smooth_normals if smooth else meshes.flat_mesh
    return make(f"dense, smooth {smooth}", position, mesh.triangles)


def drawn(scene: Scene, samples: int = 16, **settings) -> tuple[np.ndarray, int]:
    result = render(Case(scene, EYE, replace(SETTINGS, **settings)), frozenset({"combined"}), samples)
    return result.pixels["combined"].astype(np.float64), result.report["triangles"]


def rmse(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean((a - b) ** 2)))


@pytest.mark.parametrize("shadows", [False, True], ids=["no shadows", "shadows"])
@pytest.mark.parametrize("smooth", [False, True], ids=["flat", "smooth"])
def test_they_are_as_near_as_sub_samples_allow(smooth, shadows, coarser):
    """RMSE of 17 sub-samples 0.0023 to 0.00242, where those of the mesh itself have 0.0022: 1.08 of it at most; the
    mean is off by 0.0007 at most."""
    scene = build.scene((build.mesh(ball(smooth)), np.eye(4)), transparent=True)
    coarser(False)
    truth, whole = drawn(scene, MANY, use_shadows=shadows)
    few, _ = drawn(scene, use_shadows=shadows)
    coarser(True)
    found, triangles = drawn(scene, use_shadows=shadows)
    assert triangles < whole / 4
    assert rmse(found, truth) < 1.12 * rmse(few, truth)
    assert abs(found.mean() / truth.mean() - 1) < 0.001


def test_what_is_near_and_what_would_vanish_stay_as_they_are(coarser):
    coarser(True)
    mesh = ball(False)
    near = build.scene((build.mesh(mesh), build.moved((0, -3.5, 0))))
    assert drawn(near)[1] == len(mesh.triangles)
    # Needles of a tenth of a cell have no area once they are merged.
    at = np.random.default_rng(0).random((40_000, 1, 3)) * 2 - 1
    needles = (at + np.array([[0, 0, 0], [0.003, 0, 0], [0, 0, 0.2]])).reshape(-1, 3).astype(np.float32)
    hair = meshes.flat_mesh("needles", needles, np.arange(len(needles)).reshape(-1, 3))
    assert drawn(build.scene((build.mesh(hair), np.eye(4))))[1] == 40_000


def test_the_nearest_of_several_instances_decides(coarser):
    coarser(True)
    of = build.mesh(ball(False))
    alone = drawn(build.scene((of, np.eye(4))))[1]
    both = drawn(build.scene((of, build.moved((1.2, -2, 0))), (of, build.moved((-1.2, 0, 0)))))[1] / 2
    assert alone < both


def test_the_area_of_a_divided_mesh_is_told_by_some_of_its_triangles():
    """Parts of twelve sizes in turns: every twelfth triangle, or every 144th, is of one size."""
    corner = np.linspace(0.1, 1.2, 12, dtype=np.float32)
    position = np.zeros((12, 3, 3), np.float32)
    position[:, 1, 0] = position[:, 2, 1] = corner
    mesh = Mesh(
        "turns",
        "Turns",
        np.tile(position.reshape(-1, 3), (16384, 1)),
        np.arange(12 * 3 * 16384, dtype=np.int32).reshape(-1, 3),
    )
    _, _, found = coarse._survey(mesh)
    assert abs(found / (16384 * 0.5 * float((corner.astype(float) ** 2).sum())) - 1) < 0.01  # measured 0.0007
