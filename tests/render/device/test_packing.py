"""Numbers as the shaders read them."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.cache.keys import Key, Kind
from pointsplat_addon.render.device.packing import NO_NORMAL, PAGE_WIDTH, octahedral, paged
from pointsplat_addon.render.device.protocol import CHANNELS
from pointsplat_addon.render.passes.gbuffer import Variant
from pointsplat_addon.render.passes.pages.point_page import Page, PointOptions
from pointsplat_addon.render.prepare.point_sets import PointSet
from scripts.scenes import build
from tests.reference.packing import unpack_normal


def directions(count=20000):
    return _unit(np.random.default_rng(1).standard_normal((count, 3)))


def _unit(v):
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def test_a_packed_normal_is_within_six_hundredths_of_a_degree():
    n = directions()
    angle = np.degrees(np.arccos(np.clip((unpack_normal(octahedral(n.astype(np.float32))) * n).sum(axis=1), -1, 1)))
    assert angle.max() < 0.06  # measured 0.0588; half a step on both axes, thrice as long in an octant's middle: 0.0593


def test_codes_are_whole_numbers_that_float32_holds():
    code = octahedral(directions().astype(np.float32))
    assert code.dtype == np.float32
    assert (code == np.rint(code)).all()
    assert code.min() >= 0 > NO_NORMAL
    assert code.max() < 2**24


def test_axes_survive_packing():
    axes = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
    # 4,095 steps have no middle: half a step off, 2^-12
    np.testing.assert_allclose(unpack_normal(octahedral(axes)), axes, atol=3e-4)  # measured 2.44e-4


def test_unpacking_a_code_and_packing_it_again_is_the_identity():
    code = octahedral(directions().astype(np.float32))
    # The fold's rim has two codes for one direction.
    again = octahedral(unpack_normal(code).astype(np.float32))
    same = np.abs((unpack_normal(again) * unpack_normal(code)).sum(axis=1) - 1)
    assert same.max() < 1e-12  # measured 4.4e-16


def test_a_normal_of_length_zero_packs_without_warning():
    assert np.isfinite(octahedral(np.zeros((1, 3), np.float32))).all()


@pytest.mark.parametrize("count", [(1 << 18) - 1, 1 << 18, (1 << 18) + 1])
def test_blocks_of_rows_join_without_a_seam(count):
    n = np.tile(directions(1000), (count // 1000 + 1, 1))[:count].astype(np.float32)
    np.testing.assert_array_equal(octahedral(n)[-1000:], octahedral(n[-1000:]))


def test_a_page_is_4096_wide_and_padded_with_zeros():
    size, data = paged(np.arange(3 * 5000, dtype=np.float32).reshape(5000, 3), 4)
    assert size == (PAGE_WIDTH, 2)
    rows = data.reshape(2 * PAGE_WIDTH, 4)
    np.testing.assert_array_equal(rows[:5000, :3], np.arange(3 * 5000).reshape(5000, 3))
    assert not rows[:5000, 3].any()
    assert not rows[5000:].any()


@pytest.mark.parametrize("count", [0, 1, PAGE_WIDTH, PAGE_WIDTH + 1])
def test_any_number_of_rows_makes_a_page(count):
    size, data = paged(np.ones((count, 2), np.float64), 2)
    assert size == (PAGE_WIDTH, max(1, -(-count // PAGE_WIDTH)))
    assert data.dtype == np.float32
    assert data.size == 2 * size[0] * size[1]
    assert data.sum() == 2 * count


def test_a_page_holds_its_clouds_one_after_another():
    rng = np.random.default_rng(3)

    def cloud(count: int, **more: np.ndarray) -> PointCloud:
        position, radii = rng.random((count, 3), np.float32), rng.random((count, 2), np.float32)
        normal, axis = (_unit(rng.standard_normal((count, 3))).astype(np.float32) for _ in range(2))
        return PointCloud(position, normal=normal, axis=axis, radii=radii, **more)

    # More than a block of those that are packed together; shading normals without a direction.
    own = _unit(rng.standard_normal((40_000, 3))).astype(np.float32)
    own[::7] = 0
    first = cloud(40_000, shading_normal=own, material=np.arange(40_000).astype(np.uint16) % 5)
    second = replace(cloud(1000), normal=None, axis=None)
    made: dict[str, np.ndarray] = {}
    names = iter(("place", "extent", "color", "shading_normal"))

    class Recorder(NullDevice):
        def texture(self, size, format, data=None):
            assert callable(data)
            made[next(names)] = texels = np.full((size[0] * size[1], CHANNELS[format]), np.nan, np.float32)
            for start in range(0, len(texels), 30_001):  # across the clouds' ends
                data(texels[start : start + 30_001], slice(start, min(start + 30_001, len(texels))))
            return super().texture(size, format, data)

    table = build.materials(base_color=[[0.1 * i, 0.2, 0.3] for i in range(5)])
    sets = [PointSet(Key(Kind.CLOUD, "first"), first), PointSet(Key(Kind.CLOUD, "second"), second)]
    page = Page(Recorder(), sets, Variant(color=True), PointOptions(shading_normal=True), table)
    assert page.first == {Key(Kind.CLOUD, "first"): 0, Key(Kind.CLOUD, "second"): 40_000}

    wanted = {name: np.asarray(array) for name, array in first.arrays().items()}
    place, extent, color, shading = (made[name][:41_000] for name in ("place", "extent", "color", "shading_normal"))
    np.testing.assert_array_equal(place[:, :3], np.concatenate([first.position, second.position]))
    np.testing.assert_array_equal(place[:40_000, 3], octahedral(wanted["normal"]))
    assert (place[40_000:, 3] == NO_NORMAL).all()
    np.testing.assert_array_equal(extent[:, :2], np.concatenate([wanted["radii"], second.arrays()["radii"]]))
    np.testing.assert_array_equal(
        extent[:40_000, 2:], np.stack([octahedral(wanted["axis"]), wanted["material"]], axis=1)
    )
    assert not extent[40_000:, 2:].any()
    np.testing.assert_array_equal(color[:40_000, :3], table.base_color[wanted["material"]])
    assert (shading[:40_000:7] == NO_NORMAL).all()
    np.testing.assert_array_equal(shading[1:40_000:7, 0], octahedral(own[1::7]))
    assert (shading[40_000:] == NO_NORMAL).all()
    assert not any(data[41_000:].any() for data in made.values())
