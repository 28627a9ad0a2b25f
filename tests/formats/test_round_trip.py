"""Every field of a cloud and of a hierarchy survives packing and the disk. The fields are read from the dataclasses, so
that a new one is tested, or fails here, without being named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.lod.encoding import LENGTH_ERROR, TILT
from pointsplat_addon.core.lod.hierarchy import GEOMETRY, NODE_ATTRIBUTES, Hierarchy, build
from pointsplat_addon.core.lod.node_splats import points_and_nodes
from pointsplat_addon.core.lod.nodes.tree import Tree
from pointsplat_addon.core.lod.quantisation import CODES, pack, unpack
from pointsplat_addon.core.scene.cloud import ATTRIBUTES, PointCloud
from pointsplat_addon.formats import hierarchy_cache

POINTS = 300
EXTRA = [f.name for f in fields(PointCloud) if f.name not in (*GEOMETRY, "origin")]
BOUNDS = ("bound", "sphere", "cone", "smallest")  # rounded outwards
# Largest error that the format of a column allows, relative to the largest value of its row for "rgb".
TOLERANCE = {"rgb": 2.0**-9, "unorm": 1e-5, "byte": 2.1e-3}


def unit(v: np.ndarray) -> np.ndarray:
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


def some(name: str) -> np.ndarray:
    """Values of an attribute for POINTS points, by the table of attributes."""
    shape, dtype = ATTRIBUTES[name]
    rng = np.random.default_rng(len(name))
    size = (POINTS, *(() if shape is None else shape))
    if dtype is np.float32:
        return rng.random(size, np.float32)
    return rng.integers(0, 2 if dtype is np.bool_ else 100, size).astype(dtype)


def cloud(*names: str) -> PointCloud:
    """Ellipses with an origin and the named attributes."""
    rng = np.random.default_rng(0)
    normal = unit(rng.standard_normal((POINTS, 3)))
    return PointCloud(
        rng.standard_normal((POINTS, 3)).astype(np.float32),
        origin=np.array([1e7, -3.0, 0.125]),
        normal=normal,
        axis=unit(np.cross(normal, rng.standard_normal((POINTS, 3)))),
        radii=-np.sort(-rng.uniform(1e-3, 0.1, (POINTS, 2)), axis=1).astype(np.float32),
        **{name: some(name) for name in names},
    )


def through_disk(tmp_path: Path, hierarchy: Hierarchy) -> Hierarchy:
    hierarchy_cache.write(tmp_path, "key", hierarchy)
    found = hierarchy_cache.read(tmp_path, "key")
    assert found is not None
    return found


WAYS: dict[str, Callable[[Path, Hierarchy], Hierarchy]] = {
    "packed": lambda _, hierarchy: unpack(pack(hierarchy)),
    "disk": through_disk,
}


def assert_equal(name: str, before: Any, after: Any) -> None:
    """Equal up to the quantisation of a column with that name."""
    if before is None or not isinstance(before, np.ndarray):
        assert after is before, name
        return
    assert after.shape == before.shape, name
    assert after.dtype == before.dtype, name
    if name == "cone":
        angle = [np.arctan2(a[:, 1], a[:, 0]) % (2 * np.pi) for a in (before, after)]
        assert (angle[1] >= np.minimum(angle[0], np.pi) - 1e-6).all()
    elif name in BOUNDS:
        assert (after >= before * (1 - 1e-6)).all(), name
    elif name in ("normal", "axis"):
        off = np.linalg.norm(np.cross(before.astype(float), after.astype(float)), axis=1)
        assert off.max() < TILT, name  # axes have no sign
    elif name == "radii":
        np.testing.assert_allclose(after, before, rtol=LENGTH_ERROR, atol=1e-11)
    elif name in CODES:
        scale = before.max(axis=1, keepdims=True) if CODES[name] == "rgb" else 1.0
        assert (np.abs(after - before) <= TOLERANCE[CODES[name]] * scale).all(), name
    else:
        np.testing.assert_array_equal(after, before, name)


def assert_round_trip(before: Hierarchy, after: Hierarchy) -> None:
    for kind, a, b in (
        (Hierarchy, before, after),
        (PointCloud, before.cloud, after.cloud),
        (Tree, before.tree, after.tree),
    ):
        for f in fields(kind):
            if f.name not in ("cloud", "tree"):
                assert_equal(f.name, getattr(a, f.name), getattr(b, f.name))


def test_every_field_of_a_cloud_is_in_the_list_of_attributes() -> None:
    assert {f.name for f in fields(PointCloud)} - {"origin"} == set(ATTRIBUTES)


def test_every_optional_field_of_a_hierarchy_is_in_the_list_of_node_attributes() -> None:
    optional = {f.name for f in fields(Hierarchy) if f.default is None}
    assert optional == set(NODE_ATTRIBUTES)


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("names", [*((name,) for name in EXTRA), ("color", "emission", "opacity"), tuple(EXTRA)])
def test_every_attribute_survives(tmp_path: Path, names: tuple[str, ...], way: str) -> None:
    """Alone, with others, and all together."""
    before = build(cloud(*names))
    after = WAYS[way](tmp_path, before)
    assert set(names) <= set(after.cloud.arrays())
    assert_round_trip(before, after)
    assert len(points_and_nodes(after)) == POINTS + len(before)


@pytest.mark.parametrize("columns", [1, 3])
def test_extinction_and_radii_of_any_width_survive(tmp_path: Path, columns: int) -> None:
    rng = np.random.default_rng(1)
    balls = PointCloud(
        rng.random((POINTS, 3), np.float32),
        radii=rng.random((POINTS, 1), np.float32),
        extinction=rng.random((POINTS, columns), np.float32),
    )
    before = build(balls)
    assert_round_trip(before, through_disk(tmp_path, before))


def test_every_field_of_a_hierarchy_is_held_by_some_cloud_of_these_tests() -> None:
    """No field of a node is compared as None alone."""
    built = [build(cloud(*names)) for names in (*((name,) for name in EXTRA), tuple(EXTRA))]
    for f in fields(Hierarchy):
        assert any(getattr(h, f.name) is not None for h in built), f.name
