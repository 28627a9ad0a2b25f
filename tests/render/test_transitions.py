"""A camera that dollies steadily sees no pop: levels, spacings and kinds of primitive change without being noticed."""

import numpy as np
import pytest

from pointsplat_addon.core.scene import Camera, Mesh, Scene, Settings, World
from pointsplat_addon.render.prepare import STORE
from scripts.transitions import changes
from tests.render import scenes
from tests.render.test_quality import shape, with_smooth_normals


def bumpy(key: str, rings: int) -> Mesh:
    """A ball with bumps, whose triangles are as many as `rings` make them."""
    ball = scenes.sphere_mesh(key, rings)
    p = ball.position.astype(np.float64)
    p *= 1 + 0.06 * np.sin(7 * p[:, :1]) * np.sin(7 * p[:, 1:2]) * np.sin(7 * p[:, 2:])
    return with_smooth_normals(key, p, ball.triangles.astype(int))


SHAPES = {
    "torus": lambda: shape("torus"),
    "spot": lambda: shape("spot"),
    "ball": lambda: bumpy("dense bumpy ball", 360),
}


def dolly(
    name: str, start: float, stop: float, step: float, size: int = 512, primitive: str = "AUTO"
) -> tuple[Scene, list[Camera]]:
    """A shape under a sun and a grey world, and cameras from the distance `start` to `stop`, a share `step` each."""
    direction = np.array([0.5, -0.8, 0.35])
    direction /= np.linalg.norm(direction)
    count = 1 + int(np.ceil(np.log(start / stop) / -np.log1p(-step)))
    cameras = [
        scenes.camera(direction * start * (1 - step) ** i, resolution=(size, size), field_of_view=35)
        for i in range(count)
    ]
    light = scenes.sun(2.5, cameras[0].view_from_world[:3, :3].T @ (0.45, -0.5, -1.0))
    table = scenes.materials(base_color=[[0.55, 0.42, 0.30]])
    scene = scenes.scene(
        (scenes.mesh(SHAPES[name](), primitive), scenes.moved()),
        lights=[light], world=World(np.full(3, 0.35)), table=table,
    )  # fmt: skip
    return scene, cameras


@pytest.mark.parametrize(
    ("name", "start", "primitive", "seen"),
    [
        ("torus", 14.3, "POINTS", 2),  # an octave of spacing
        ("ball", 6.55, "AUTO", 2),  # points, then triangles
    ],
)
def test_a_steady_dolly_shows_no_pop(name, start, primitive, seen):
    STORE.clear()
    scene, cameras = dolly(name, start, start * 0.9, 0.02, 512, primitive)
    found = changes(scenes.opengl(), scene, cameras, Settings(use_shadows=False), 16)
    assert len({c.drawn for c in found}) >= seen
    for change in found:
        assert change.whole <= 2  # of 255; measured 0.16
        # Silhouettes of polygons with 17 instead of 16 samples differ by up to 2.0 here.
        assert change.excess <= 4  # measured 3.9
