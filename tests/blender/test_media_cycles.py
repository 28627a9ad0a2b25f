"""Translucency against Cycles, ray marching and closed forms: small pictures of scripts/studies/media.py's scenes."""

import itertools
import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")


from scripts.studies import media

pytestmark = pytest.mark.usefixtures("empty_file")


# ---------------------------------------------------------------------------- the reference itself


@pytest.mark.parametrize(("smoke", "where"), [("tinted", "outside"), ("absorbing", "inside"), ("forward", "outside")])
def test_ray_marching_is_cycles(tmp_path, smoke, where):
    """Blender 4.5 marches in steps of a voxel and is biased; 5.2 is not."""
    scene = media.sphere_scene(tmp_path, smoke, where, 32, 64)
    cycles = media.draw(scene, tmp_path, "CYCLES", 64)
    _, mean = media.difference(cycles, media.sphere_truth(scene, smoke, 2))
    assert abs(mean) < 0.05  # measured 0.0197 (4.5), 0.0126 (5.2)


# ---------------------------------------------------------------------------- PointSplat

# The ball's rim is as sharp as its voxels: the RMSE halves with their size.
BALLS = {
    ("absorbing", "outside"): 0.03,  # measured 0.0209
    ("tinted", "inside"): 0.01,  # measured 0.0034
    ("scattering", "inside"): 0.02,  # measured 0.0091
    ("forward", "outside"): 0.03,  # measured 0.0156
}


@pytest.mark.parametrize(("smoke", "where"), list(BALLS))
def test_a_ball_of_smoke(tmp_path, smoke, where):
    scene = media.sphere_scene(tmp_path, smoke, where, 32, 64)
    pixels, truth = media.draw(scene, tmp_path, "POINTSPLAT", 4), media.sphere_truth(scene, smoke, 2)
    kept = media.beside_lamp(scene, 0.0 if media.SMOKES[smoke][-1] else 0.1)
    rmse, mean = media.difference(pixels, truth, kept)
    assert rmse < BALLS[smoke, where]
    assert abs(mean) < 0.05  # measured 0.043, of the scattering ball: the lamp's own pixels


@pytest.mark.parametrize("depth", [0.1, 1.0, 5.0])
@pytest.mark.parametrize("angle", [0.0, 50.0])
def test_a_slab_lets_through_what_beers_law_says(tmp_path, depth, angle):
    scene = media.slab_scene(tmp_path, 8, depth, 32)
    media.sky(scene, 1.0)
    media.look(scene.camera, media.tilted(angle, 4.0), (0, 0, 0.5))
    seen = media.middle(media.draw(scene, tmp_path, "POINTSPLAT", 4))
    assert abs(media.transmittance_error(seen, depth / math.cos(math.radians(angle)))) < 0.005  # measured 0.0024


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_planes_in_any_order_are_over(tmp_path, order):
    scene = media.planes_scene(order, 30.0, 32)
    seen = media.middle(media.draw(scene, tmp_path, "POINTSPLAT", 4))
    truth = np.zeros(3)
    for which in reversed(order):
        color, alpha = media.PLANES[which]
        truth = alpha * np.array(color) + (1 - alpha) * truth
    np.testing.assert_allclose(seen, truth, atol=1 / 255)  # measured 4.4e-5
