"""Penumbrae in fog, whose voxels look at few points of a wide light each, against the closed form."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.plan.request import Request
from scripts.scenes import build, drawing, meshes
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from tests.support.transmittance import voxels

RADIUS, HEIGHT, CARD = 0.15, 1.5, 6.0  # of the sun, radians; of a card above the middle of the fog; half its side
SUN = Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([0.0, 0.0, -1.0]), radius=RADIUS)
WIDE, HIGH = 96, 24
EYE = camera((0, -30, 0), resolution=(WIDE, HIGH), parallel=1.2)


def card_mesh() -> Mesh:
    corners = CARD * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    return meshes.flat_mesh("card above a fog", corners, np.array([[0, 1, 2], [0, 2, 3]]))


def picture(alpha: float, card: bool) -> np.ndarray:
    """Returns (H, W), a slab of thin fog below a card that hides the sun on the left, or without the card."""
    table = build.materials(2, alpha=[1.0, alpha], translucent=np.array([False, alpha < 1]))
    fog = points("fog in a penumbra", voxels(1.6, 0.4, 16, 0.05, color=0.8)), np.eye(4)
    hiding = build.mesh(replace(card_mesh(), materials=(1,)), "POLYGONS"), moved((-CARD, 0, HEIGHT))
    scene = build.scene(fog, *([hiding] if card else []), lights=[SUN], table=table, world=World(), transparent=True)
    request = Request(EYE, Settings(technique="VISIBILITY", adaptive_threshold=0.0), frozenset({"combined"}), 16)
    return drawing.opengl().render(scene, request).pixels["combined"][..., 0].astype(np.float64)


def lit_share() -> np.ndarray:
    """(H, W): the share of the sun's disk that an edge leaves to the middle of each pixel."""
    step = 1.2 / WIDE
    x, z = ((np.arange(n) - n / 2 + 0.5) * step for n in (WIDE, HIGH))
    u = np.clip(x / (np.tan(RADIUS) * (HEIGHT - z[:, None])), -1, 1)
    return 0.5 + (u * np.sqrt(1 - u * u) + np.arcsin(u)) / np.pi


# Of a card that is opaque, and casts into maps, and of one that light passes through, which casts into tables: these
# left 0.039 and 0.14 where every voxel looked at the same points.
@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_a_fog_has_what_the_card_leaves_of_the_sun(alpha: float) -> None:
    lit, alone = (picture(alpha, card) for card in (True, False))
    error = lit / alone - (1 - alpha * (1 - lit_share()))
    assert np.sqrt((error**2).mean()) < 0.006  # measured 0.0049 and 0.0051
    assert np.abs(error).max() < 0.03  # measured 0.026 and 0.025
