"""The pass Depth of captured splats: where half of the light is hidden; and what other passes hold of them."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.passes.outputs import BACKGROUND_DEPTH
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, clouds, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import SHEARED, one_splat, random_splats
from tests.reference import captured as reference

SIZE = (48, 40)
EYE = camera((0, -6, 0), resolution=SIZE, field_of_view=50)


def pixels(*things, eye=EYE, passes=("depth",), samples=1):
    made = build.scene(*things, lights=(), world=World(), transparent=True)
    request = Request(eye, Settings(use_shadows=False), frozenset({"combined", *passes}), samples)
    return drawing.opengl().render(made, request).pixels


def expected(things, eye):
    """(H, W) in float64: the planes' depths of the splats, by centres from the front, with which half is hidden."""
    first, *others = (reference.project(splats, matrix, eye) for splats, matrix in things)
    seen = first
    for other in others:
        seen = seen + other
    order = np.argsort(seen.depth, kind="stable")
    y, x = np.mgrid[: SIZE[1], : SIZE[0]] + 0.5
    through, found = np.ones(x.shape), np.full(x.shape, BACKGROUND_DEPTH)
    for k in order:
        v = np.stack([x - seen.centre[k, 0], y - seen.centre[k, 1]])
        alpha = seen.opacity[k] * np.exp(-0.5 * np.einsum("iyx,ij,jyx->yx", v, seen.conic[k], v))
        before = through.copy()
        through *= 1 - np.where(alpha >= 1 / 255, np.minimum(alpha, 0.99), 0)
        halves = (before > 0.5) & (through <= 0.5)
        found[halves] = seen.depth[k] + np.einsum("i,iyx->yx", seen.slope[k], v)[halves]
    return found


@pytest.mark.parametrize(
    "eye", [EYE, camera((1, -6, 2), resolution=SIZE, parallel=4.0)], ids=["perspective", "parallel"]
)
def test_depth_is_where_half_of_the_light_is_hidden(eye):
    things = [(random_splats(400, 0, size=0.1), SHEARED), (random_splats(400, 0, size=0.1, seed=1), moved())]
    given = [(captured(f"depth {i}", splats), matrix) for i, (splats, matrix) in enumerate(things)]
    found = pixels(*given, eye=eye)["depth"][..., 0]
    wanted = expected(things, eye)
    assert 0.2 < (wanted < BACKGROUND_DEPTH).mean() < 0.99
    agree = np.isclose(found, wanted, rtol=1e-5, atol=1e-4)
    assert agree.mean() > 0.997  # measured 1; where not, rounding decided which splat it is


@pytest.mark.parametrize(("opacity", "depth"), [(0.3, 6.0), (0.6, 5.0), (0.49, 6.0), (0.2, BACKGROUND_DEPTH)])
def test_of_three_disks_the_one_that_makes_it_a_half(opacity, depth):
    """0.7 of the light is left by one, 0.49 by two: the second of three; of 0.6 the first."""
    layers = [
        (captured(f"layer {y} {opacity}", one_splat((0, y, 0), (2, 0.01, 2), opacity)), moved()) for y in (-1, 0, 1)
    ]
    assert pixels(*layers)["depth"][20, 24, 0] == pytest.approx(depth, abs=1e-3)


def test_opaque_things_before_it_count():
    """And smoke does not."""
    disk = captured("depth disk", one_splat((0, 0, 0), (2, 0.01, 2), 0.9)), moved()
    for y, depth in ((-2, 4.0), (2, 6.0)):
        quad = build.mesh(meshes.plane_mesh("quad by depth", 3.0), "POLYGONS"), moved((0, y, 0))
        for samples in (1, 16):
            assert pixels(disk, quad, samples=samples)["depth"][20, 24, 0] == pytest.approx(depth, abs=1e-3)
    smoke = build.points("smoke by depth", clouds.smoke_cloud(6, 5.0)), moved((0, -2, 0))
    assert pixels(disk, smoke)["depth"][20, 24, 0] == pytest.approx(6.0, abs=1e-3)


def test_what_hides_less_than_half_has_none():
    found = pixels((captured("faint", one_splat((0, 0, 0), 0.5, 0.4)), moved()))
    np.testing.assert_array_equal(found["depth"], BACKGROUND_DEPTH)


def test_other_passes_have_what_is_opaque_alone():
    names = ("normal", "position", "object_index", "material_index", "crypto_object", "mist")
    splats = captured("other passes", random_splats(300, 0, size=0.1)), moved()
    cube = build.mesh(meshes.cube_mesh("cube among passes", 0.5), "POLYGONS"), moved()
    found, alone = pixels(cube, splats, passes=names), pixels(cube, passes=names)
    assert set(found) == set(alone)
    for name in found.keys() - {"combined"}:
        np.testing.assert_array_equal(found[name], alone[name])
    assert np.abs(found["combined"] - alone["combined"]).max() > 0.1


def test_pictures_do_not_change_with_the_pass():
    splats = captured("with depth", random_splats(300, 3, size=0.1)), moved()
    np.testing.assert_array_equal(pixels(splats)["combined"], pixels(splats, passes=())["combined"])
