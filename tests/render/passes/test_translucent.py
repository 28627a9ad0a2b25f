"""Light through splats: closed forms, opaque things among them, and what is drawn and sorted when."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.volume import Medium, Volume
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.core.splat.kernel import PROFILES
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.cache.keys import Key, Kind
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.passes.translucent import lit_splats
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.separation import separate_translucent
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cases, clouds, drawing, meshes, translucent_cases
from scripts.scenes.build import moved, points
from scripts.scenes.cameras import camera
from scripts.scenes.case import ALL_PASSES
from scripts.scenes.store import STORE
from tests.support.transmittance import voxels

COMBINED = frozenset({"combined"})
WHITE = World(np.ones(3))


def draw(scene, eye_camera, samples=1, settings=None):
    return drawing.opengl().render(
        scene, Request(eye_camera, settings or Settings(technique="IMAGE_SPACE", use_shadows=False), COMBINED, samples)
    )


def picture(scene, eye_camera, samples=1, technique="IMAGE_SPACE"):
    settings = Settings(technique=technique, use_shadows=False)
    return draw(scene, eye_camera, samples, settings).pixels["combined"].astype(np.float64)


def alone(cloud, key, **more):
    return build.scene((points(key, cloud), moved()), **{"lights": (), "world": WHITE, **more})


def from_angle(degrees, distance=30.0, field=0.6):
    angle = np.radians(degrees)
    return camera((distance * np.sin(angle), -distance * np.cos(angle), 0), field_of_view=field, resolution=(16, 12))


# Closed forms


@pytest.mark.parametrize("cells", [6, 10, 16])
@pytest.mark.parametrize("angle", [0, 30, 55])
def test_a_slab_lets_as_much_light_through_as_beers_law_says(cells, angle):
    for depth in (0.01, 1.0, 5.0, 12.0, 20.0):
        cloud = voxels(2.4 if angle else 1.2, 0.5, cells, depth / 0.5 * np.cos(np.radians(angle)))
        mean = picture(alone(cloud, f"slab {cells} {angle} {depth}"), from_angle(angle), 4)[..., 0].mean()
        if depth <= 5:
            assert mean == pytest.approx(np.exp(-depth), rel=5e-3)
        assert -np.log(mean) == pytest.approx(depth, rel=5e-3)


@pytest.mark.parametrize(("parallel", "worst"), [(2.0, 6e-3), (None, 0.03)])
def test_smoke_begins_at_the_near_plane_wherever_that_cuts_it(parallel, worst):
    """An eye that flies through voxels sees them thin evenly. In perspective, splats at its nose are too thick: their
    pictures are Gaussians only from afar."""
    cloud, edge, ratio = voxels(4.0, 2.0, 10, 1.5), 0.2, []
    for place in np.arange(9) / 8:
        y = -0.3 + edge * place
        eye = camera((0, y, 0), (0, 5, 0), resolution=(16, 12), field_of_view=10, near=0.07, parallel=parallel)
        mean = picture(alone(cloud, "flown through"), eye, 4)[..., 0].mean()
        ratio.append(-np.log(mean) / (1.5 * (1 - y - 0.07)))
    assert np.ptp(ratio) < 0.01  # measured 0.0045; 0.1 and more where each splat is left out as a whole
    assert np.abs(np.array(ratio) - 1).max() < worst  # measured 0.0032 and 0.024


def test_halving_the_spacing_changes_no_radiance():
    light = Light("POINT", np.full(3, 20.0), np.array([0.5, -3.0, 1.0]), np.array([0.0, 0, -1]), shadow=False)
    inside = lambda p: (p**2).sum(axis=1) < 1  # noqa: E731
    means = []
    for cells in (20, 40):
        cloud = voxels(2, 2, cells, 1.5, inside, color=(0.9, 0.6, 0.3))
        made = alone(cloud, f"halved {cells}", lights=(light,), world=World(np.full(3, 0.2)))
        means.append(picture(made, camera(resolution=(40, 40)), 2)[..., :3].mean(axis=(0, 1)))
    np.testing.assert_allclose(means[0], means[1], rtol=1e-2)


def stacked(order, alphas, colors):
    """Squares of unlit emission one behind the other, and a grey world."""
    count = len(alphas)
    table = build.materials(
        count, base_color=np.zeros((count, 3)), specular=np.zeros(count), emission=colors, alpha=alphas,
        translucent=np.ones(count, bool),
    )  # fmt: skip
    things = []
    for place, row in enumerate(order):
        plane = replace(meshes.plane_mesh(f"stacked {row}"), materials=(row,), topology=f"stacked {row}")
        things.append((build.mesh(plane), moved((0, 0.3 * place, 0))))
    return build.scene(*things, lights=(), world=World(np.full(3, 0.5)), table=table)


@pytest.mark.parametrize("eye", [(0, -5, 0), (3, -4, 0.5)])
def test_stacked_planes_are_composited_in_the_order_of_their_distances(eye):
    alphas = np.array([0.3, 0.6, 0.85])
    colors = np.array([[1, 0.1, 0.1], [0.1, 1, 0.2], [0.2, 0.3, 1]])
    for order in permutations(range(3)):
        expected = np.full(3, 0.5)
        for row in order[::-1]:
            expected = expected * (1 - alphas[row]) + colors[row] * alphas[row]
        found = picture(stacked(order, alphas, colors), camera(eye, (0, 0.3, 0), field_of_view=8), 4)
        assert np.abs(found[..., :3] - expected).max() < 1 / 255
        assert found[..., 3].min() > 1 - 1e-5


def test_a_shell_hides_the_same_share_at_every_angle():
    alphas, colors = np.array([0.6]), np.zeros((1, 3))
    for angle in (0, 45, 75):
        eye = 5 * np.array([np.sin(np.radians(angle)), -np.cos(np.radians(angle)), 0])
        found = picture(stacked((0,), alphas, colors), camera(eye, field_of_view=3), 8)
        assert found[..., 0].mean() == pytest.approx(0.5 * 0.4, rel=5e-3)


def test_extinction_may_differ_between_the_channels():
    depth = np.array([0.2, 1.0, 3.0])
    found = picture(alone(voxels(1.2, 0.5, 8, depth / 0.5), "tinted"), from_angle(0), 2)
    np.testing.assert_allclose(found[..., :3].mean(axis=(0, 1)), np.exp(-depth), rtol=5e-3)


def test_what_only_emits_adds_its_radiance_along_the_ray():
    cloud = voxels(1.2, 0.5, 8, 0.0, emission=(1.0, 2.0, 0.5))
    found = picture(alone(cloud, "glow", world=World(np.full(3, 0.25))), from_angle(0), 4)
    np.testing.assert_allclose(found[..., :3].mean(axis=(0, 1)), 0.25 + 0.5 * np.array([1, 2, 0.5]), rtol=5e-3)


def test_what_emits_and_absorbs_tends_to_emission_over_extinction():
    cloud = voxels(1.2, 0.5, 12, 4.0, emission=(2.0, 2.0, 2.0))
    found = picture(alone(cloud, "fire", world=World()), from_angle(0), 4)
    assert found[..., :3].mean() == pytest.approx(0.5 * (1 - np.exp(-2.0)), rel=5e-3)


@pytest.mark.parametrize("g", [0.0, 0.6, -0.5])
@pytest.mark.parametrize("angle", [0, 60])
def test_a_thin_medium_scatters_by_henyey_and_greenstein(g, angle):
    depth, albedo = 0.5, np.array([0.9, 0.5, 0.2])
    sun = replace(build.sun(3.0, (0, 1, 0)), shadow=False)
    made = alone(
        voxels(2.4, 0.5, 8, depth / 0.5 * np.cos(np.radians(angle)), color=albedo), f"scattering {angle}",
        lights=(sun,), world=World(), table=build.materials(anisotropy=np.array([g], np.float32)),
    )  # fmt: skip
    found = picture(made, from_angle(angle), 2)[..., :3].mean(axis=(0, 1))
    cosine = -np.cos(np.radians(angle))  # the sun shines along +Y, and light reaches the eye along about -Y
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cosine) ** 1.5)
    np.testing.assert_allclose(found, 3.0 * albedo * phase * (1 - np.exp(-depth)), rtol=1e-2)


# Among opaque things


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "VISIBILITY"])
@pytest.mark.parametrize("primitive", ["POLYGONS", "POINTS"])
@pytest.mark.parametrize("place", [-0.2, 0.0, 0.125])
def test_what_is_opaque_hides_what_of_a_medium_lies_behind_it(technique, primitive, place):
    depth = 2.0
    wall = build.mesh(meshes.plane_mesh(f"wall {primitive}", 1.5), primitive)
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.ones((1, 3)))
    made = build.scene(
        (wall, moved((0, place, 0))), (points("fog", voxels(1.2, 0.5, 12, depth / 0.5)), moved()),
        lights=(), world=World(), table=table,
    )  # fmt: skip
    found = picture(made, from_angle(0), 2, technique)
    assert found[..., 0].mean() == pytest.approx(np.exp(-depth * (0.25 + place) / 0.5), rel=1e-2)


def test_a_camera_within_a_medium_sees_what_lies_in_front():
    depth = 2.0
    made = alone(voxels(1.6, 1.0, 16, depth), "fog around the eye")
    found = picture(made, camera((0, 0, 0), (0, 1, 0), field_of_view=10, near=1e-3), 4)
    assert np.isfinite(found).all()
    assert found[..., 0].mean() == pytest.approx(np.exp(-depth / 2), rel=2e-2)


def test_a_transparent_film_is_covered_by_what_the_medium_hides():
    found = picture(alone(voxels(1.2, 0.5, 8, 2.0), "on film", transparent=True), from_angle(0), 2)
    assert found[..., 3].mean() == pytest.approx(1 - np.exp(-1.0), rel=5e-3)


@pytest.mark.parametrize("strength", [1e-30, 1e6, np.nan, np.inf, -1.0])
def test_media_out_of_all_proportion_are_finite(strength):
    cloud = voxels(0.4, 0.4, 4, 1.0, color=(0.5, 0.5, 0.5))
    assert cloud.extinction is not None
    odd = cloud.extinction.copy()
    odd[::3] = strength
    made = alone(replace(cloud, extinction=odd), f"odd {strength}", lights=(build.sun(),))
    found = picture(made, camera())
    assert np.isfinite(found).all()
    assert found.min() >= 0
    assert found[..., 3].max() <= 1 + 1e-6


@pytest.mark.parametrize("scale", [1e-6, 1e4])
def test_voxels_of_any_size_let_the_same_light_through(scale):
    """Extinction is per object unit: under a scaled instance it stays what it is across the object."""
    cloud = voxels(1.2, 0.5, 8, 2.0)
    scaled = build.scene((points("scaled", cloud), moved(scale=scale)), lights=(), world=WHITE)
    eye = camera((0, -30 * scale, 0), field_of_view=0.6, resolution=(16, 12), near=1e-2 * scale, far=1e3 * scale)
    assert picture(scaled, eye, 2)[..., 0].mean() == pytest.approx(np.exp(-1.0), rel=5e-3)


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "VISIBILITY"])
@pytest.mark.parametrize("primitive", ["", "POLYGONS", "POINTS"])
@pytest.mark.parametrize("depth", [1.0, np.array([0.2, 1.0, 3.0])])
def test_a_medium_that_holds_out_takes_of_color_and_alpha_what_it_hides(technique, depth, primitive):
    """Before glow, or an opaque wall; and behind other glow, of which it takes nothing."""
    behind = points("glow behind", voxels(1.2, 0.5, 8, 2.0, emission=(2.0, 2.0, 2.0)))
    if primitive:
        behind = build.mesh(meshes.plane_mesh(f"wall behind {primitive}", 1.5), primitive)
    things = [
        (points("glow before", voxels(1.2, 0.5, 8, 1.0, emission=(3.0, 3.0, 3.0))), moved((0, -1, 0))),
        (points(f"hole {np.size(depth)}", voxels(1.2, 0.5, 8, depth / 0.5, emission=(9.0, 9.0, 9.0))), moved()),
        (behind, moved((0, 1, 0))),
    ]
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0], emission=np.ones((1, 3)))

    def mean(which, holdout):
        made = build.scene(
            *(things[i] for i in which), lights=(), world=World(), table=table, transparent=True, holdout=holdout
        )
        return picture(made, from_angle(0), 2, technique).mean(axis=(0, 1))

    before, after = mean([0], None), mean([2], None)
    through = np.exp(-depth * np.ones(3))
    expected = before[:3] + (1 - before[3]) * through * after[:3]
    found = mean([0, 1, 2], [False, True, False])
    np.testing.assert_allclose(found[:3], expected, rtol=5e-3)
    # Alpha is the second channel's, the green one's.
    assert found[3] == pytest.approx(before[3] + (1 - before[3]) * through[1] * after[3], rel=5e-3)


def test_holdouts_cost_only_where_they_are_translucent():
    fog, ball = (points("fog held", voxels(1, 1, 4)), moved()), (points("ball", clouds.sphere_cloud(50)), moved())
    for holdout, cut in (([True, False], True), ([False, True], False)):
        device, _ = record(build.scene(fog, ball, holdout=holdout, transparent=True))
        assert ("ps_cut" in {name for i in device.interfaces for _, name in i.samplers}) == cut


# Shadows

LAMP = Light("POINT", np.full(3, 50.0), np.array([0.0, 0.0, 3.0]), np.array([0.0, 0, -1]))


def lit_floor(*things, lamp=LAMP, table=None):
    """A floor below `things`, lit by a lamp above them and nothing else."""
    level = np.eye(4)
    level[1:3, 1:3] = [[0, -1], [1, 0]]
    level[2, 3] = -1
    floor = build.mesh(meshes.plane_mesh("floor", 2.0), "POLYGONS")
    return build.scene((floor, level), *things, lights=(lamp,), world=World(), table=table)


def shaded(made, shadows=True):
    """The middle of the floor, seen from below the things."""
    low = camera((0.0, -1.5, -0.75), (0, 0, -1), field_of_view=6, resolution=(16, 12))
    settings = Settings(technique="IMAGE_SPACE", use_shadows=shadows, shadow_resolution=512)
    return draw(made, low, 2, settings).pixels["combined"][..., :3].mean(axis=(0, 1)).astype(np.float64)


@pytest.mark.parametrize("depth", [0.05, 1.0, 4.0])
def test_a_medium_shades_the_floor_by_beers_law(depth):
    fog = points(f"fog {depth}", voxels(1.5, 0.5, 10, depth / 0.5))
    turned = np.eye(4)
    turned[1:3, 1:3] = [[0, -1], [1, 0]]
    made = lit_floor((fog, turned))
    assert -np.log(shaded(made) / shaded(made, False)) == pytest.approx(depth * np.ones(3), rel=2e-2)  # measured 0.9 %


def test_shadows_of_tinted_media_are_tinted():
    depth = np.array([0.2, 1.0, 3.0])
    turned = np.eye(4)
    turned[1:3, 1:3] = [[0, -1], [1, 0]]
    made = lit_floor((points("tinted fog", voxels(1.5, 0.5, 10, depth / 0.5)), turned))
    np.testing.assert_allclose(-np.log(shaded(made) / shaded(made, False)), depth, rtol=2e-2)  # measured 0.9 %


@pytest.mark.parametrize("primitive", ["POLYGONS", "POINTS"])
def test_opaque_things_cast_whatever_they_are_drawn_as(primitive):
    block = build.mesh(meshes.cube_mesh(f"block {primitive}", 0.5), primitive)
    made = lit_floor((block, moved((0, 0, 0.5))))
    assert shaded(made).max() < 1e-6  # measured 5e-10
    assert shaded(made, False).min() > 0.05
    aside = replace(made, instances=replace(made.instances, casts=np.array([True, False])))
    np.testing.assert_allclose(shaded(aside), shaded(aside, False), rtol=1e-6)


def test_a_translucent_surface_shades_by_its_alpha():
    table = build.materials(2, alpha=[1, 0.7], translucent=np.array([False, True]))
    pane = replace(meshes.plane_mesh("pane", 1.0), materials=(1,))
    level = np.eye(4)
    level[1:3, 1:3] = [[0, -1], [1, 0]]
    made = lit_floor((build.mesh(pane), level), table=table)
    np.testing.assert_allclose(shaded(made) / shaded(made, False), np.full(3, 0.3), rtol=2e-2)


def test_a_medium_shades_itself():
    """Seen from the lamp's side and thin across the ray: single scattering of light that has come through."""
    depth, albedo = 2.0, 0.8
    sun = build.sun(3.0, (0, 1, 0))
    made = alone(voxels(1.2, 0.5, 12, depth / 0.5, color=np.full(3, albedo)), "self", lights=(sun,), world=World())
    found = (
        draw(made, from_angle(0), 2, Settings(technique="IMAGE_SPACE", shadow_resolution=256))
        .pixels["combined"][..., :3]
        .mean()
    )
    # The light that comes to a depth t of the medium and back is exp(-2 t).
    expected = 3.0 * albedo / (4 * np.pi) * (1 - np.exp(-2 * depth)) / 2
    assert found == pytest.approx(expected, rel=2e-2)


