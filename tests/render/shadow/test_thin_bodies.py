"""Bodies thinner than a texel of a shadow map: no light comes through to what their smooth normals turn towards it."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

SLANTED = (0.7, 0.1, -0.7)
LIGHTS = {"sun": build.sun(direction=SLANTED), "wide sun": replace(build.sun(direction=SLANTED), radius=0.02)}
INSIDE = 0.9  # of the half side: beyond, texels see what is beside the leaf
FROM_BELOW = cameras.camera((-1.0, -2.0, -3.0), (0, 0, 0), resolution=(64, 48))


def leaf() -> Mesh:
    """A plate of 2 by 2 by 0.001, whose normals lie nearly in its plane, as leaves' do where both sides meet."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    sides = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6), (0, 1, 3, 2), (4, 6, 7, 5)]
    triangles = np.array([t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))], np.int32)
    normal = corners * (1, 1, 0.2)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    position = (corners * (1, 1, 5e-4)).astype(np.float32)
    return Mesh("leaf", "leaf", position, triangles, vertex_normal=normal.astype(np.float32))


def brightest(light: str, *, use_shadows: bool) -> float:
    """Radiance of the leaf's lower side away from its rim, where texels are wider than the leaf is thick."""
    far = [(build.mesh(meshes.cube_mesh(f"far {x}")), build.moved((x, 0, 0))) for x in (-40, 40)]
    leaves = (build.mesh(leaf(), "POLYGONS"), np.eye(4))
    scene = build.scene(leaves, *far, lights=[LIGHTS[light]], world=World(np.zeros(3)))
    settings = Settings(technique="VISIBILITY", use_adaptive_sampling=False, use_shadows=use_shadows)
    case = Case(scene, FROM_BELOW, settings)
    pixels = render(case, frozenset({"combined", "position"})).pixels
    position = pixels["position"]
    inside = (position[..., 2] < 0) & (np.abs(position[..., :2]).max(-1) < INSIDE)
    assert inside.mean() > 0.1
    return float(pixels["combined"][inside, :3].max())


@pytest.mark.parametrize("light", LIGHTS)
def test_the_back_of_a_leaf_is_in_its_own_shadow(light: str) -> None:
    assert brightest(light, use_shadows=False) > 0.1
    # 0 and 4e-9 measured; 0.34 and 0.40 with the bias of what faces the light.
    assert brightest(light, use_shadows=True) < 1e-6
