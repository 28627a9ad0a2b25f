"""Which pages out of view cast shadows into it: those between what is seen and the lights; no others."""

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.stream.casting import Casters, Receivers, receivers_of
from pointsplat_addon.stream.need import needed_pages, projected_spacing
from pointsplat_addon.stream.tree import PageTree
from scripts.scenes import cameras
from tests.support.octrees import MemoryPages

CAMERA = cameras.camera(eye=(0.2, 0.499, 3.0), target=(0.2, 0.5, 0.0), resolution=(32, 32), parallel=0.12)
TOLERANCE = 0.01
MATRIX = np.eye(4)[None]


def light(kind: str) -> Light:
    along = np.array([-0.8, 0.0, -0.6])
    return Light(kind, np.ones(3), np.array([0.95, 0.5, 0.95]), along, axis_u=np.zeros(3), axis_v=np.zeros(3))


@pytest.fixture(scope="module")
def source() -> MemoryPages:
    position = np.random.default_rng(5).uniform(0, 1, (20_000, 3))
    position[:10_000, 2] *= 0.05
    return MemoryPages(position, 40, 0.1)


def beams(source: MemoryPages, kind: str, seen: np.ndarray) -> np.ndarray:
    """(N,) how far points are from the nearest beam of a seen point to the light."""
    position, receivers = source.columns["position"].astype(float), source.columns["position"][seen].astype(float)
    found = np.full(len(position), np.inf)
    for point in receivers:
        away = position - point
        if kind == "SUN":
            toward = np.array([0.8, 0.0, 0.6])
            near = np.maximum(away @ toward, 0)[:, None] * toward
        else:
            beam = light(kind).position - point
            near = np.clip(away @ beam / (beam @ beam), 0, 1)[:, None] * beam
        np.minimum(found, np.linalg.norm(away - near, axis=1), out=found)
    return found


@pytest.mark.parametrize("kind", ["SUN", "POINT", "AREA"])
def test_pages_out_of_view_are_needed_where_they_lie_between_what_is_seen_and_a_light(
    source: MemoryPages, kind: str
) -> None:
    tree = PageTree(source.directory)
    view = CAMERA.view_from_world[None]
    need = needed_pages(tree, view, CAMERA, TOLERANCE)
    receivers = receivers_of([(tree, need, MATRIX)], CAMERA, TOLERANCE)
    assert receivers is not None
    cast = Casters(tree, MATRIX, receivers, [light(kind)], 1 << 14)
    found = needed_pages(tree, view, CAMERA, TOLERANCE, cast.spacing)
    assert set(need.pages.tolist()) < set(found.pages.tolist())
    assert (np.diff(found.gain) <= 0).all()
    position = source.columns["position"]
    seen = (np.abs(position[:, :2] - (0.2, 0.5)) < 0.06).all(axis=1)
    apart = beams(source, kind, np.flatnonzero(seen))
    in_view = projected_spacing(source.directory, view[0], CAMERA) > 0
    wanted, unwanted = set(found.pages.tolist()), 0
    for page, rows in enumerate(source.rows):
        if not in_view[page] and (apart[rows] < 1e-6).any():
            assert page in wanted
        # Boxes around pages and what is seen reach beyond these by their diagonals.
        low, high = source.directory.bounds[page]
        far = np.linalg.norm(high - low) + 2 * np.linalg.norm(receivers.half, axis=1).max()
        if not in_view[page] and apart[rows].min() > far:
            assert page not in wanted
            unwanted += 1
    assert unwanted > 10


def spacing_of(tree: PageTree, receivers: Receivers, lights: list[Light], resolution: int, page: np.ndarray) -> float:
    """Of a page (1,), after those above it."""
    cast, line = Casters(tree, MATRIX, receivers, lights, resolution), [page]
    while line[0][0] > 0:
        line.insert(0, tree.directory.parent[line[0]])
    return [cast.spacing(one) for one in line[1:]][-1][0]


def test_shadows_are_as_fine_as_the_view_the_map_and_the_light_show_them(source: MemoryPages) -> None:
    tree = PageTree(source.directory)
    receivers = Receivers(np.array([[0.5, 0.5, 0.0]]), np.full((1, 3), 0.01), np.array([0.02]), 1.0)
    leaf = np.flatnonzero(tree.is_leaf)
    high = leaf[np.argmax(source.directory.bounds[leaf, 0, 2])][None]
    middle = source.directory.bounds[high[0]].mean(axis=0)
    up = np.array([[0.5, 0.5, 0.0]]) - middle
    along = up[0] / np.linalg.norm(up[0])
    sun = Light("SUN", np.ones(3), np.zeros(3), along)
    lamp = Light("POINT", np.ones(3), middle - up[0], along)  # twice as far away as the page
    assert spacing_of(tree, receivers, [sun], 1 << 14, high) == pytest.approx(0.02)
    assert spacing_of(tree, receivers, [sun], 4, high) == pytest.approx(1 / 16)
    assert spacing_of(tree, receivers, [lamp], 1 << 14, high) == pytest.approx(0.01)
    wide = Light("SUN", np.ones(3), np.zeros(3), along, radius=0.1)
    distance = np.linalg.norm(up)
    assert spacing_of(tree, receivers, [wide], 1 << 14, high) == pytest.approx(np.tan(0.1) * distance)
    beneath = Light("SUN", np.ones(3), np.zeros(3), -along)
    assert np.isinf(spacing_of(tree, receivers, [beneath], 1 << 14, high)).all()


def test_nothing_that_is_seen_receives_nothing(source: MemoryPages) -> None:
    tree = PageTree(source.directory)
    away = cameras.camera(eye=(0.5, -1.5, 1.5), target=(0.5, -4.0, 3.0), resolution=(32, 32))
    need = needed_pages(tree, away.view_from_world[None], away, 1.0)
    assert receivers_of([(tree, need, MATRIX)], away, 1.0) is None