def test_what_reaches_a_splat_is_the_same_whether_it_is_kept_or_not():
    fog = points("fog kept", voxels(1.0, 0.5, 6, 3.0, color=(0.5, 0.7, 0.9)))
    lamps = [replace(LAMP, position=np.array([0.3 * i, -2.0, 1.0])) for i in range(5)]
    made = [lit_floor((fog, moved())), lit_floor((fog, moved()))]
    made = [replace(one, lights=tuple(lights)) for one, lights in zip(made, (lamps[:4], lamps), strict=True)]
    made[1] = replace(made[1], lights=(*lamps[:4], replace(lamps[4], color=np.zeros(3))))
    kept, looked_up = (
        draw(one, camera(), 1, Settings(technique="IMAGE_SPACE", shadow_resolution=64)).pixels["combined"]
        for one in made
    )
    assert np.abs(kept - looked_up).max() < 2e-3 * kept.max()  # half floats


def test_tables_are_made_once_for_all_views():
    made = lit_floor((points("fog once", voxels(1.5, 0.5, 6, 1.0)), moved()))
    device = NullDevice()
    renderer = Renderer(device, STORE)
    tables = []
    for eye in ((0, -4, 0), (2, -3, 1)):
        renderer.render(made, Request(camera(eye), Settings(technique="IMAGE_SPACE"), COMBINED, 1))
        call = next(c for c in device.calls[::-1] if c.interface.name == "light")
        tables.append(call.textures["ps_shadow_tables"])
    assert tables[0] is tables[1]
    assert device.names.count("reach") == 1  # nor is it looked up again what reaches each splat
    brighter = replace(made, lights=(replace(LAMP, color=np.full(3, 9.0)),))
    renderer.render(brighter, Request(camera(), Settings(technique="IMAGE_SPACE"), COMBINED, 1))
    call = next(c for c in device.calls[::-1] if c.interface.name == "light")
    assert call.textures["ps_shadow_tables"] is tables[0]


