"""A sphere of which one half is points and the other triangles looks like one of triangles alone."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.common.images import eroded
from scripts.scenes import build, cameras, drawing, meshes
from scripts.scenes.case import Case
from scripts.scenes.changes import levels

SETTINGS = Settings(technique="IMAGE_SPACE", use_shadows=False, use_adaptive_sampling=False)
SIZE = 128


def halves() -> tuple[Mesh, Mesh, Mesh]:
    """All of a sphere, what of it lies left of a slanted plane, and the rest."""
    whole = meshes.sphere_mesh("seam", 64)
    middle = whole.position[whole.triangles].astype(float).mean(axis=1)
    left = middle @ (1.0, 0.0, 0.4) < 0.0

    def part(name: str, chosen: np.ndarray) -> Mesh:
        return replace(whole, key=f"seam {name}", triangles=whole.triangles[chosen])

    return part("whole", left | True), part("left", left), part("right", ~left)


def picture(samples: int, *parts: tuple[Mesh, str], technique: str = "IMAGE_SPACE") -> tuple[np.ndarray, np.ndarray]:
    camera = cameras.camera((0, -3.2, 0), resolution=(SIZE, SIZE))
    held = [(build.mesh(mesh, primitive), build.moved()) for mesh, primitive in parts]
    light = build.sun(2.5, (0.4, 0.7, -0.5))
    scene = build.scene(*held, lights=[light], world=World(np.full(3, 0.35)), transparent=True)
    case = Case(scene, camera, replace(SETTINGS, technique=technique))
    pixels = drawing.render(case, frozenset({"combined", "object_index"}), samples).pixels
    return np.dstack([levels(pixels["combined"]), 255 * pixels["combined"][..., 3:]]), pixels["object_index"][..., 0]


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "EWA"])
@pytest.mark.parametrize("samples", [1, 16])
def test_no_pixel_on_the_seam_differs(samples, technique):
    whole, left, right = halves()
    truth, _ = picture(samples, (whole, "POLYGONS"), technique=technique)
    mixed, index = picture(samples, (left, "POINTS"), (right, "POLYGONS"), technique=technique)
    # Silhouettes of points are another matter: tests/blender/test_silhouettes_cycles.py.
    inside = eroded(eroded(truth[..., 3] >= 254))
    assert min(np.count_nonzero(inside & (index == k)) for k in (1, 2)) > 1000
    difference = np.abs(mixed - truth).max(axis=2)
    near = np.zeros_like(inside)
    for shift in (-2, -1, 1, 2):
        for axis in (0, 1):
            near |= np.roll(index, shift, axis) != index
    assert np.count_nonzero(near & inside) > 300
    assert difference[inside].max() <= 4  # measured 0.85
