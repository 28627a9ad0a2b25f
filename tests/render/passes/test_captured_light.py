"""Captured splats that light changes: relit, and with the shadows of what was added."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import captured, moved
from scripts.scenes.cameras import camera
from scripts.scenes.captured_cases import one_splat, random_splats
from tests.reference.captured import linear_from_display

EYE = camera((0, -6, 0), resolution=(24, 20), field_of_view=10)
COLOR = (0.7, 0.4, 0.9)  # display
LINEAR = linear_from_display(np.array(COLOR))
TOWARDS = np.array([0.3, 1.0, -0.4])  # of the sun, onto what faces the eye
COSINE = TOWARDS[1] / np.linalg.norm(TOWARDS)
SUN = build.sun(2.0, TOWARDS)
DISK = one_splat((0, 0, 0), (0.1, 0.001, 0.1), 1.0, COLOR)  # faces the eye
NOWHERE = np.eye(4)


def lit(key, splats, lighting, matrix=NOWHERE):
    return replace(captured(f"{key} {lighting}", splats), lighting=lighting), matrix


def picture(*things, eye=EYE, lights=(SUN,), world=0.0, samples=1, **settings):
    made = build.scene(*things, lights=lights, world=World(np.full(3, world)), transparent=True)
    request = Request(eye, Settings(**settings), frozenset({"combined"}), samples)
    return drawing.opengl().render(made, request).pixels["combined"].astype(np.float64)


def middle(found: np.ndarray) -> np.ndarray:
    """(3,) light of what is opaque in the middle of a picture."""
    return found[10, 12, :3] / found[10, 12, 3]


HIGH = build.sun(2.0, (0.9, 0.5, -0.6))  # whose shadow falls from beside the view


def beside(distance=3.0):
    return build.mesh(meshes.cube_mesh("beside captured", 1.0), "POLYGONS"), moved(-distance * HIGH.direction)


@pytest.mark.parametrize("world", [0.0, 0.25])
def test_relit_splats_are_white_paint_in_captured_colours(world):
    """Lambert: colour times (E cos / pi + L). The disk does not shadow itself."""
    found = middle(picture(lit("paint", DISK, "RELIT"), world=world))
    np.testing.assert_allclose(found, LINEAR * (2.0 * COSINE / np.pi + world), rtol=1e-5)  # measured 4e-7


def test_relit_splats_follow_the_transform_of_their_object():
    """Of a disk that is turned and scaled unevenly, the cofactors turn the normal."""
    matrix = np.array([[0.5, 0, 0, 0], [0.6, 0.8, 0, 0], [0, 0, 2.0, 0], [0, 0, 0, 1.0]])
    normal = np.linalg.inv(matrix[:3, :3]).T @ [0, -1.0, 0]
    normal /= np.linalg.norm(normal)
    cosine = -normal @ SUN.direction
    found = middle(picture(lit("turned", DISK, "RELIT", matrix)))
    np.testing.assert_allclose(found, LINEAR * 2.0 * cosine / np.pi, rtol=1e-5)  # measured 5e-7


def test_relit_splats_have_all_shadows():
    in_sun = middle(picture(lit("lit", DISK, "RELIT"), lights=(HIGH,)))
    assert in_sun.min() > 0.03
    found = middle(picture(lit("lit", DISK, "RELIT"), beside(), lights=(HIGH,)))
    np.testing.assert_allclose(found, 0, atol=1e-4)
    other = captured("another", one_splat(tuple(-6 * HIGH.direction), 1.0, 0.6)), NOWHERE
    found = middle(picture(lit("lit", DISK, "RELIT"), other, lights=(HIGH,)))
    np.testing.assert_allclose(found, 0.4 * in_sun, rtol=0.06)  # measured 0.043


@pytest.mark.parametrize("world", [0.0, 0.25])
def test_shadow_receivers_have_the_share_of_light_that_others_leave(world):
    open_air = middle(picture(lit("receiver", DISK, "SHADOWED"), world=world, lights=(HIGH,)))
    np.testing.assert_allclose(open_air, LINEAR, rtol=1e-3)
    found = middle(picture(lit("receiver", DISK, "SHADOWED"), beside(), world=world, lights=(HIGH,)))
    lamp = 2.0 * HIGH.direction[1] / np.pi
    np.testing.assert_allclose(found, LINEAR * world / (lamp + world), rtol=2e-3, atol=1e-4)


def test_shadow_receivers_have_no_shadow_of_their_own():
    """But that of another capture."""
    two = one_splat(tuple(-6 * HIGH.direction), 1.0, 0.6)
    names = ("position", "scale", "rotation", "base", "opacity")
    both = replace(DISK, **{name: np.concatenate([getattr(DISK, name), getattr(two, name)]) for name in names})
    np.testing.assert_allclose(middle(picture(lit("both", both, "SHADOWED"), lights=(HIGH,))), LINEAR, rtol=1e-3)
    other = captured("another one", two), NOWHERE
    found = middle(picture(lit("receiver", DISK, "SHADOWED"), other, lights=(HIGH,)))
    np.testing.assert_allclose(found, 0.4 * LINEAR, rtol=0.06)  # measured 0.019


@pytest.mark.parametrize("settings", [{"use_shadows": False}, {}])
def test_without_lamps_or_shadows_receivers_are_as_captured(settings):
    splats, eye = random_splats(300), camera((0, -6, 0), resolution=(48, 36), field_of_view=50)
    lights = (SUN,) if settings else ()
    given = [(replace(captured(f"as {one}", splats), lighting=one), NOWHERE) for one in ("CAPTURED", "SHADOWED")]
    found = [picture(one, eye=eye, lights=lights, **settings) for one in given]
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_a_new_lamp_changes_the_same_view():
    """No picture of before is shown."""
    first, second = (middle(picture(lit("again", DISK, "RELIT"), lights=(build.sun(e, TOWARDS),))) for e in (1.0, 2.0))
    np.testing.assert_allclose(second, 2 * first, rtol=1e-4)


def test_half_of_a_sun_with_a_size_leaves_half_its_light():
    """Behind a straight edge in the middle of it."""
    across = np.cross(HIGH.direction, (0, 1.0, 0))  # so that both halves are as steep
    across /= np.linalg.norm(across)
    turned = np.eye(4)
    turned[:3, :3] = np.column_stack([across, HIGH.direction, np.cross(across, HIGH.direction)])
    turned[:3, 3] = -8 * HIGH.direction + 4 * across
    edge = build.mesh(meshes.plane_mesh("edge over captured", 4.0), "POLYGONS"), turned
    found = middle(picture(lit("soft", DISK, "SHADOWED"), edge, lights=(replace(HIGH, radius=0.2),), samples=16))
    np.testing.assert_allclose(found, 0.5 * LINEAR, rtol=0.01)  # measured 0.0011