@pytest.mark.parametrize(
    ("why", "change"),
    [
        ("shadows are switched off", {}),
        ("no light casts shadows", {"lights": (replace(LAMP, shadow=False),)}),
        ("nothing casts shadows", {"casts": np.zeros(2, bool)}),
    ],
)
def test_no_table_is_made_where_nothing_shades(why, change):
    made = lit_floor((points("fog unshaded", voxels(1.5, 0.5, 4, 1.0)), moved()))
    casts = change.pop("casts", None)
    made = replace(made, instances=replace(made.instances, casts=casts), **change)
    device, result = record(made, shadows=why != "shadows are switched off")
    assert {entry["name"]: entry["because"] for entry in result.report["skipped"]}["shadows"] == why
    names = {name for i in device.interfaces for _, name in i.samplers}
    assert not {"ps_shadow_tables", "ps_shadow_lights"} & names


# Kernels of other shapes


def blob(key, row, extinction=0.002, **more):
    """One ball of a thin medium, of a kernel; None: no attribute."""
    kernel = None if row is None else np.array([row], np.uint8)
    cloud = PointCloud(
        np.zeros((1, 3), np.float32), radii=np.full((1, 1), 0.5, np.float32), color=np.zeros((1, 3), np.float32),
        extinction=np.full(1, extinction, np.float32), kernel=kernel,
    )  # fmt: skip
    return alone(cloud, f"{key} {row} {extinction}", transparent=True)


