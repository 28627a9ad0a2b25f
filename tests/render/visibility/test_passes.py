"""All passes of the visibility buffer: what lies under pixels' centres, averages, identities, and tiles."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.numeric.lattice import MANY
from pointsplat_addon.render.frame.visibility import tiles
from pointsplat_addon.render.passes.pages import point_page
from scripts.scenes.case import Case
from scripts.scenes.cases import CASES
from scripts.scenes.drawing import opengl, render
from tests.reference import opaque

EXACT = ["cube", "wide_balls", "parallel_balls"]  # scenes without samples of surfaces


def by(technique: str, name: str) -> Case:
    case = CASES[name]()
    return replace(case, settings=replace(case.settings, technique=technique))


@pytest.mark.parametrize("name", EXACT)
def test_what_lies_under_the_centres_is_what_float64_says(name):
    case = by("VISIBILITY", name)
    found, exact = render(case).pixels, opaque.picture(case.scene, case.camera)
    index = case.scene.instances.pass_index
    assert index is not None
    same = found["object_index"][..., 0] == np.where(exact.instance >= 0, index[exact.instance], 0)
    assert same.mean() > 0.99  # measured 1: rounding may decide at edges
    both = same & (exact.depth < opaque.BACKGROUND_DEPTH)
    if name == "cube":  # the reference takes balls for disks
        assert np.abs(found["depth"][..., 0] / exact.depth - 1)[both].max() < 1e-5  # measured 4e-7


@pytest.mark.parametrize("name", EXACT)
def test_passes_under_the_centres_are_those_of_the_g_buffer(name):
    """Polygons and balls are the same whether a G-buffer or the visibility buffer finds them."""
    here, there = render(by("VISIBILITY", name)).pixels, render(by("IMAGE_SPACE", name)).pixels
    for key in ("depth", "position", "object_index", "material_index", "vector"):
        np.testing.assert_allclose(here[key], there[key], rtol=1e-5, atol=1e-5, err_msg=key)  # measured 3e-7


# Of thousands of small parts a sample takes half a second.
SPLIT = [("split_mesh", 64), pytest.param("split_mesh", 512, marks=pytest.mark.long)]


@pytest.mark.parametrize(("name", "samples"), [*((name, 512) for name in EXACT), *SPLIT])
def test_averages_converge_to_those_of_whole_samples(name, samples):
    passes = frozenset({"combined", "diffuse_color", "normal", "mist"})
    truth = render(by("IMAGE_SPACE", name), passes, samples).pixels
    found = render(by("VISIBILITY", name), passes, 16 * MANY.count).pixels
    for key, most in (("combined", 0.005), ("diffuse_color", 0.004), ("normal", 0.01), ("mist", 0.004)):
        error = np.sqrt(np.mean((found[key] - truth[key]) ** 2))
        assert error < most, (key, error)  # measured at most 0.0043, 0.006, 0.0029


@pytest.mark.parametrize("name", ["mixed", "wide_balls", "region", "moving"])
def test_tiles_show_what_the_whole_picture_shows(name, monkeypatch):
    case = by("VISIBILITY", name)
    opengl().pool.release()  # targets are kept, with their tiles
    whole = render(case, samples=20).pixels
    opengl().pool.release()
    monkeypatch.setattr(tiles, "MOST_CELLS", 12_000)
    assert len(tiles.picture_tiles(case.camera.window[2:], MANY, 16384, tiles.cells_of_tile(1, False, False), 1)) > 1
    divided = render(case, samples=20).pixels
    opengl().pool.release()
    for key, array in whole.items():
        same = np.isclose(divided[key], array, rtol=1e-4, atol=1e-4)  # measured 4e-5, where all are the same
        assert same.mean() > 0.999, key  # rounding may decide at edges; measured 1


@pytest.mark.parametrize("size", [(1920, 1080), (3840, 2160), (7, 20_000), (12_345, 3)])
def test_tiles_divide_pictures_of_all_sizes(size):
    found = tiles.picture_tiles(size, MANY, 16384, tiles.MOST_CELLS, 1)
    owners = np.zeros(size[::-1], np.uint8)
    for tile in found:
        owners[tile.corner[1] : tile.end[1], tile.corner[0] : tile.end[0]] += 1
        columns, rows = MANY.size(tile.size)
        assert max(columns, rows) <= 16384
        assert columns * rows <= tiles.MOST_CELLS
        low, high = np.subtract(tile.corner, tile.origin), np.add(tile.origin, tile.size) - tile.end
        assert len(found) == 1 or min(*low, *high) >= 1
    assert (owners == 1).all()


@pytest.mark.parametrize("name", ["balls", "wide_balls", "parallel_balls", "scales"])
def test_balls_without_extents_are_the_same(name, monkeypatch):
    case = by("VISIBILITY", name)
    found = render(case, samples=20).pixels
    opengl().kept.clear()
    asked = []
    monkeypatch.setattr(point_page, "_ball_material", lambda sets: asked.append(sets) or -1)
    with_extents = render(case, samples=20).pixels
    opengl().kept.clear()
    assert asked
    for key, array in found.items():
        np.testing.assert_array_equal(array, with_extents[key], err_msg=key)


def test_cryptomatte_ranks_all_sub_samples_by_the_pixel_filter():
    """Of one object before a transparent film, its coverage is the picture's alpha."""
    case = by("VISIBILITY", "balls")
    case = replace(case, scene=replace(case.scene, transparent=True))
    for samples in (16, 40):
        found = render(case, samples=samples).pixels
        np.testing.assert_allclose(
            found["crypto_object00"][..., 1], found["combined"][..., 3], atol=1e-5
        )  # measured 4e-7
        there = found["crypto_object00"][..., 0] != 0
        np.testing.assert_array_equal(there, found["combined"][..., 3] > 0)


@pytest.mark.parametrize(("asked", "drawn"), [(1, 1), (4, 5), (16, 17), (20, 34)])
def test_the_report_says_how_many_sub_samples_a_pixel_has(asked, drawn):
    assert render(by("VISIBILITY", "cube"), samples=asked).report["samples"] == drawn
