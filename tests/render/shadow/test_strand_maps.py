"""Strands in depth maps of lights: how much light they keep, and that they do not shade themselves."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

COMBINED = frozenset({"combined"})
KEPT = "those of an earlier picture still hold"
DOWN = np.array([0.0, 0.0, -1.0])
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright
SUN = Light("SUN", np.full(3, 3.0), np.zeros(3), DOWN)
ABOVE = Light("POINT", np.full(3, 300.0), np.array([0.0, 0.0, 6.0]), DOWN)
WIDE_SUN, WIDE = replace(SUN, radius=0.1), replace(ABOVE, radius=0.5)
LIGHTS = {"sun": SUN, "lamp": ABOVE, "wide sun": WIDE_SUN, "wide lamp": WIDE}
BLACK = World(np.zeros(3))
APART = 0.1  # of the strands of a grid


def grid(width: float, height: float = 1.0) -> Geometry:
    """Parallel strands of so much width over the floor, beyond what is seen."""
    x = np.arange(-2, 2, APART) + 0.031
    lines = [np.array([[one, y, height] for y in np.linspace(-2, 2, 9)]) for one in x]
    return build.strand_lines(f"grid {width}", lines, width / 2)


def lit(light: Light, *things: tuple[Geometry, np.ndarray], shadows: bool = True) -> tuple[np.ndarray, dict]:
    """(H, W) radiance of what a camera under the strands sees of the floor, or from above of strands; the report."""
    eye = cameras.camera((0, -1.2, 0.6), target=(0, 0, 0), resolution=(96, 72), near=0.05)
    case = Case(build.scene(*things, lights=[light], world=BLACK), eye, Settings())
    result = render(replace(case, settings=replace(case.settings, use_shadows=shadows)), COMBINED, 16)
    return result.pixels["combined"][..., 0].astype(float), result.report


def cast_by(report: dict) -> set[str]:
    kept = {entry["name"] for entry in report["skipped"] if entry["because"] == KEPT}
    return {"shadows", "shadow maps"} & ({entry["name"] for entry in report["passes"]} | kept)


def floor() -> tuple[Geometry, np.ndarray]:
    return build.mesh(meshes.plane_mesh("floor", 6.0), "POLYGONS"), LAID


@pytest.mark.parametrize("light", LIGHTS.values(), ids=LIGHTS)
@pytest.mark.parametrize("width", [0.0002, 0.001, 0.004, 0.02])
def test_strands_keep_as_much_light_as_they_are_wide(width, light):
    """From a tenth of a texel to ten; a lamp sees strands wider, and as much farther apart."""
    thing = grid(width), np.eye(4)
    found, report = lit(light, floor(), thing)
    without, _ = lit(light, floor(), thing, shadows=False)
    assert cast_by(report) == {"shadow maps"}
    kept = 1 - found.sum() / without.sum()
    assert abs(kept * APART / width - 1) < WORST, f"{kept:.5f}"


# Measured: 0.063, 0.053, 0.058 and 0.021 under the sun, since the picture shows no whole number of gaps; lamp 0.009;
# the wide sun 0.046, 0.006, 0.014 and 0.053, the wide lamp 0.037.
WORST = 0.08


# Measured: 0; 0, 6e-4 and 1.3e-3 where the sun is aslant, and a ray leaves a tube beyond the end of a segment.
# The same under a wide sun: 0; 0, 2.8e-3 and 7.8e-5.
@pytest.mark.parametrize(
    ("direction", "radius", "most"),
    [
        ((0.0, 0.0, -1.0), 0.0, 1e-3),
        ((0.6, 0.3, -0.74), 0.0, 2e-3),
        ((0.0, 0.0, -1.0), 0.1, 1e-3),
        ((0.6, 0.3, -0.74), 0.1, 4e-3),
    ],
)
def test_strands_do_not_shade_themselves(direction, radius, most):
    """One strand alone, in all directions of an arc, from a twentieth of a pixel to two."""
    turn, sun = (
        np.linspace(0, np.pi, 33),
        replace(SUN, direction=np.array(direction) / np.linalg.norm(direction), radius=radius),
    )
    for width in (0.0005, 0.005, 0.02):
        arc = build.strand_lines(f"arc {width}", [0.5 * np.stack([np.cos(turn), 0 * turn, np.sin(turn)], 1)], width / 2)
        # Something must lie behind it, or it casts nothing; that is out of the picture.
        away = build.mesh(meshes.plane_mesh("away", 0.1), "POLYGONS"), build.moved((0, 0, -3)) @ LAID
        shaded, report = lit(sun, (arc, np.eye(4)), away)
        without, _ = lit(sun, (arc, np.eye(4)), away, shadows=False)
        assert cast_by(report) == {"shadow maps"}
        assert abs(shaded.sum() / without.sum() - 1) < most, f"{width}: {shaded.sum() / without.sum() - 1:.1e}"


def test_ropes_cast_into_tables():
    rope = build.strand_lines("rope", [np.array([[-1.0, 0, 1], [1.0, 0, 1]])], 0.1)
    for light in (SUN, WIDE_SUN):
        assert cast_by(lit(light, floor(), (rope, np.eye(4)))[1]) == {"shadows"}