def taken(made, eye_camera=None, samples=1):
    """Optical depths."""
    return -np.log1p(-picture(made, eye_camera or camera((0, -4, 0), resolution=(96, 96)), samples)[..., 3])


@pytest.mark.parametrize("row", range(len(PROFILES)))
def test_kernels_of_all_shapes_weigh_the_same(row):
    plain, shaped = taken(blob("blob", None), samples=16), taken(blob("blob", row), samples=16)
    assert shaped.sum() == pytest.approx(plain.sum(), rel=5e-4)  # measured 1.3e-4


def test_kernels_have_the_shapes_that_their_names_say():
    default, disk, ring, spark = (taken(blob("blob", row), samples=4) for row in range(4))
    middle = slice(46, 50)
    assert ring[middle, middle].max() < 1e-3 * ring.max()
    assert spark[middle, middle].mean() > 2 * default[middle, middle].mean()
    # A disk is even over half of its radius and more: 0.87 units wide here, of which 96 pixels see 2.9.
    assert np.ptp(disk[48, 39:57]) < 1e-3 * disk.max()
    assert np.ptp(default[48, 39:57]) > 0.2 * default.max()


@pytest.mark.parametrize("row", range(len(PROFILES)))
def test_splats_below_a_pixel_weigh_the_same_whatever_their_kernels(row):
    far = camera((0, -300, 0), resolution=(24, 24), far=1e3)
    plain, shaped = taken(blob("far blob", None, 1.0), far, 16), taken(blob("far blob", row, 1.0), far, 16)
    assert shaped.sum() == pytest.approx(plain.sum(), rel=1e-3)  # measured 1.4e-4


