"""A picture in parts: each of its tiles is in one part, and all parts together are the picture to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.render.frame.visibility import tiles
from pointsplat_addon.render.plan.request import Result
from scripts.scenes.cases import CASES
from scripts.scenes.drawing import opengl

PASSES = frozenset({"combined", "depth", "normal", "object_index"})
CELLS = 17 * 24 * 24  # of a tile: a picture of 64 x 64 pixels has more than a dozen


def parts(name: str, count: int, passes: frozenset[str], **settings: object) -> tuple[Result, list[Result]]:
    """The picture of a case at once, and in parts."""
    case, renderer = CASES[name](), opengl()
    request = replace(case.request(passes, samples=17), settings=replace(case.settings, technique="AUTO", **settings))
    whole = renderer.render(case.scene, request)
    return whole, [renderer.render(case.scene, replace(request, part=(k, count))) for k in range(count)]


def joined(whole: Result, found: list[Result]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The pictures of all parts by pass, and how many parts have each pixel."""
    pictures = {key: np.full_like(pixels, np.nan) for key, pixels in whole.pixels.items()}
    covered = np.zeros(whole.pixels["combined"].shape[:2], int)
    for part in found:
        for x, y, right, up in part.drawn or ():
            covered[y:up, x:right] += 1
            for key, picture in pictures.items():
                picture[y:up, x:right] = part.pixels[key][y:up, x:right]
    return pictures, covered


@pytest.mark.parametrize(
    "name", ["mixed", "in_smoke", "environment", "in_a_corner", "captured_among", "strands", "holdout", "region"]
)
def test_all_parts_together_are_the_picture_to_the_bit(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiles, "FEWEST_CELLS", CELLS)
    monkeypatch.setattr(tiles, "MOST_CELLS", CELLS)
    whole, found = parts(name, 3, PASSES, use_shadows=True)
    pictures, covered = joined(whole, found)
    assert (covered == 1).all()
    assert all(part.drawn for part in found)
    for key, pixels in whole.pixels.items():
        assert pictures[key].tobytes() == pixels.tobytes(), key


@pytest.mark.parametrize(
    ("passes", "settings"),
    [
        (PASSES, {"use_eye_dome": True}),  # neighbours darken each other
        (PASSES | {"crypto_object"}, {}),  # identities are ranked over the filter's support
    ],
)
def test_what_tiles_cannot_draw_alone_is_all_in_the_first_part(passes: frozenset[str], settings: dict) -> None:
    whole, (first, *others) = parts("mixed", 3, passes, **settings)
    height, width = whole.pixels["combined"].shape[:2]
    assert first.drawn == ((0, 0, width, height),)
    assert all(part.drawn == () and not part.pixels for part in others)
    assert all(first.pixels[key].tobytes() == pixels.tobytes() for key, pixels in whole.pixels.items())


def test_more_parts_than_tiles_leave_some_without() -> None:
    whole, found = parts("cube", 4, frozenset({"combined"}))
    assert [len(part.drawn or ()) for part in found] == [0, 0, 0, 1]
    assert found[3].pixels["combined"].tobytes() == whole.pixels["combined"].tobytes()
