"""A convex body that is alone: it needs no shadows, and what would be wrong without them is not taken for one."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes.input_nodes import Constant
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.shadow import shadows
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

COMBINED = frozenset({"combined"})
SETTINGS = Settings(technique="VISIBILITY", use_adaptive_sampling=False)
CAMERA = cameras.camera((3.0, -4.0, 2.5), (0, 0, 0), resolution=(96, 72))
LEANING = build.moved((0.1, 0.2, 0), (1.0, 0.6, 1.3))
BRIGHT = np.full(3, 300.0)
LIGHTS = {
    "sun": build.sun(),
    "wide sun": replace(build.sun(), radius=0.3),
    "point": Light("POINT", BRIGHT, np.array([1.0, -1.5, 4.0]), np.array([0.0, 0, -1])),
}
# The plane of the cube's upper face cuts it.
SQUARE = Light("AREA", BRIGHT, np.array([0.0, -4.0, 1.0]), np.array([0.0, 1, 0]),
               axis_u=np.array([1.0, 0, 0]), axis_v=np.array([0.0, 0, 1]))  # fmt: skip


def cube(name: str = "lone cube", **more):
    return build.mesh(replace(meshes.cube_mesh(name), **more), "POLYGONS")


def why(case: Case) -> str:
    return shadows.make_shadows(case.scene, case.settings, Store(), camera=case.camera)[1]


@pytest.mark.parametrize("light", LIGHTS)
def test_its_picture_is_that_with_shadows(light: str, monkeypatch) -> None:
    case = Case(build.scene((cube(), LEANING), lights=[LIGHTS[light]]), CAMERA, SETTINGS)
    assert why(case) == "a convex body is alone"
    without = render(case, COMBINED).pixels["combined"]
    monkeypatch.setattr(shadows, "is_lone_body", lambda *given: False)
    assert why(case) == ""
    shadowed = render(case, COMBINED).pixels["combined"]
    assert without[..., :3].max() > 0.1
    np.testing.assert_array_equal(without, shadowed)


@pytest.mark.parametrize("alone", [True, False])
def test_of_a_light_that_its_plane_cuts_a_face_has_what_is_above(alone: bool) -> None:
    matt = build.materials(specular=np.zeros(1), roughness=np.ones(1))
    others = [] if alone else [(cube("far away"), build.moved((30, 0, 0)))]
    scene = build.scene((cube(), LEANING), *others, lights=[SQUARE], table=matt, world=World(np.zeros(3)))
    case = Case(scene, CAMERA, SETTINGS)
    assert (why(case) != "") == alone
    pixels = render(case, frozenset({"combined", "position", "normal"})).pixels
    lit, position, normal = pixels["combined"][..., 0], pixels["position"].astype(float), pixels["normal"].astype(float)

    def share(axis: int, sign: int) -> float:
        """The radiance of a face over a numerical integral over the light: the same number for all faces."""
        face = (sign * normal[..., axis] > 0.999) & (pixels["combined"][..., 3] > 0.999)
        for along, by in ((0, 1), (0, -1), (1, 1), (1, -1)):  # no pixel whose filter reaches another face
            face = face & np.roll(face, by, axis=along)
        of = np.argwhere(face)
        of = of[:: max(1, len(of) // 40)]
        return float(np.median([lit[y, x] / irradiance(position[y, x], normal[y, x]) for y, x in of]))

    # 2.1e-4 apart, by maps as well, by the normals that the picture shows: by (0, 0, 1), 0.8 %. If maps hide what is
    # below the plane, the upper face has a third of its light.
    assert share(2, 1) == pytest.approx(share(1, -1), rel=1e-3)


def irradiance(at: np.ndarray, normal: np.ndarray) -> float:
    """At a position of a face, by the square for one unit of radiance, by 200 by 200 points of it."""
    side = (np.arange(200) + 0.5) / 100 - 1
    u, v = (grid.reshape(-1, 1) for grid in np.meshgrid(side, side))
    toward = SQUARE.position + u * SQUARE.axis_u + v * SQUARE.axis_v - at
    received = np.maximum(toward @ normal, 0) * np.maximum(-toward @ SQUARE.direction, 0)
    return float((received / (toward**2).sum(axis=1) ** 2).mean())


def test_what_else_is_there_or_may_be_seen_takes_shadows() -> None:
    mesh = meshes.cube_mesh("lone cube, changed")
    around = mesh.position / np.linalg.norm(mesh.position, axis=1, keepdims=True)
    inside = cameras.camera((0.0, 0.0, 0.0), (0, 1, 0), resolution=(96, 72))
    close = replace(CAMERA, near=4.5)
    lone = build.scene((cube(), LEANING))
    turned = build.materials(graphs=(MaterialGraph(normal=Constant((0.0, 0.6, 0.8))),))
    opened = meshes.flat_mesh("open cube", mesh.position, mesh.triangles[1:])
    for scene, camera in (
        (build.scene((cube(), LEANING), (cube(), build.moved((3, 0, 0)))), CAMERA),
        (build.scene((cube(), LEANING), (cube("another"), build.moved((3, 0, 0)))), CAMERA),
        (build.scene((cube("round cube", vertex_normal=around), LEANING)), CAMERA),
        (build.scene((build.mesh(opened, "POLYGONS"), LEANING)), CAMERA),
        (build.scene((build.mesh(meshes.sphere_mesh("not so few triangles"), "POLYGONS"), LEANING)), CAMERA),
        (build.scene((cube(), LEANING), table=turned), CAMERA),
        (lone, inside),
        (lone, close),
    ):
        assert why(Case(scene, camera, SETTINGS)) != "a convex body is alone"
    assert why(Case(lone, CAMERA, SETTINGS)) == "a convex body is alone"
    assert shadows.make_shadows(lone, SETTINGS, Store())[0] is not None