def test_kernels_cost_only_where_points_have_them():
    def used(row):
        device, _ = record(blob("costs", row))
        names = {name for i in device.interfaces for _, name in i.samplers}
        defined = {name for i in device.interfaces for name, _ in i.defines}
        return "ps_profiles" in names, "PS_KERNELS" in defined, (PROFILES.shape[1], len(PROFILES)) in {
            texture.size for texture in device.textures
        }  # fmt: skip

    assert used(None) == (False, False, False)
    assert used(2) == (True, True, True)


# What is drawn


def record(made, eye_camera=None, passes=COMBINED, samples=1, shadows=False):
    device = NullDevice()
    settings = Settings(technique="IMAGE_SPACE", use_shadows=shadows)
    result = Renderer(device, STORE).render(made, Request(eye_camera or camera(), settings, passes, samples))
    return device, result


@pytest.mark.parametrize("name", cases.CASES)
def test_scenes_with_nothing_translucent_sort_and_composite_nothing(name):
    case = cases.CASES[name]()
    if separate_translucent(case.scene, Store())[0] is case.scene and not any(
        g.captured is not None
        or (g.cloud is not None and (g.cloud.opacity is not None or g.cloud.extinction is not None))
        for g in case.scene.geometries
    ):
        device, result = record(case.scene, case.camera, ALL_PASSES, 2)
        assert not {"light", "translucent", "add", "opaque depth"} & set(device.names)
        assert {"order", "light", "translucent", "add"} <= {entry["name"] for entry in result.report["skipped"]}
        # As many pictures as before: the sums alone.
        assert all("layer" not in name for i in device.interfaces for _, name in i.samplers)


