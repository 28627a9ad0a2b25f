"""Balls around the eye, some of them cut by the plane through it across the view, against rays in float64."""

from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.settings import Settings
from scripts.scenes import build, cameras
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl, render

SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
COMBINED = frozenset({"combined"})
SIDE = 96  # pixels
AROUND = 2  # pixels that the filter reaches to
RATIO = np.array([1.0, 1.0, 3.0])  # of the instance's scale along its axes, where balls are ellipsoids
WIDE = 150.0  # degrees
EYE = cameras.camera((0, 0, 0), (0, 1, 0), (SIDE, SIDE), field_of_view=WIDE, near=1e-3, far=10)


def around(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres (N, 3) and radii (N,) of balls on all sides, none of which, drawn out by RATIO, holds the eye."""
    rng = np.random.default_rng(seed)
    at = rng.uniform(-1, 1, (60, 3))
    radius = rng.uniform(0.05, 0.3, 60)
    out = np.linalg.norm(at, axis=1) > 1.2 * radius
    return at[out], radius[out]


def met(at: np.ndarray, radius: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """(SIDE, SIDE) bool, bottom row first: whether the ray through a pixel's centre meets an ellipsoid."""
    slope = np.tan(np.radians(WIDE / 2)) * ((np.arange(SIDE) + 0.5) / SIDE * 2 - 1)
    x, z = np.meshgrid(slope, slope)
    ray = np.stack([x, np.ones_like(x), z], axis=-1).reshape(-1, 1, 3) / ratio
    along, across = (ray * at).sum(axis=-1), (ray**2).sum(axis=-1)
    inside = along**2 - across * ((at**2).sum(axis=1) - radius**2)
    with np.errstate(invalid="ignore"):
        farthest = (along + np.sqrt(inside)) / across
    return ((inside >= 0) & (farthest > 0)).any(axis=1).reshape(SIDE, SIDE)


@pytest.mark.parametrize("ratio", [np.ones(3), RATIO], ids=["round", "drawn out"])
@pytest.mark.parametrize("seed", range(4))
def test_balls_beside_the_eye_are_where_rays_meet_them(seed, ratio):
    at, radius = around(seed)
    cloud = PointCloud(at.astype(np.float32), radii=radius[:, None].astype(np.float32))
    scene = build.scene(
        (build.points(f"near {seed}", cloud), np.diag([*ratio, 1.0])), lights=[build.sun()], transparent=True
    )
    alpha = render(Case(scene, EYE, SETTINGS), COMBINED, 16).pixels["combined"][..., 3]
    hit = met(at, radius, ratio)
    whole, none = np.ones_like(hit), np.ones_like(hit)
    for i, j in np.ndindex(2 * AROUND + 1, 2 * AROUND + 1):
        moved = np.roll(hit, (i - AROUND, j - AROUND), axis=(0, 1))
        whole &= moved
        none &= ~moved
    for rim in (whole, none):
        rim[[*range(AROUND), *range(-AROUND, 0)]] = rim[:, [*range(AROUND), *range(-AROUND, 0)]] = False
    assert whole.sum() > 500
    assert none.sum() > 500
    # Rays between pixels' centres may pass a notch, or meet a tip.
    assert np.mean(alpha[whole] < 0.999) < 0.01  # measured 0.0037
    assert np.mean(alpha[none] > 0.001) < 0.01  # measured 0


@pytest.mark.parametrize("ratio", [np.ones(3), RATIO], ids=["round", "drawn out"])
def test_balls_beside_the_picture_cost_no_fragments(ratio, monkeypatch):
    """The plane through the eye cuts them all, and none is in the picture."""
    at = np.array(
        [[x, 0.004 * i, z] for i in range(-5, 6) for x, z in ((-0.9, 0.1), (0.9, -0.3), (0.2, 0.8), (-0.4, -0.7))]
    )
    cloud = PointCloud(at.astype(np.float32), radii=np.full((len(at), 1), 0.05, np.float32))
    scene = build.scene((build.points(f"beside {ratio}", cloud), np.diag([*ratio, 1.0])), lights=[build.sun()])
    device, drawn = opengl().device, []
    draw = device.draw

    def watched(interface, *given, **more):
        drawn.append(Path(interface.vertex or "").name)
        return draw(interface, *given, **more)

    monkeypatch.setattr(device, "draw", watched)
    _ = render(Case(scene, EYE, SETTINGS), COMBINED, 16)
    assert drawn
    assert "splat.vert" not in drawn
