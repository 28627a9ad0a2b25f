"""What others hide is left out where that saves time, and pictures stay the same to the bit."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.frame.visibility import occluders, occlusion, tiles
from pointsplat_addon.render.frame.visibility.occlusion import Candidates, as_if_full, hidden_of, is_behind
from pointsplat_addon.render.passes.visibility.farthest import BLOCK_SIDE
from scripts.common import tower
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

SETTINGS = Settings(technique="VISIBILITY", use_shadows=False)
PASSES = frozenset({"combined", "depth", "normal", "object_index", "crypto_object"})
EYE = cameras.camera((0, -6, 0), resolution=(96, 72), near=0.05, far=60)
CELL = 6 * np.tan(np.radians(20)) * 2 / 96 / 17**0.5  # between sub-samples, in units 6 away from the eye
COLUMN = 57
COLORS = np.array([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8], [0.6, 0.6, 0.1]])
FENCE = MaterialGraph(alpha=color_nodes.Component(texture_nodes.ImageTexture(input_nodes.UV(), build.picture()), 0))
Things = list[tuple[Geometry, np.ndarray]]


def balls(count: int, rings: int = 8, key: str = "balls") -> Things:
    """Instances behind the plane y = 0."""
    ball, side = build.mesh(meshes.sphere_mesh(key, rings)), int(np.ceil(count**0.5))
    places = [(3.2 * (i % side) / side - 1.4, 1.0 + 0.1 * i, 2.4 * (i // side) / side - 1.0) for i in range(count)]
    return [(ball, build.moved(place, (-0.2 if i % 3 == 2 else 0.2, 0.2, 0.2))) for i, place in enumerate(places)]


def wall(key: str, left: float, right: float, y: float = 0.0) -> tuple[Geometry, np.ndarray]:
    """Two triangles, from one x to another."""
    position = np.array([[left, y, -3], [right, y, -3], [right, y, 3], [left, y, 3]], np.float32)
    return build.mesh(meshes.flat_mesh(key, position, np.array([[0, 1, 2], [0, 2, 3]]))), np.eye(4)


def slit() -> Scene:
    """A gap of a tenth of a cell before the centres of a column of pixels, and a wall behind it."""
    middle, gap = (2 * COLUMN + 1 - 96) / 96 * 6 * np.tan(np.radians(20)), 0.05 * CELL
    walls = wall("left", -3, middle - gap), wall("right", middle + gap, 3), wall("last", -3, 3, 0.5)
    return build.scene(*walls, *balls(36))


def street() -> Scene:
    """Towers about the eye, whose boxes cross the near plane and each other."""
    of = build.mesh(meshes.small_tower("tower"))
    return build.scene(*[(of, matrix) for matrix in tower.grid(8)], table=build.materials(4, base_color=COLORS))


def pages() -> Scene:
    """Different meshes on one page, one of which cuts a hole."""
    hidden = [
        (build.mesh(meshes.sphere_mesh(f"own {i}", 6 + i % 4)), matrix) for i, (_, matrix) in enumerate(balls(25))
    ]
    things = [wall("before", -3, 0.8), *hidden, wall("hole", 1.1, 1.4)]
    return build.scene(*things, holdout=[False] * (len(things) - 1) + [True], transparent=True)


def fence() -> Scene:
    """Cards that alpha cuts holes into, and a wall that hides some of what is behind these."""
    card = build.mesh(replace(meshes.plane_mesh("card"), materials=(1,)))
    cards = [(card, build.moved((0.5 * i - 1, -0.5 - 0.1 * i, 0))) for i in range(4)]
    return build.scene(*cards, wall("end", 0.2, 3), *balls(36), table=build.materials(2, graphs=(None, FENCE)))


def chunks() -> Scene:
    """Meshes of many chunks, of two materials; half of one is behind a wall, and its own front hides its back."""
    dense = meshes.sphere_mesh("dense", 120)
    rows = (np.arange(len(dense.triangles)) % 2).astype(np.int32)
    dense = build.mesh(replace(dense, material=rows, materials=(0, 1)))
    behind = build.mesh(meshes.sphere_mesh("behind", 110))
    things = (wall("half", -3, 0.3), (dense, build.moved((0.4, 2.2, 0))), (behind, build.moved((0, 5, 0), 1.5)))
    return build.scene(*things, table=build.materials(2, base_color=COLORS[:2]))


def vast() -> Scene:
    """A mesh of many chunks that spans 1e6, of which the eye sees a pleat from near: terms of its depth cancel."""
    dense = meshes.sphere_mesh("vast", 120)
    position = dense.position.astype(np.float64)
    position[:, 1] = np.abs(position[:, 1]) * np.where(np.abs(position[:, 1]) < 0.5, 4.0, 1e6)
    vast = build.mesh(replace(dense, position=position.astype(np.float32), topology="vast"))
    return build.scene((vast, np.eye(4)), wall("before", -3, 0.3, -0.5), *balls(16))


SCENES: dict[str, Callable[[], Scene]] = {
    "slit": slit, "street": street, "pages": pages, "fence": fence, "chunks": chunks, "vast": vast,
}  # fmt: skip
VIEWS = {
    "perspective": EYE,
    "parallel": cameras.camera((0, -6, 0), resolution=(96, 72), near=0.05, far=60, parallel=4.0),
    "among": cameras.camera((0.02, -0.9, 0.05), (0, 2, 0.2), resolution=(96, 72), near=0.02, far=60),
}


@pytest.fixture
def hidden(monkeypatch) -> list[int]:
    """How many were hidden in each view, where that is always looked for."""
    counts: list[int] = []

    def counted(*given) -> np.ndarray:
        found = hidden_of(*given)
        counts.append(int(found.sum()))
        return found

    monkeypatch.setattr(occluders, "hidden_of", counted)
    for name, value in {"FEWEST_TRIANGLES": 0, "LEAST_PROMISE": 0.0, "MOST_WORK": 1.0}.items():
        monkeypatch.setattr(occlusion, name, value)
    return counts


def drawn(scene: Scene, view: str, samples: int = 16) -> dict[str, np.ndarray]:
    result = render(Case(scene, VIEWS[view], SETTINGS), PASSES, samples)
    assert result.report["technique"]["name"] == "VISIBILITY"
    return result.pixels


@pytest.mark.parametrize("cells", [1 << 21, 1 << 15], ids=["one tile", "tiles"])
@pytest.mark.parametrize("view", ["perspective", "parallel"])
@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_the_same_to_the_bit(name, view, cells, hidden, monkeypatch):
    scene = SCENES[name]()
    view = "among" if name == "street" and view == "perspective" else view
    monkeypatch.setattr(tiles, "FEWEST_CELLS", cells)
    found = drawn(scene, view)
    assert sum(hidden) > 0 or (name, view) == ("street", "parallel")  # whose towers are no wider than blocks
    monkeypatch.setattr(occluders, "hidden_of", lambda given, *more: np.zeros(len(given.work), bool))
    for key, expected in drawn(scene, view).items():
        np.testing.assert_array_equal(found[key], expected, err_msg=key)


def test_what_one_sub_sample_shows_is_not_hidden(hidden):
    """Through the gap of a tenth of a cell, the centres of one column of pixels see the last wall."""
    depth = drawn(slit(), "perspective")["depth"].reshape(72, 96)
    np.testing.assert_allclose(depth, np.where(np.arange(96) == COLUMN, 6.5, 6.0) * np.ones((72, 1)), rtol=1e-5)
    assert hidden == [36]


def test_scenes_with_little_to_hide_have_no_such_pass():
    """Fewer triangles than tests take the time of; and spheres side by side, of which none hides another."""
    side, ball = 12, build.mesh(meshes.sphere_mesh("side by side", 50))
    apart = [(ball, build.moved((0.3 * (i % side) - 1.7, 0, 0.3 * (i // side) - 1.7), 0.14)) for i in range(side**2)]
    assert sum(len(of.mesh.triangles) for of, _ in apart if of.mesh is not None) > occlusion.FEWEST_TRIANGLES
    for scene in (slit(), build.scene(*apart)):
        report = render(Case(scene, EYE, SETTINGS), frozenset({"combined"}), 16).report
        assert "occlusion" not in [found["name"] for found in report["passes"]]


def boxes(low: np.ndarray, high: np.ndarray, depth: np.ndarray, work: np.ndarray) -> Candidates:
    return Candidates(low.astype(float), high.astype(float), depth.astype(float), depth + 0.5, work.astype(float))


def test_hidden_boxes_are_those_behind_all_that_is_drawn(monkeypatch):
    """Random full boxes at random depths: what is found to be hidden is hidden, by all blocks one after another."""
    monkeypatch.setattr(occlusion, "FEWEST_TRIANGLES", 0)
    rng, size = np.random.default_rng(4), (160, 120)
    low = rng.uniform(0, 100, (400, 2)) * (1.4, 1.0)
    given = boxes(low, np.minimum(low + rng.uniform(2, 70, (400, 2)), size), rng.uniform(1, 50, 400), np.full(400, 9))
    shape = size[1] // BLOCK_SIDE, size[0] // BLOCK_SIDE
    so_far = np.full(shape, np.inf)

    def draw(which: np.ndarray) -> np.ndarray:
        for i in np.flatnonzero(which).tolist():
            x, y = np.ceil(given.low[i] / BLOCK_SIDE).astype(int)
            end_x, end_y = np.floor(given.high[i] / BLOCK_SIDE).astype(int)
            so_far[y:end_y, x:end_x] = np.minimum(so_far[y:end_y, x:end_x], given.farthest[i])
        return so_far

    found = hidden_of(given, size, draw)
    assert 100 < found.sum() < 400  # measured 321
    for i in np.flatnonzero(found).tolist():
        x, y = (given.low[i] // BLOCK_SIDE).astype(int)
        end_x, end_y = np.ceil(given.high[i] / BLOCK_SIDE).astype(int)
        assert given.nearest[i] > so_far[y:end_y, x:end_x].max()


def test_boxes_as_wide_as_the_picture_are_spread_over_few_blocks():
    """20,000 of them, one behind another, would be in 1,152 million blocks of 2 pixels."""
    count, size = 20_000, (640, 360)
    low = np.zeros((count, 2))
    depths, seen, side = as_if_full(
        boxes(low, low + size, 1 + np.arange(count), np.full(count, 9)), np.ones(count, bool), size
    )
    assert count * depths.size <= 2 * occlusion.MOST_BLOCKS
    assert side == 64
    np.testing.assert_array_equal(np.flatnonzero(seen), [0])


def test_full_boxes_hide_what_is_behind_them():
    """A near box of 80 by 40 pixels before a far one of 40 by 40 within it, and one beside both."""
    low, high = np.array([[0, 0], [20, 0], [80, 0]]), np.array([[80, 40], [60, 40], [120, 40]])
    given = boxes(low, high, np.array([1.0, 2.0, 2.0]), np.ones(3))
    depths, seen, side = as_if_full(given, np.ones(3, bool), (120, 40))
    assert side == BLOCK_SIDE
    np.testing.assert_array_equal(seen, [800, 0, 400])
    np.testing.assert_array_equal(depths, np.where(np.arange(60) < 40, 1.5, 2.5) * np.ones((20, 1)))
    np.testing.assert_array_equal(is_behind(given, depths), [False, True, False])