@pytest.mark.parametrize("technique", ["IMAGE_SPACE", "VISIBILITY"])
@pytest.mark.parametrize("distance", [3.0, 9.0])
def test_points_show_what_triangles_do(technique, distance, monkeypatch):
    """Small splats, some of which the picture's edges cut, before a wall and behind it: to the bit."""
    smoke = points("points or triangles", voxels(1.2, 0.5, 24, 2.0, emission=(2.0, 1.0, 0.5)))
    wall = build.mesh(meshes.plane_mesh("wall among points", 1.5), "POLYGONS")
    made = build.scene((smoke, moved()), (wall, moved((0, 0.1, 0))), lights=(build.sun(),), world=WHITE)
    eye = camera((0.4 * distance, -distance, 0.3), (0.5, 0, 0.2), field_of_view=14, resolution=(40, 30))
    drawn = []
    for widest in (lit_splats.WIDEST_POINT, 0):
        monkeypatch.setattr(lit_splats, "WIDEST_POINT", widest)
        drawn.append(picture(made, eye, 16, technique))
    assert drawn[0][..., :3].std() > 0.05
    np.testing.assert_array_equal(*drawn)


def test_what_is_translucent_is_lit_once_and_drawn_for_every_sample():
    device, _ = record(alone(voxels(1, 1, 4), "drawn"), samples=3)
    assert [device.names.count(name) for name in ("light", "translucent", "add", "opaque depth")] == [1, 3, 3, 0]
    draw = next(call for call in device.calls if call.interface.name == "translucent")
    assert draw.flags == {"over"}
    assert draw.count == 64  # points, of so small splats


