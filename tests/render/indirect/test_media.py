"""Light in media, and what they hide and send, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.indirect.media import MediaGrid
from pointsplat_addon.core.indirect.surfels import Surfels
from pointsplat_addon.core.indirect.tree import build_tree
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.materials import MaterialTable
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.formats import record_file
from pointsplat_addon.render.indirect import media
from pointsplat_addon.render.indirect.bake import Baker
from pointsplat_addon.render.indirect.known_sites import Slices
from pointsplat_addon.render.indirect.light import BakedLight, IndirectLight
from pointsplat_addon.render.indirect.media import BakedMedia, baked_media, scene_media
from pointsplat_addon.render.passes.indirect.pages import node_rows
from scripts.scenes import drawing
from scripts.scenes.build import materials, moved, points, scene
from scripts.scenes.clouds import smoke_cloud
from scripts.scenes.indirect_cases import under_smoke
from tests.support.surfels import ball, surfels_of

SKY = ("PS_HAS_WORLD",)
NODES, WEIGHTS = np.polynomial.legendre.leggauss(400)


def exponential(order: int, depth: np.ndarray | float) -> np.ndarray:
    """E_n of depths (N,): the integral of mu^(n-2) exp(-depth / mu) over mu from 0 to 1."""
    mu = 0.5 * (NODES + 1)
    return (0.5 * WEIGHTS * mu ** (order - 2) * np.exp(-np.atleast_1d(depth)[:, None] / mu)).sum(axis=1)


def fog(low, high, shape, extinction: float, albedo: float, emission: float = 0.0, block: int = 1) -> MediaGrid:
    """A box of cells that are all the same."""
    low, shape = np.asarray(low, float), np.asarray(shape)
    edge = float((np.asarray(high)[0] - low[0]) / shape[0])
    count, blocks = int(np.prod(shape)), int(np.prod(-(-shape // block)))
    scatters = np.full((count, 3), albedo * extinction, np.float32)
    return MediaGrid(
        low, edge, shape, np.full(count, extinction, np.float32), scatters, scatters,
        np.full((count, 3), emission, np.float32), block, np.arange(blocks),
    )  # fmt: skip


def round_fog(cells: int, extinction: float, albedo: float) -> MediaGrid:
    """A ball of radius 1."""
    grid = fog((-1, -1, -1), (1, 1, 1), (cells,) * 3, extinction, albedo)
    inside = np.linalg.norm(grid.centres(np.arange(cells**3)), axis=1) < 1
    grid.extinction[~inside], grid.scattering[~inside] = 0, 0
    return MediaGrid(
        grid.low, grid.edge, grid.shape, grid.extinction, grid.scattering, grid.scattering, grid.emission, 1,
        np.flatnonzero(inside),
    )  # fmt: skip


def no_surfels() -> Surfels:
    return surfels_of(np.zeros((0, 3)), np.zeros((0, 3)), np.array(1.0))


def light_of(grid: MediaGrid, sky: float = 1.0, surfels: Surfels | None = None, radiance: float = 0.0) -> IndirectLight:
    """Light that media emit alone, and surfels."""
    nodes, cube = np.zeros((0, 16), np.float32), np.zeros(4, np.float32)
    if surfels is not None:
        tree, sides = build_tree(surfels), np.full((len(surfels), 3), radiance)
        nodes, cube = node_rows(tree, tree.radiance(surfels, sides, sides)), tree.cube
    media = baked_media(grid, grid.emission, np.zeros((len(grid.receivers), 3)))
    world = World(np.full(3, sky))
    return IndirectLight(drawing.opengl().device, BakedLight(np.zeros(3), nodes, cube, media), world, SKY)


def baked(grid: MediaGrid, bounces: int) -> BakedLight:
    """Under a sky of 1."""
    bare = scene(lights=(), world=World(np.ones(3)))
    baker = Baker(bare, no_surfels(), SKY, bounces, grid)
    return baker.bake(drawing.opengl().device, {}, Slices(), lambda: None)


def in_all_orders(grid: MediaGrid, bounces: int) -> np.ndarray:
    """(R,) the mean radiance at receivers."""
    media = baked(grid, bounces).media
    assert media is not None
    return media.light[grid.receivers, 0].astype(float) ** 4


@pytest.mark.parametrize("depth", [0.1, 0.5, 1.0, 3.0])
def test_fog_hides_the_sky_of_a_floor(depth):
    """Of the sky's light on a floor below a layer of absorbing fog 2 E3(depth) is left. Worst: 0.1 % of the sky."""
    light = light_of(fog((-30, -30, 0), (30, 30, 1), (60, 60, 1), depth, 0.0))
    place, up = np.array([[0.13, 0.21, -0.01]]), np.array([[0.0, 0.0, 1.0]])
    found = light.gathered(place, up, {})[0, 0]
    light.release()
    assert found == pytest.approx(2 * exponential(3, depth)[0], abs=0.005)


