"""Facts about the packed form and its files: small, faithful, atomic, and safe against bad bytes."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportOptionalOperand=false
# pyright: reportArgumentType=false, reportCallIssue=false
# Attributes may be None by type; the clouds here have those that are asked for.
from __future__ import annotations

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from pointsplat_addon.core.lod import encoding, hierarchy, quantisation
from pointsplat_addon.core.lod.nodes import tree
from pointsplat_addon.core.lod.nodes.tree import Tree
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.splat import ellipsoids
from pointsplat_addon.formats import hierarchy_cache as cache
from pointsplat_addon.formats import whole_file


def unit(v: np.ndarray) -> np.ndarray:
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


def surface_cloud(n: int = 3000) -> PointCloud:
    """Position, normal, disk and colour: what a sampled mesh has."""
    rng = np.random.default_rng(1)
    p = unit(rng.standard_normal((n, 3)))
    return PointCloud(p, normal=p, radii=np.full((n, 1), 0.02, np.float32), color=rng.random((n, 3), np.float32))


def rich_cloud(n: int = 1200) -> PointCloud:
    """Every attribute."""
    rng = np.random.default_rng(2)
    normal = unit(rng.standard_normal((n, 3)))
    return PointCloud(
        rng.standard_normal((n, 3)).astype(np.float32), np.array([1e7, -3.0, 0.125]), normal,
        axis=unit(np.cross(normal, rng.standard_normal((n, 3)))),
        radii=-np.sort(-rng.uniform(1e-6, 0.1, (n, 3)), axis=1).astype(np.float32),
        color=rng.random((n, 3), np.float32), opacity=rng.random(n, np.float32),
        surface=rng.random((n, 2), np.float32), emission=(100 * rng.random((n, 3), np.float32)),
        extinction=rng.random((n, 3), np.float32), material=rng.integers(0, 9, n).astype(np.uint16),
        value=rng.standard_normal(n).astype(np.float32), kernel=rng.integers(0, 4, n).astype(np.uint8),
    )  # fmt: skip


def bare_cloud(n: int = 500) -> PointCloud:
    return PointCloud(np.random.default_rng(3).random((n, 3), np.float32))


CLOUDS = {
    "surface": surface_cloud,
    "rich": rich_cloud,
    "bare": bare_cloud,
    "balls": lambda: replace(bare_cloud(), radii=np.full((500, 1), 0.01, np.float32)),
    "empty": lambda: surface_cloud(0),
    "one": lambda: surface_cloud(1),
    "coincident": lambda: PointCloud(np.zeros((300, 3), np.float32)),
}


@pytest.fixture(params=CLOUDS, scope="module")
def built(request: pytest.FixtureRequest) -> hierarchy.Hierarchy:
    return hierarchy.build(CLOUDS[request.param]())


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    a, b = a.astype(np.float64), b.astype(np.float64)
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))


def assert_same(a: hierarchy.Hierarchy, b: hierarchy.Hierarchy) -> None:
    """Equal but for quantisation."""
    for f in fields(Tree):
        np.testing.assert_array_equal(getattr(a.tree, f.name), getattr(b.tree, f.name))
    np.testing.assert_array_equal(a.order, b.order)
    np.testing.assert_array_equal(a.cloud.position, b.cloud.position)
    np.testing.assert_array_equal(a.cloud.origin, b.cloud.origin)
    np.testing.assert_array_equal(a.center, b.center)
    assert a.cloud.arrays().keys() == b.cloud.arrays().keys()
    for x, y in ((a, b), (a.cloud, b.cloud)):
        for name, tolerance in (("color", 2**-9), ("emission", 2**-9)):
            if getattr(x, name) is not None:
                scale = np.maximum(getattr(x, name).max(axis=1, keepdims=True), 2**-15)
                assert (np.abs(getattr(x, name) - getattr(y, name)) <= tolerance * scale).all()
        for name, tolerance in (("opacity", 1e-5), ("surface", 2.1e-3)):
            if getattr(x, name) is not None:
                np.testing.assert_allclose(getattr(y, name), getattr(x, name), rtol=0, atol=tolerance)
        for name in ("extinction", "value", "material"):
            if getattr(x, name) is not None:
                np.testing.assert_array_equal(getattr(y, name), getattr(x, name))
        if x.normal is not None:
            assert (
                angle_between(x.normal, y.normal).max(initial=0) < encoding.TILT
            )  # measured 5e-5; 6.4e-5 over millions
        if x.axis is not None and len(x.axis):
            turned = angle_between(x.axis, y.axis)
            assert np.minimum(turned, np.pi - turned).max() < encoding.TILT  # measured 5e-5; 6.7e-5 over millions
        if x.radii is not None:
            np.testing.assert_allclose(y.radii, x.radii, rtol=encoding.LENGTH_ERROR, atol=1e-11)  # measured 2.1e-4


def test_round_trip(built: hierarchy.Hierarchy) -> None:
    assert_same(built, quantisation.unpack(quantisation.pack(built)))


def test_file_round_trip(built: hierarchy.Hierarchy, tmp_path: Path) -> None:
    path = cache.write(tmp_path / "new" / "folder", "any/../key", built)
    assert path.parent == tmp_path / "new" / "folder"
    again = cache.read(tmp_path / "new" / "folder", "any/../key")
    assert again is not None
    assert_same(built, again)
    assert path.stat().st_size < quantisation.pack(built).nbytes + 1000
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_size_per_point() -> None:
    """Position, normal, disk, colour, bounds, links and the original order."""
    built = hierarchy.build(surface_cloud(50_000))
    assert quantisation.pack(built).nbytes / 50_000 <= 46  # measured 38


def test_packed_bounds_contain_the_packed_disks() -> None:
    for make in (surface_cloud, rich_cloud):
        built = quantisation.unpack(quantisation.pack(hierarchy.build(make())))
        normal, axis, radii = (a.T for a in ellipsoids.splat_frames(built.cloud, slice(None)))
        third = np.cross(normal, axis)
        t = np.linspace(0, 2 * np.pi, 16, endpoint=False)[:, None, None]
        rim = np.cos(t) * axis * radii[:, :1] + np.sin(t) * third * radii[:, 1:2]
        rims = (rim + built.cloud.position).swapaxes(0, 1)
        other = np.cross(built.normal, built.axis)
        for node in range(len(built)):
            first = built.tree.first_point[node]
            d = rims[first : first + built.tree.point_count[node]].reshape(-1, 3) - built.center[node]
            b = built.bound[node].astype(np.float64)
            assert np.hypot(d @ built.axis[node] / b[0], d @ other[node] / b[1]).max() <= 1 + 1e-6
            assert np.abs(d @ built.normal[node]).max() <= b[2] + 1e-7
            assert np.linalg.norm(d, axis=1).max() <= built.size[node] * (1 + 1e-6)


def test_packed_cones_contain_the_packed_normals() -> None:
    built = quantisation.unpack(quantisation.pack(hierarchy.build(surface_cloud())))
    for node in range(len(built)):
        first = built.tree.first_point[node]
        n = built.cloud.normal[first : first + built.tree.point_count[node]]
        half = np.arctan2(built.cone[node, 1], built.cone[node, 0])
        assert built.cone[node, 0] <= -1 or angle_between(n, built.normal[node : node + 1]).max() <= half + 1e-7


def test_octahedral_normals_at_the_folds() -> None:
    g = np.array([-1.0, -1e-9, 0.0, 1e-9, 1.0])
    n = np.stack(np.meshgrid(g, g, g), axis=-1).reshape(-1, 3)
    n = unit(n[np.abs(n).max(axis=1) > 0.5])
    assert angle_between(n, encoding.decode_normal(encoding.encode_normal(n))).max() < encoding.TILT  # measured 4e-5


def test_shared_exponent_colours() -> None:
    """Powers of two are exact; the largest channel is within half of 1/256; carries do not overflow."""
    exact = np.array([[0, 0, 0], [1, 0.5, 0.25], [1024, 4, 0], [2.0**-14, 0, 0]], np.float32)
    np.testing.assert_array_equal(encoding.decode_rgb(encoding.encode_rgb(exact)), exact)
    carry = np.array([[0.99999994, 1.9999, 65408.0], [3.9999, 0, 0], [-1, 1e9, 0]], np.float32)
    back = encoding.decode_rgb(encoding.encode_rgb(carry))
    np.testing.assert_allclose(back[1, 0], 4, rtol=2**-9)
    np.testing.assert_array_equal(back[2], [0, 65408, 0])


def test_lengths_round_up_where_they_bound() -> None:
    length = np.concatenate([[0.0], 10.0 ** np.linspace(-10, 1, 2000)])
    up = encoding.decode_length(encoding.encode_length(length, 10.0, up=True), 10.0)
    assert (up >= length).all()
    assert up[0] == 0
    near = encoding.decode_length(encoding.encode_length(length, 10.0), 10.0)
    assert np.abs(near[1:] / length[1:] - 1).max() < encoding.LENGTH_ERROR  # measured 2.1e-4


def test_keys_tell_clouds_apart() -> None:
    cloud = surface_cloud(10)
    moved = cloud.position.copy()
    moved[3, 1] = np.nextafter(moved[3, 1], np.float32(9))
    others = [
        replace(cloud, position=moved),
        replace(cloud, color=None),
        replace(cloud, origin=np.ones(3)),
        cloud.take(slice(9)),
    ]
    keys = {cache.content_key(c, 12) for c in [cloud, *others]} | {cache.content_key(cloud, 8)}
    assert len(keys) == len(others) + 2
    assert cache.content_key(surface_cloud(10), 12) == cache.content_key(cloud, 12)


def test_missing_file_is_none(tmp_path: Path) -> None:
    assert cache.read(tmp_path, "nothing") is None
    assert cache.read(tmp_path / "no folder", "nothing") is None


@pytest.fixture
def written(tmp_path: Path) -> Path:
    return cache.write(tmp_path, "k", hierarchy.build(surface_cloud(200)))


def test_every_truncation_is_found(written: Path) -> None:
    content = written.read_bytes()
    for size in [*range(0, 300, 7), len(content) // 2, len(content) - 1]:
        written.write_bytes(content[:size])
        with pytest.raises(cache.CacheError, match=r"truncated|damaged"):
            cache.read(written.parent, "k")


def test_every_flipped_bit_is_found(written: Path) -> None:
    content = written.read_bytes()
    for at in np.random.default_rng(0).integers(0, len(content), 200).tolist() + list(range(60)):
        bad = bytearray(content)
        bad[at] ^= 1 << at % 8
        written.write_bytes(bad)
        with pytest.raises(cache.CacheError, match=str(written)):
            cache.read(written.parent, "k")


def forge(path: Path, edit) -> None:
    """Change the header and records of a file and give it a right checksum again."""
    content = path.read_bytes()
    length = cache.FIXED.unpack_from(content)[2]
    header = json.loads(content[cache.FIXED.size : cache.FIXED.size + length])
    records = bytearray(content[cache.FIXED.size + length :])
    edit(header, records)
    text = json.dumps(header).encode()
    fixed = cache.FIXED.pack(cache.MAGIC, cache.VERSION, len(text), cache._digest([text, records]))
    path.write_bytes(fixed + text + records)


def put(records: bytearray, at: int, value: bytes) -> None:
    records[at : at + len(value)] = value


FORGERIES = {
    "huge counts": lambda head, _: head.update(points=2**31 - 1),
    "negative counts": lambda head, _: head.update(points=-5),
    "fractional counts": lambda head, _: head.update(points=200.0),
    "missing field": lambda head, _: head.pop("nodes"),
    "no origin": lambda head, _: head.update(origin=[0, 0]),
    "infinite length": lambda head, _: head.update(longest=1e39),
    "unknown attribute": lambda head, _: head.update(attributes=[["__class__", []]]),
    "huge shape": lambda head, _: head.update(attributes=[["extinction", [10**9]]]),
    "twice": lambda head, _: head.update(attributes=[["color", [3]], ["color", [3]]]),
    "not a list": lambda head, _: head.update(attributes=7),
    "no normals": lambda head, _: head.update(normal=False),
    "order out of range": lambda _, records: put(records, len(records) - 4, b"\xff\xff\xff\x7f"),
    "order negative": lambda _, records: put(records, len(records) - 4, b"\xff\xff\xff\xff"),
    "order twice": lambda _, records: put(records, len(records) - 4, bytes(records[-8:-4])),
    "not finite": lambda _, records: put(records, 0, np.float32(np.nan).tobytes()),
}


@pytest.mark.parametrize("name", FORGERIES)
def test_forged_files_are_refused(written: Path, name: str) -> None:
    forge(written, lambda head, records: None)
    assert cache.read(written.parent, "k") is not None
    forge(written, FORGERIES[name])
    with pytest.raises(cache.CacheError):
        cache.read(written.parent, "k")


@pytest.mark.parametrize(
    ("children", "leaf_points", "points"),
    [
        ([], [], 3),
        ([2, 0], [0, 3], 3),  # a child is missing
        ([0, 1], [1, 2], 3),  # the root has no child, the other is its own
        ([1, 0, 1, 0], [0, 1, 0, 2], 3),  # a part that the root does not reach
        ([2, 0, 0], [0, 1, 1], 3),  # too few points
        ([2, 0, 0], [0, 3, 0], 3),  # an empty leaf
        ([1] * 200 + [0], [0] * 200 + [1], 1),  # too deep
    ],
)
def test_links_that_are_no_tree_are_refused(children: list[int], leaf_points: list[int], points: int) -> None:
    with pytest.raises(ValueError, match=r"nodes|leaves"):
        tree.tree_from_counts(np.array(children, np.uint8), np.array(leaf_points, np.uint32), points)


def test_failed_write_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built = hierarchy.build(surface_cloud(50))
    cache.write(tmp_path, "k", built)
    before = cache.path_of(tmp_path, "k").read_bytes()

    def full(*_: object) -> None:
        raise OSError("disk full")

    monkeypatch.setattr(whole_file.os, "replace", full)
    with pytest.raises(OSError, match="full"):
        cache.write(tmp_path, "k", hierarchy.build(surface_cloud(60)))
    assert [p.read_bytes() for p in tmp_path.iterdir()] == [before]