def test_a_view_that_moves_shows_a_coarse_layer_first():
    case = translucent_cases.smoke()
    request = Request(case.camera, case.settings, COMBINED, 3, interactive=True)
    device = NullDevice()
    Renderer(device, STORE).render(case.scene, request)
    drawn = [call.target for call in device.calls if call.interface.name == "translucent" and call.target]
    sizes = [target.colors[0].size for target in drawn]
    assert sizes[0] == tuple(-(-side // 2) for side in sizes[1])
    assert sizes[1] == sizes[2]
    assert device.names.count("enlarge") == 1
    # And it is the same light, spread over a pixel and a half more; measured 10 % at the lamp, and 0.2 % in the mean.
    alone = replace(
        case.scene,
        instances=replace(case.scene.instances, world_from_object=np.stack([moved(), *2 * [moved(scale=0)]])),
    )
    first = [
        drawing.opengl().render(alone, replace(request, samples=1, interactive=moving)).pixels["combined"]
        for moving in (False, True)
    ]
    assert np.abs(first[0] - first[1]).max() < 0.15 * first[0].max()
    np.testing.assert_allclose(first[0].mean(axis=(0, 1)), first[1].mean(axis=(0, 1)), rtol=5e-3)


def test_coloured_extinction_alone_is_drawn_by_channel():
    grey, _ = record(alone(voxels(1, 1, 4), "grey"))
    tinted, _ = record(alone(voxels(1, 1, 4, np.array([1.0, 2, 3])), "three channels"))
    masks = [[c.mask for c in d.calls if c.interface.name == "translucent"] for d in (grey, tinted)]
    assert masks == [["RGBA"], ["R", "GA", "B"]]


def test_splats_are_sorted_again_only_for_other_directions():
    renderer, made = Renderer(NullDevice(), STORE), alone(voxels(1, 1, 8), "sorted")
    sorts = []
    for eye, target in (
        ((0, -4, 0), (0, 0, 0)),
        ((0, -3, 0), (0, 0, 0)),
        ((1, -3, 0), (1, 0, 0)),
        ((3, -3, 0), (0, 0, 0)),
    ):
        renderer.render(made, Request(camera(eye, target), Settings(technique="IMAGE_SPACE"), COMBINED, 1))
        sorts.append(renderer.kept.lookup(Key(Kind.DRAW_ORDER, 0), lambda: None).sorts)
    assert sorts == [1, 1, 1, 2]


def test_a_mesh_of_two_materials_is_drawn_in_two_ways():
    cube = meshes.cube_mesh("half glass")
    rows = np.repeat(np.array([0, 1], np.uint16), 6)
    table = build.materials(2, alpha=[1, 0.5], translucent=np.array([False, True]))
    made = build.scene((build.mesh(replace(cube, material=rows, materials=(0, 1))), moved()), table=table)
    device, result = record(made, passes=ALL_PASSES)
    assert {"polygons", "light", "translucent"} <= set(device.names)
    assert result.report["triangles"] == 6
    assert result.report["points"]["total"] > 0


def test_a_volume_is_drawn_as_translucent_points():
    index = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), -1).reshape(-1, 3).astype(np.int32)
    volume = Volume("v", "v", index, np.diag([0.25, 0.25, 0.25, 1.0]), {"density": np.ones(64, np.float32)})
    geometry = replace(points("v", voxels(1, 1, 1)), cloud=None, volume=volume)
    table = replace(build.materials(), media=(Medium(),))
    _, result = record(build.scene((geometry, moved()), table=table))
    assert result.report["points"]["total"] == 64