def test_glowing_fog_lights_a_floor():
    """Emission j over extinction s, less what 2 E3 leaves out; the sky is dark. Worst: 0.04 %."""
    depth, glow = 0.7, 0.9
    light = light_of(fog((-30, -30, 0), (30, 30, 1), (60, 60, 1), depth, 0.0, glow), sky=0.0)
    place, up = np.array([[0.13, 0.21, -0.01]]), np.array([[0.0, 0.0, 1.0]])
    found = light.gathered(place, up, {})[0, 0]
    light.release()
    assert found == pytest.approx(glow / depth * (1 - 2 * exponential(3, depth)[0]), rel=0.01)


def test_what_stands_in_fog_is_seen_through_it():
    """From the middle of a ball of radius 1 whose inside sends 1, through fog that glows. Worst: 0.9 %."""
    thick, glow = 0.8, 0.3
    light = light_of(fog((-2, -2, -2), (2, 2, 2), (31,) * 3, thick, 0.0, glow), 5.0, ball(3000, 1.0, 0.0), 1.0)
    found = light.within_media(np.array([[0.01, 0.02, 0.013]]), 1.0, {})[0, 0]
    light.release()
    left = np.exp(-thick)
    assert found == pytest.approx(left + glow / thick * (1 - left), rel=0.01)


@pytest.mark.parametrize("depth", [0.25, 0.75, 2.25])
def test_a_point_in_absorbing_fog_under_a_sky(depth):
    """In a layer of depth 4, with the sky above and below: half of E2 of both depths. Worst: 0.2 % of the sky."""
    light = light_of(fog((-20, -20, -4), (20, 20, 0), (40, 40, 4), 1.0, 0.0))
    found = light.within_media(np.array([[0.2, 0.3, -depth]]), 1.0, {})[0, 0]
    light.release()
    truth = 0.5 * (exponential(2, depth) + exponential(2, 4 - depth))[0]
    assert found == pytest.approx(truth, abs=0.005)


@pytest.mark.parametrize("albedo", [0.5, 0.8])
def test_a_point_at_the_rim_of_deep_fog(albedo):
    """The mean radiance at the rim of a half-space that scatters evenly, under an even sky, is 1 / (1 + sqrt(1 - w)):
    a half-space that is as warm as the sky has 1 everywhere, and sends sqrt(1 - w) at its rim (Rybicki and Lightman
    1979). Cells have a depth of 0.5. Found: 0.982 and 0.990 of it."""
    made = baked(fog((-6, -6, -5), (6, 6, 0), (24, 24, 10), 1.0, albedo), 12)
    light = IndirectLight(drawing.opengl().device, made, World(np.ones(3)), SKY)
    found = light.within_media(np.array([[0.1, 0.17, -1e-4]]), 1.0, {})[0, 0]
    light.release()
    assert found == pytest.approx(1 / (1 + np.sqrt(1 - albedo)), rel=0.02)


