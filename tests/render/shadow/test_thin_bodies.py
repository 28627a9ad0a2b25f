"""Bodies thinner than a texel of a shadow map, whose smooth normals turn their backs towards the light: it reaches what
bulges beyond the rim (Hanika 2021), and does not come through to the rest."""

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
INSIDE = (
    0.9  # of the half side, where rays that cross the leaf's plane meet the leaf: beyond, texels see what is beside it
)
OUTSIDE = 1.1  # the same, where they miss it
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


def crossed(position: np.ndarray) -> np.ndarray:
    """(N,): how many half sides from the leaf's middle rays cross its plane, which lead to the sun from places (N, 3)
    of its lower side, lifted by as much as Cycles lifts rays from planes that do not face the light."""
    shape, found = leaf(), np.full(len(position), np.nan)
    assert shape.vertex_normal is not None
    for corners in shape.triangles:
        p, normal = shape.position[corners].astype(float), shape.vertex_normal[corners].astype(float)
        if not (p[:, 2] < 0).all():
            continue
        weights = np.linalg.solve(
            np.vstack([p[:, :2].T, np.ones(3)]), np.column_stack([position[:, :2], np.ones(len(position))]).T
        ).T
        height = np.einsum("nkc,kc->nk", p - position[:, None], normal)
        bulge = np.maximum(height.min(axis=1), 0.5 * (weights * height).sum(axis=1))
        begin = position + bulge[:, None] * (weights @ normal)
        at = begin - (begin[:, 2] / SLANTED[2])[:, None] * np.array(SLANTED)
        mine = (weights > -1e-3).all(axis=1)
        found[mine] = np.abs(at[mine, :2]).max(axis=1)
    return found


@pytest.mark.parametrize("light", LIGHTS)
def test_the_back_of_a_leaf_is_lit_only_beyond_its_rim(light: str) -> None:
    """Texels are wider than the leaf is thick."""
    far = [(build.mesh(meshes.cube_mesh(f"far {x}")), build.moved((x, 0, 0))) for x in (-40, 40)]
    leaves = (build.mesh(leaf(), "POLYGONS"), np.eye(4))
    scene = build.scene(leaves, *far, lights=[LIGHTS[light]], world=World(np.zeros(3)))
    settings = Settings(technique="VISIBILITY", use_adaptive_sampling=False)
    wanted = frozenset({"combined", "position"})
    shown = render(Case(scene, FROM_BELOW, settings), wanted).pixels
    plain = render(Case(scene, FROM_BELOW, replace(settings, use_shadows=False)), wanted).pixels
    position = shown["position"].astype(float)
    below = (position[..., 2] < 0) & (np.abs(position[..., :2]).max(-1) < 1)
    away = crossed(position[below])
    lit, unshadowed = (pixels["combined"][below, :3].max(axis=1) for pixels in (shown, plain))
    dark, bright = (away < INSIDE) & (unshadowed > 0.1), (away > OUTSIDE) & (unshadowed > 0.1)
    assert dark.sum() > 100
    assert bright.sum() > 100
    assert lit[dark].max() < 1e-6  # measured 2e-9; 0.4 with the bias of what faces the light
    assert np.abs(lit - unshadowed)[bright].max() < 1e-6  # measured 0
