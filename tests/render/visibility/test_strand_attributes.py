"""What strands in the visibility buffer are: tubes, attributes, light, holdouts and identities, against the G-buffer of
many samples."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.lattice import MANY
from pointsplat_addon.core.scene.settings import Settings
from scripts.scenes import build, cameras
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES
from scripts.scenes.drawing import render

SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)


def by(technique: str, case: Case) -> Case:
    return replace(case, settings=replace(case.settings, technique=technique))


def tubes(key: str, radius: float = 0.12, **more) -> Case:
    u = np.linspace(-1, 1, 7)
    bows = [np.stack([1.1 * u, np.cos(3 * u) + y, 0.7 * np.sin(2 * u) + z], axis=1) for y, z in ((0, 0), (0.4, 0.5))]
    color = np.tile(np.linspace([0.9, 0.1, 0.1], [0.1, 0.2, 0.9], 7), (2, 1)).astype(np.float32)
    lines = build.strand_lines(key, bows, np.tile(np.geomspace(radius, 0.3 * radius, 7), 2), color=color, **more)
    eye = cameras.camera((1, -5, 1), resolution=(96, 80))
    return Case(build.scene((lines, build.moved()), transparent=True), eye, SETTINGS)


@pytest.mark.parametrize("radius", [0.25, 0.12])
def test_wide_tubes_are_under_the_same_centres_as_in_the_g_buffer(radius):
    """Rays meet the same tubes; also at the same depth."""
    keys = frozenset({"depth", "position", "object_index", "combined"})
    here, there = (render(by(t, tubes(f"same {radius}", radius)), keys).pixels for t in ("VISIBILITY", "IMAGE_SPACE"))
    both = (here["object_index"] > 0) & (there["object_index"] > 0)
    either = (here["object_index"] > 0) | (there["object_index"] > 0)
    assert both.sum() > 500
    assert both.sum() / either.sum() > 0.98  # narrow ends are strips, of other widths; measured 0.997
    np.testing.assert_allclose(here["depth"][both], there["depth"][both], rtol=1e-3)


@pytest.mark.parametrize("name", ["tubes", "ribbons", "hair", "strands"])
def test_attributes_and_light_are_those_of_many_samples(name):
    """Means of 4 x 4 pixels against the G-buffer of a picture four times as large, in which thin strands are wider.

    Without shadows, which strands cast into maps here and into tables there.
    """
    case = picture(name)
    case = replace(case, settings=replace(case.settings, use_shadows=False))
    keys = frozenset({"combined", "normal", "diffuse_color", "mist"})
    here = render(by("VISIBILITY", case), keys, 16 * MANY.count)
    assert here.report["technique"]["name"] == "VISIBILITY"
    large = replace(case, camera=replace(case.camera, resolution=(4 * 96, 4 * 80)))
    there = render(by("IMAGE_SPACE", large), keys, 64)
    for key, most, mean in BOUNDS[name]:
        blocks = [
            found.pixels[key].reshape(20, size, 24, size, -1).mean(axis=(1, 3))
            for found, size in ((here, 4), (there, 16))
        ]
        error = blocks[0] - blocks[1]
        assert np.sqrt(np.mean(error**2)) < most, key
        assert abs(error.mean()) < mean, key


# Pass, root mean square of the difference, difference of the means. Measured: about two thirds of these.
BOUNDS = {
    "tubes": (
        ("combined", 0.004, 1e-4),
        ("diffuse_color", 0.004, 1e-4),
        ("normal", 0.004, 1e-4),
        ("mist", 0.006, 1e-4),
    ),
    "ribbons": (
        ("combined", 0.005, 1e-4),
        ("diffuse_color", 0.006, 1e-4),
        ("normal", 0.004, 1e-4),
        ("mist", 0.005, 2e-4),
    ),
    "hair": (("combined", 0.015, 2e-3), ("diffuse_color", 0.02, 1e-3), ("normal", 0.015, 2e-3), ("mist", 0.02, 2e-3)),
    "strands": (
        ("combined", 0.012, 3e-4),
        ("diffuse_color", 0.025, 3e-4),
        ("normal", 0.02, 1e-3),
        ("mist", 0.03, 4e-4),
    ),
}


def picture(name: str) -> Case:
    if name == "strands":
        return replace(case := CASES["strands"](), camera=replace(case.camera, resolution=(96, 80)))
    if name == "tubes":
        return tubes("attributes")
    rng = np.random.default_rng(8)
    if name == "ribbons":
        u = np.linspace(-1.2, 1.2, 30)
        normal = np.stack([0 * u, np.cos(3 * u), np.sin(3 * u)], axis=1).astype(np.float32)
        color = rng.random((30, 3), np.float32)
        line = np.stack([u, 0 * u, 0.2 * np.sin(4 * u)], axis=1)
        things = build.strand_lines("ribbon of colours", [line], 0.15, normal=normal, color=color)
    else:
        roots = rng.uniform(-1, 1, (3000, 1, 3)) * [1.2, 0.3, 0.6]
        way = np.array([0.3, 0, 1]) + rng.normal(0, 0.3, (3000, 1, 3))
        hair = roots + 0.5 * np.linspace(0, 1, 5)[:, None] * way
        color = np.repeat(rng.random((3000, 3), np.float32), 5, axis=0)
        things = build.strand_lines("hair of colours", list(hair), 0.004, color=color)
    return Case(build.scene((things, build.moved()), transparent=True), cameras.camera(resolution=(96, 80)), SETTINGS)


def test_cut_out_strands_leave_holes_as_large_as_themselves():
    """Thin ones, tubes and ribbons, before a plane."""
    for name in ("tubes", "ribbons", "hair"):
        case = picture(name)
        (geometry,) = case.scene.geometries
        held = build.scene((geometry, build.moved()), holdout=[True])
        whole = render(case, frozenset({"combined"}), 16).pixels["combined"][..., 3]
        left = render(Case(held, case.camera, SETTINGS), frozenset({"combined"}), 16).pixels["combined"][..., 3]
        np.testing.assert_allclose(left, 1 - whole, atol=1e-5)


def test_identities_of_strands_weigh_what_they_cover():
    """Those of all instances together are alpha."""
    case = by("VISIBILITY", picture("strands"))
    case = replace(case, scene=replace(case.scene, transparent=True))
    passes = frozenset({"combined", "crypto_object", "crypto_material"})
    found = render(case, passes, 16).pixels
    for key, hashes in (("object", case.scene.instances.object_hash), ("material", case.scene.materials.hash)):
        assert hashes is not None
        ranks = np.concatenate([found[f"crypto_{key}{i:02d}"].reshape(-1, 2) for i in range(3)])
        assert set(ranks[ranks[:, 1] > 0][:, 0].astype(np.float32).view(np.uint32)) <= set(hashes.tolist())
        weight = sum(found[f"crypto_{key}{i:02d}"][..., 1::2].sum(axis=-1) for i in range(3))
        np.testing.assert_allclose(weight, found["combined"][..., 3], atol=1e-4)  # measured 1e-6


@pytest.mark.parametrize("name", ["hair", "strands"])
def test_a_border_shows_the_same_strands_as_the_whole_picture(name):
    """Cells are counted from the whole picture's corner."""
    case = by("VISIBILITY", picture(name))
    width, height = case.camera.resolution
    x, y, w, h = width // 3, height // 4, width // 3, height // 2
    whole = render(case, frozenset({"combined"}), 40).pixels["combined"][y : y + h, x : x + w]
    part = render(replace(case, camera=replace(case.camera, region=(x, y, w, h))), frozenset({"combined"}), 40)
    same = np.isclose(part.pixels["combined"], whole, atol=1e-4)
    assert same.mean() > 0.997  # rounding may decide at edges; measured 0.9988
