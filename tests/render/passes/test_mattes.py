"""Mattes: meshes that stand for captured surfaces hide what is behind them, are not seen, and catch shadows."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import one_splat
from tests.reference.captured import linear_from_display

EYE = camera((0, -6, 0), resolution=(24, 20), field_of_view=10)
SUN = build.sun(2.0, (0.9, 0.5, -0.6))
LAMP = 2.0 * SUN.direction[1] / np.pi  # radiance of white paint that faces the eye
COLOR = (0.7, 0.4, 0.9)
LINEAR = linear_from_display(np.array(COLOR))
WORLD = 0.25
MATTE = build.mesh(meshes.plane_mesh("matte", 2.0), "POLYGONS"), moved()
CASTER = build.mesh(meshes.cube_mesh("over a matte", 1.0), "POLYGONS"), moved(-3 * SUN.direction)
BEHIND = build.mesh(meshes.cube_mesh("behind a matte", 0.3), "POLYGONS"), moved((0, 2, 0))
IN_FRONT = build.mesh(meshes.cube_mesh("before a matte", 0.1), "POLYGONS"), moved((-0.2, -2, 0))
FLAT = captured("on a matte", one_splat((0, 0, 0), (0.3, 0.003, 0.3), 1.0, COLOR)), moved()
LIT_BY_BOTH = WORLD / (LAMP + WORLD)


def rendered(*things, mattes=(), passes=("combined",), samples=16, transparent=False, lights=(SUN,), **settings):
    made = build.scene(*things, lights=lights, world=World(np.full(3, WORLD)), transparent=transparent)
    if mattes:
        matte = np.array([any(thing is one for one in mattes) for thing in things])
        made = replace(made, instances=replace(made.instances, matte=matte))
    return drawing.opengl().render(made, Request(EYE, Settings(**settings), frozenset(passes), samples))


def picture(*things, **more) -> np.ndarray:
    return rendered(*things, **more).pixels["combined"].astype(np.float64)


@pytest.mark.parametrize("transparent", [False, True])
def test_a_matte_is_not_seen(transparent):
    """Neither alone nor by what stands before it."""
    for others in ((), (IN_FRONT,), (IN_FRONT, FLAT)):
        found = picture(MATTE, *others, mattes=(MATTE,), transparent=transparent, lights=())
        expected = picture(*others, transparent=transparent, lights=())
        np.testing.assert_allclose(found, expected, atol=2e-6)  # measured 2.4e-7


def test_it_hides_what_is_behind_it():
    without = picture(MATTE, FLAT, mattes=(MATTE,), lights=())
    found = picture(MATTE, FLAT, BEHIND, mattes=(MATTE,), lights=())
    np.testing.assert_array_equal(found, without)
    assert np.abs(picture(FLAT, BEHIND, lights=()) - without).max() > 0.01


def test_shadows_fall_on_it():
    """On the world that shows through it, as dark as white paint would be; a transparent film holds the shadow."""
    found = picture(MATTE, CASTER, mattes=(MATTE,))
    np.testing.assert_allclose(found[10, 12], [*[WORLD * LIT_BY_BOTH] * 3, 1], atol=1e-4)
    found = picture(MATTE, CASTER, mattes=(MATTE,), transparent=True)
    np.testing.assert_allclose(found[10, 12], [0, 0, 0, 1 - LIT_BY_BOTH], atol=1e-4)
    np.testing.assert_allclose(picture(MATTE, mattes=(MATTE,))[10, 12], [*[WORLD] * 3, 1], atol=1e-4)


def test_and_on_captured_splats_at_its_place():
    found = picture(MATTE, CASTER, FLAT, mattes=(MATTE,))[10, 12]
    np.testing.assert_allclose(found[:3], LINEAR * LIT_BY_BOTH, rtol=0.02)  # measured 0.011: 0.99 is the most alpha
    found = picture(MATTE, FLAT, mattes=(MATTE,))[10, 12]
    np.testing.assert_allclose(found[:3], LINEAR, rtol=0.02)


@pytest.mark.parametrize(
    ("before", "share"), [(-0.2, LIT_BY_BOTH), (0.2, LIT_BY_BOTH), (-2.0, 1.0), (2.0, LIT_BY_BOTH)]
)
def test_but_not_on_those_that_lie_before_it_by_more_than_their_size(before, share):
    """A matte hides no captured splats either."""
    splat = captured(f"before {before}", one_splat((0, before, 0), (0.3, 0.003, 0.3), 1.0, COLOR)), moved()
    found = picture(MATTE, CASTER, splat, mattes=(MATTE,))[10, 12]
    np.testing.assert_allclose(found[:3], LINEAR * share, rtol=0.02)


def test_captures_and_mattes_cast_none_on_it():
    other = captured("over the matte", one_splat(tuple(-6 * SUN.direction), 1.0, 0.9)), moved()
    second = build.mesh(meshes.cube_mesh("second matte", 1.0), "POLYGONS"), moved(-3 * SUN.direction)
    found = picture(MATTE, FLAT, other, second, mattes=(MATTE, second))
    np.testing.assert_allclose(found, picture(FLAT, other), atol=5e-3)


def test_other_passes_do_not_show_it():
    """The instance before it has the number 2 there and 1 alone, and other hashes."""
    names = ("depth", "normal", "position", "object_index", "crypto_object")
    found, seen = (rendered(MATTE, IN_FRONT, mattes=one, passes=names).pixels for one in ((MATTE,), ()))
    alone = rendered(IN_FRONT, passes=names).pixels
    for name in names[:3]:
        assert np.abs(seen[name] - alone[name]).max() > 0.1
        np.testing.assert_allclose(found[name], alone[name], rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(found["object_index"], 2 * alone["object_index"])
    coverage = [pixels["crypto_object00"][..., 1::2].sum(axis=-1) for pixels in (found, alone, seen)]
    np.testing.assert_allclose(coverage[0], coverage[1], atol=1e-6)
    assert coverage[2].min() > 0.999


@pytest.mark.parametrize("technique", ["EWA", "IMAGE_SPACE", "PAINTER"])
def test_other_techniques_leave_it_out_and_say_so(technique):
    found = rendered(MATTE, IN_FRONT, mattes=(MATTE,), technique=technique)
    assert any("Shadow catchers are left out" in warning for warning in found.report["warnings"])
    np.testing.assert_array_equal(found.pixels["combined"], picture(IN_FRONT, technique=technique))