@pytest.mark.parametrize(("alpha", "technique"), [(0.3, "IMAGE_SPACE"), (0.9, "IMAGE_SPACE"), (0.3, "VISIBILITY")])
def test_cards_let_as_much_light_through_as_coarse_nodes_of_them(alpha, technique):
    """As leaves do: cards that face all ways, whose nodes are thick."""
    rng = np.random.default_rng(3)
    count = 20_000
    normal = rng.normal(size=(count, 3))
    cards = PointCloud(
        rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        normal=(normal / np.linalg.norm(normal, axis=1, keepdims=True)).astype(np.float32),
        radii=np.full((count, 1), 0.03, np.float32),
        opacity=np.full(count, alpha, np.float32),
        color=np.zeros((count, 3), np.float32),
    )
    made = alone(cards, f"cards {alpha}", table=build.materials(1, specular=[0]))
    seen = {}
    for tolerance in (0.05, 4.0, 8.0):
        # So many samples that a hierarchy pays for itself.
        settings = Settings(technique=technique, tolerance=tolerance, use_shadows=False)
        result = draw(made, camera((0, -6, 0), resolution=(48, 48)), 96, settings)
        seen[result.report["points"]["cut"]] = result.pixels["combined"][..., 0].mean()
    every, fine, coarse = sorted(seen, reverse=True)
    assert every == count
    assert fine < count / 4
    assert coarse < count / 30
    assert seen[fine] == pytest.approx(seen[every], abs=0.005)  # measured 0.003
    assert seen[coarse] == pytest.approx(seen[every], abs=0.005)  # measured 0.003
