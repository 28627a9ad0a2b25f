"""Compute shaders draw the small triangles of dense meshes as the rasteriser does, without holes."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.frame.visibility import polygon_draws
from pointsplat_addon.render.passes.visibility.small_triangles import are_small
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

SETTINGS = Settings(technique="VISIBILITY")
PASSES = frozenset({"combined", "depth", "normal", "object_index"})
RINGS = 120  # of a sphere of 57,120 triangles


def ball(key: str) -> Geometry:
    return build.mesh(meshes.sphere_mesh(key, RINGS))


def with_floor(key: str) -> Geometry:
    """A dense ball on two triangles that reach behind the camera, in one mesh."""
    dense = meshes.sphere_mesh(key, RINGS)
    floor = np.array([[-50, -50, -1], [50, -50, -1], [50, 50, -1], [-50, 50, -1]], np.float32)
    position = np.concatenate([dense.position, floor])
    rows = np.array([[0, 1, 2], [0, 2, 3]], np.int32) + len(dense.position)
    return build.mesh(
        meshes.with_smooth_normals(f"{key} on a floor", position, np.concatenate([dense.triangles, rows]))
    )


def with_leaves(key: str) -> Geometry:
    """A dense ball that is small in the picture, and triangles of some pixels whose corners' normals differ."""
    dense = meshes.sphere_mesh(key, RINGS)
    assert dense.vertex_normal is not None
    side = 40
    x, z = np.meshgrid(np.linspace(-1.8, 1.8, side), np.linspace(-1.2, 1.4, side))
    middle = np.stack([x, np.full_like(x, 0.5), z], axis=-1).reshape(-1, 1, 3)
    leaf = middle + np.array([[-0.045, 0, -0.03], [0.045, 0, -0.03], [0, 0, 0.035]])
    rng = np.random.default_rng(5)
    bent = np.array([0, -1.0, 0]) + rng.uniform(-1, 1, (3 * side**2, 3)) * (0.8, 0.2, 0.8)
    position = np.concatenate([0.05 * dense.position, leaf.reshape(-1, 3)]).astype(np.float32)
    normal = np.concatenate([dense.vertex_normal, bent / np.linalg.norm(bent, axis=1, keepdims=True)]).astype(
        np.float32
    )
    rows = np.arange(3 * side**2, dtype=np.int32).reshape(-1, 3) + len(dense.position)
    return build.mesh(Mesh(key, key, position, np.concatenate([dense.triangles, rows]), normal))


def turned(*, mirrored: bool = False) -> np.ndarray:
    matrix = build.moved((2.2, 1.0, 0.3), (-1.0 if mirrored else 1.0, 0.8, 1.0))
    cos, sin = np.cos(0.4), np.sin(0.4)
    return matrix @ np.array([[cos, -sin, 0, 0], [sin, cos, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])


def lights() -> tuple[Light, ...]:
    return (build.sun(),)


SCENES = {
    "ball": lambda: build.scene((ball("ball"), np.eye(4)), lights=lights()),
    "floor": lambda: build.scene((with_floor("floor"), np.eye(4)), lights=lights()),
    "leaves": lambda: build.scene((with_leaves("leaves"), np.eye(4)), lights=lights()),
    "instances": lambda: build.scene(
        *[(geometry, matrix) for geometry in [ball("instances")] for matrix in (np.eye(4), turned(mirrored=True))],
        lights=lights(),
    ),
    "culled": lambda: build.scene(
        *[(geometry, matrix) for geometry in [ball("culled")] for matrix in (np.eye(4), turned(mirrored=True))],
        lights=lights(),
        table=build.materials(cull=[True]),
    ),
    "beside points": lambda: build.scene(
        (ball("beside"), np.eye(4)), (build.points("balls", points()), np.eye(4)), lights=lights()
    ),
}


def points() -> PointCloud:
    at = np.random.default_rng(3).uniform(-1.2, 1.2, (3000, 3)).astype(np.float32)
    return PointCloud(at, radii=np.full((3000, 1), 0.02, np.float32))


def drawn(scene: Scene, parallel: float | None, samples: int) -> dict[str, np.ndarray]:
    eye = cameras.camera((0.4, -4, 1.2), resolution=(96, 72), near=0.05, far=60, parallel=parallel)
    result = render(Case(scene, eye, SETTINGS), PASSES, samples)
    assert result.report["technique"]["name"] == "VISIBILITY"
    return result.pixels


@pytest.mark.parametrize("parallel", [None, 4.0], ids=["perspective", "parallel"])
@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_those_of_the_rasteriser(name, parallel, monkeypatch):
    scene = SCENES[name]()
    found = drawn(scene, parallel, 16)
    monkeypatch.setattr(polygon_draws, "are_small", lambda *given: False)
    expected = drawn(scene, parallel, 16)
    for key, most in (("combined", 3e-3), ("normal", 3e-3)):
        assert np.sqrt(np.mean((found[key] - expected[key]) ** 2)) < most, key
    # Under a pixel's centre edges belong to one triangle or its neighbour.
    both = (found["depth"] < 1e9) & (expected["depth"] < 1e9)
    assert np.mean(both != (expected["depth"] < 1e9)) < 1e-3
    np.testing.assert_allclose(found["depth"][both], expected["depth"][both], rtol=2e-3)
    assert np.mean(found["object_index"] != expected["object_index"]) < 1e-3


def test_compute_shaders_draw_them():
    """Else the tests above compare the rasteriser with itself."""
    assert are_small(57_120, np.array([[0.2, 0.2, 0.8, 0.8]]), (400, 400))
    assert not are_small(57_120, np.array([[0.0, 0.0, 1.0, 1.0]]), (4000, 4000))
    assert not are_small(19_999, np.array([[0.4, 0.4, 0.6, 0.6]]), (100, 100))


@pytest.mark.parametrize("size", [3.0, 11.0, 40.0])
def test_closed_surfaces_have_no_holes(size):
    """A wavy sheet of 80,000 triangles, seen along slanting lines: on whatever edges, something is hit."""
    side = 200
    at = np.linspace(-1, 1, side + 1)
    x, z = np.meshgrid(at, at)
    y = 0.1 * np.sin(9 * x + 5 * z) + np.random.default_rng(1).uniform(-0.004, 0.004, x.shape)
    position = np.stack([x + 0.3 * z, y, z - 0.2 * x], axis=-1).reshape(-1, 3).astype(np.float32)
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).reshape(-1, 1)
    rows = (corner + np.array([0, 1, side + 2, 0, side + 2, side + 1])).reshape(-1, 3).astype(np.int32)
    mesh = Mesh(f"sheet {size}", "sheet", position, rows, np.tile(np.array([0, -1, 0], np.float32), (len(position), 1)))
    scene = build.scene((build.mesh(mesh), np.eye(4)), lights=lights(), transparent=True, table=default_materials())
    width = 2.0 / size * 8
    eye = cameras.camera((0, -10, 0), resolution=(64, 64), parallel=min(width, 0.9), near=1, far=30)
    alpha = render(Case(scene, eye, SETTINGS), frozenset({"combined"}), 16).pixels["combined"][..., 3]
    assert alpha.min() == pytest.approx(1.0, abs=1e-5)