def test_what_absorbs_nothing_is_as_bright_as_the_sky():
    """A ball of depth 4 across, of albedo 1, after 32 bounces. Worst: 0.15 %, in the middle."""
    found = in_all_orders(round_fog(12, 2.0, 1.0), 32)
    assert np.abs(found - 1).max() < 0.003


def test_light_converges_as_cells_get_finer():
    """The mean of a ball's light after two bounces, with 8, 16 and 32 cells across: ever less is left of the error.
    Found: 0.4656, 0.4783 and 0.4799."""
    of = {cells: in_all_orders(round_fog(cells, 3.0, 0.9), 2).mean() for cells in (8, 16, 32)}
    assert abs(of[16] - of[32]) < 0.6 * abs(of[8] - of[32])


def grid_of(cloud: PointCloud, *matrices: np.ndarray, table: MaterialTable | None = None) -> MediaGrid | None:
    made = scene(*((points("smoke", cloud), matrix) for matrix in matrices), table=table or materials())
    return scene_media(made, np.ones(len(matrices), bool), np.zeros(3), lambda: None)


def cross_section(grid: MediaGrid | None) -> float:
    assert grid is not None
    return float(grid.extinction.sum(dtype=float)) * grid.edge**3


def test_matter_counts_in_the_units_of_objects():
    """A ball that is scaled by 3, its extinction counting per object unit, hides nine times as much; several add up."""
    cloud = smoke_cloud(12, 2.0)
    one = cross_section(grid_of(cloud, moved()))
    assert one == pytest.approx(2.0 * len(cloud.position) * (2 / 12) ** 3, rel=1e-4)
    assert cross_section(grid_of(cloud, moved(scale=3.0))) == pytest.approx(9 * one, rel=1e-4)
    assert cross_section(grid_of(cloud, moved(), moved((5, 1, 0)))) == pytest.approx(2 * one, rel=1e-4)


def test_what_scatters_forwards_counts_as_less():
    """By similarity: of extinction 2 and albedo 0.9 with g = 0.5, 2 (0.1 + 0.9 / 2) is left; lamps' light stays."""
    plain = smoke_cloud(12, 2.0)
    cloud = replace(plain, color=np.full_like(plain.position, 0.9))
    grid = grid_of(cloud, moved(), table=materials(anisotropy=np.array([0.5], np.float32)))
    assert grid is not None
    assert cross_section(grid) == pytest.approx(0.55 * cross_section(grid_of(plain, moved())), rel=1e-4)
    assert grid.lit.sum() == pytest.approx(2 * grid.scattering.sum(), rel=1e-4)


def test_bad_matter_is_left_out():
    """What is not finite, transforms of no volume, and very dense matter: everything in the grid is finite."""
    cloud = smoke_cloud(6)
    assert cloud.extinction is not None
    extinction = cloud.extinction.copy()
    extinction[:4] = np.nan, np.inf, -1.0, 1e38
    bad = replace(cloud, extinction=extinction, emission=np.full_like(cloud.position, np.nan))
    flat, lost = moved(scale=0.0), moved()
    lost[0, 3] = np.nan
    for matrices in ((moved(),), (moved(), flat), (moved(), lost), (flat,), (moved(scale=1e-6), moved((1e5, 0, 0)))):
        grid = grid_of(bad, *matrices)
        assert grid is not None
        assert all(np.isfinite(a).all() for a in (grid.extinction, grid.scattering, grid.lit, grid.emission))
    assert grid_of(bad, lost) is None


def test_of_very_many_puffs_some_stand_for_all(monkeypatch):
    cloud = smoke_cloud(12, 2.0)
    matrices = [moved((3 * k, 0, 0)) for k in range(8)]
    whole = cross_section(grid_of(cloud, *matrices))
    monkeypatch.setattr(media, "MOST_SPLATS", 2000)
    assert cross_section(grid_of(cloud, *matrices)) == pytest.approx(whole, rel=0.01)


