"""Shadows of captured splats in pictures: what is left of a sun's light on a plane below them."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, clouds, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import one_splat

# What stands in XZ and faces -Y then lies in XY and faces +Z.
LYING = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1.0]])
DOWN = build.sun(3.0, (0, 0, -1))
BELOW = camera((0, 0, 1.0), (0, 0.001, 0), resolution=(40, 40), parallel=2.0)  # between the splats and the plane


def picture(*things, eye=BELOW, lights=(DOWN,), casts=None, samples=16, **settings):
    made = build.scene(*things, lights=lights, world=World(), transparent=True, table=TABLE)
    if casts is not None:
        made = replace(made, instances=replace(made.instances, casts=np.array(casts)))
    request = Request(eye, Settings(**settings), frozenset({"combined"}), samples)
    return drawing.opengl().render(made, request).pixels["combined"].astype(np.float64)


TABLE = build.materials(base_color=np.full((1, 3), 0.8), specular=[0])


@pytest.mark.parametrize("opacity", [0.2, 0.6, 0.95])
@pytest.mark.parametrize("receiver", ["mesh", "cloud"])
def test_a_plane_below_has_what_their_opacity_leaves(opacity, receiver):
    """1 - o exp(-q / 2) of the light, below a disk wider than the picture."""
    if receiver == "mesh":
        plane = build.mesh(meshes.plane_mesh("below captured", 4.0), "POLYGONS"), LYING
    else:
        plane = build.points("cloud below captured", clouds.plane_cloud(60, 4.0)), LYING
    slab = captured(f"slab {opacity}", one_splat((0, 0, 3), (1.5, 1.5, 0.01), opacity)), moved()
    lit, shaded = picture(plane), picture(plane, slab)
    share = shaded[..., 0] / lit[..., 0]
    x = (np.arange(40) + 0.5) / 20 - 1
    expected = 1 - opacity * np.exp(-0.5 * (x[:, None] ** 2 + x**2) / 1.5**2)
    assert np.abs(share - expected).max() < 0.04  # measured 0.024
    np.testing.assert_array_equal(picture(plane, slab, casts=[True, False]), lit)
    np.testing.assert_array_equal(picture(plane, slab, use_shadows=False), lit)