def test_light_that_was_scattered_again_is_volume_indirect():
    """There is some with bounces, and none without; both passes together are what smoke shows."""
    case = under_smoke()
    asked = frozenset({"combined", "volume_direct", "volume_indirect"})
    found = {
        bounces: drawing.render(replace(case, settings=replace(case.settings, bounces=bounces)), asked).pixels
        for bounces in (0, 2)
    }
    assert not found[0]["volume_indirect"].any()
    assert found[2]["volume_indirect"].max() > 0.05 * found[2]["volume_direct"].max()
    assert np.abs(found[0]["volume_direct"] - found[2]["volume_direct"]).max() < 1e-6


def test_smoke_hides_the_sky_from_a_floor_and_is_darker_below():
    """A dark sky's worth of light is missing under it, and its lower half is darker than the upper."""
    case = under_smoke()
    plain = scene(*zip(case.scene.geometries, case.scene.instances.world_from_object, strict=True), lights=(),
                  world=World(np.ones(3)), table=case.scene.materials)  # fmt: skip
    sky = replace(case, scene=plain)
    lit, bare = (
        drawing.render(replace(sky, settings=replace(case.settings, use_indirect=on))).pixels["combined"][..., 0]
        for on in (True, False)
    )
    assert (lit <= bare + 0.01).all()
    assert lit.mean() < 0.9 * bare.mean()


def test_channels_are_dimmed_by_themselves():
    """The sky of a floor below a layer of three depths. Worst: 0.2 % of it."""
    depths = np.array([0.2, 0.7, 2.0])
    plain = fog((-30, -30, 0), (30, 30, 1), (60, 60, 1), 1.0, 0.0)
    light = light_of(replace(plain, extinction=np.tile(depths.astype(np.float32), (3600, 1))))
    found = light.gathered(np.array([[0.13, 0.21, -0.01]]), np.array([[0.0, 0.0, 1.0]]), {})[0, :3]
    light.release()
    assert found == pytest.approx(2 * exponential(3, depths), abs=0.005)


def test_matter_of_several_colours_scatters_no_more_than_falls_on_it():
    """What absorbs nothing is as bright as the sky in each channel. Worst: 0.3 %."""
    cloud = smoke_cloud(8, (0.5, 1.0, 3.0))
    grid = grid_of(replace(cloud, color=np.ones_like(cloud.position)), moved())
    assert grid is not None
    assert grid.colored
    assert np.allclose(grid.scattering, grid.extinction, rtol=1e-5)
    made = baked(grid, 32).media
    assert made is not None
    off = np.abs(made.light[grid.receivers, :3].astype(float) ** 4 - 1)
    assert off.max() < 0.004


def test_light_on_media_is_read_from_disk_as_it_was(tmp_path):
    made = baked(fog((-1, -1, -1), (1, 1, 1), (3, 3, 3), 1.0, 0.5), 1)
    record_file.write(tmp_path / "light.psitem", made)
    found = record_file.read(tmp_path / "light.psitem", {one.__name__: one for one in (BakedLight, BakedMedia)})
    assert made.media is not None
    for name in ("low", "edge", "shape", "cells", "block", "light"):
        assert np.array_equal(getattr(found.media, name), getattr(made.media, name))


def test_smoke_that_light_does_not_look_at_is_drawn_as_without():
    """Where its object is not visible to diffuse rays, nothing is known of what falls on it."""
    case = under_smoke()
    scatters = np.array([one.cloud is None for one in case.scene.geometries])[case.scene.instances.geometry]
    blind = replace(case.scene, instances=replace(case.scene.instances, scatters=scatters))
    found = drawing.render(replace(case, scene=blind)).pixels["combined"]
    assert np.isfinite(found).all()
    assert found[..., :3].mean() > drawing.render(case).pixels["combined"][..., :3].mean()
