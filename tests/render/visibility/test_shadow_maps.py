"""Shadows by depth maps: where their edges lie, that surfaces do not shade themselves, and what is left to tables."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, clouds, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import opengl, render

COMBINED = frozenset({"combined"})
DOWN = np.array([0.0, 0.0, -1.0])
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright
KEPT = "those of an earlier picture still hold"
TECHNIQUES = "VISIBILITY", "IMAGE_SPACE"
ABOVE = Light("POINT", np.full(3, 30.0), np.array([0.2, 0.0, 2.0]), DOWN)


def seen(*things, light: Light, eye=(0.0, -4.0, 2.5), technique: str = "VISIBILITY", **more) -> Case:
    settings = Settings(technique=technique, use_adaptive_sampling=False)
    camera = cameras.camera(eye, resolution=(96, 72), **more)
    return Case(build.scene(*things, lights=[light]), camera, settings)


def picture(case: Case, samples: int = 16) -> np.ndarray:
    return render(case, COMBINED, samples).pixels["combined"][..., 0].astype(float)


def share(case: Case) -> np.ndarray:
    """Of the light that is there without shadows; NaN where there is none."""
    without = picture(replace(case, settings=replace(case.settings, use_shadows=False)))
    ambient = picture(replace(case, scene=replace(case.scene, lights=())))
    with np.errstate(all="ignore"):
        return np.where(without - ambient > 1e-3, (picture(case) - ambient) / (without - ambient), np.nan)


def shadows_of(case: Case) -> set[str]:
    """What casts the shadows of a picture."""
    report = render(case, COMBINED).report
    kept = {entry["name"] for entry in report["skipped"] if entry["because"] == KEPT}
    return {"shadows", "shadow maps"} & ({entry["name"] for entry in report["passes"]} | kept)


def floor(size: float = 4.0):
    return build.mesh(meshes.plane_mesh(f"floor of {size}", size), "POLYGONS"), LAID


def card(edge: float):
    """A wide card at height 0.5 that ends at x = `edge`."""
    corners = np.array([[-8, -8, 0.5], [edge, -8, 0.5], [edge, 8, 0.5], [-8, 8, 0.5]], np.float32)
    made = meshes.flat_mesh(f"card to {edge}", corners, np.array([[0, 1, 2], [0, 2, 3]]))
    return build.mesh(made, "POLYGONS"), build.moved()


def small_card(edge: float, wide: float):
    """A square card at height 0.5 that ends at x = `edge`."""
    low, half = edge - wide, wide / 2
    corners = np.array([[low, -half, 0.5], [edge, -half, 0.5], [edge, half, 0.5], [low, half, 0.5]], np.float32)
    made = meshes.flat_mesh(f"card of {wide} to {edge}", corners, np.array([[0, 1, 2], [0, 2, 3]]))
    return build.mesh(made, "POLYGONS"), build.moved()


SIDES = np.array([[0.2, 0.0, 0.0], [0.0, 0.2, 0.0]])
DISK = replace(ABOVE, kind="AREA", color=np.full(3, 300.0), axis_u=SIDES[0], axis_v=SIDES[1], ellipse=True)
WIDE = {
    "disk": DISK,
    "square": replace(DISK, ellipse=False),
    "lamp": replace(ABOVE, radius=0.2),
    "sun": replace(build.sun(3.0, (0.0, 0.0, -1.0)), radius=float(np.arctan(0.1))),
}


def visible_share(name: str, inside: np.ndarray, at: np.ndarray) -> np.ndarray:
    """(N,) of the irradiance at places of the floor, x = at (N,), where the light is seen from -inside (N,) of its
    extent on. Flat lights give by the fourth power of the distance, by Lambert's law; a lamp's disk faces the floor."""
    side = (np.arange(1000) + 0.5) / 500 - 1
    u, v = side[:, None], side[::5]
    weight = np.ones((len(u), len(v))) * ((np.hypot(u, v) <= 1) | (name == "square"))
    if name == "sun":
        given = np.broadcast_to(weight.sum(axis=1), (len(at), len(u)))
    else:
        square = (0.2 + 0.2 * u - at[:, None, None]) ** 2 + (0.2 * v) ** 2 + 4
        given = (weight * square ** (-1.5 if name == "lamp" else -2)).sum(axis=2)
    seen = np.cumsum(given[:, ::-1], axis=1) / given.sum(axis=1, keepdims=True)
    edges = (np.arange(len(u)) + 1) / 500 - 1
    return np.array([np.interp(x, edges, row, left=0) for x, row in zip(inside, seen, strict=True)])


@pytest.mark.parametrize("name", WIDE)
@pytest.mark.parametrize("wide", [2.0, 4.0])
def test_the_penumbra_of_a_straight_edge_is_the_visible_share_of_the_light(name, wide):
    """By what its points give: the light's middle is above x = 0.2 at height 2, and it reaches 0.2 to each side; the
    sun's middle is overhead."""
    edge, above, width = 0.1, 0.3, 160
    middle, half = (edge, 0.5 * 0.1) if name == "sun" else (0.2 + (edge - 0.2) * 4 / 3, 0.2 * 0.5 / 1.5)
    case = seen(floor(), small_card(edge, wide), light=WIDE[name])
    camera = cameras.camera((middle, -1e-4, above), (middle, 0, 0), resolution=(width, 32), near=0.01)
    case = replace(case, camera=camera)
    assert shadows_of(case) == {"shadow maps"}
    across = 2 * above * np.tan(np.radians(20))
    part = ((np.arange(width) + 0.5) / width - 0.5) * across / half
    error = np.nanmean(share(case), axis=0) - visible_share(name, np.clip(part, -1, 1), middle + half * part)
    assert np.sqrt((error**2).mean()) < 0.01  # measured at most 0.0097 (a lamp above a card of 4)
    assert np.abs(error).max() < 0.025  # measured at most 0.0249 (a square)
    assert abs(error.mean()) < 8e-3  # measured at most 0.0057


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize("edge", [0.03, 0.1, -0.17])
def test_the_shadow_of_a_straight_edge_lies_where_it_must(technique, edge):
    """Seen from between the card and the floor; the light's height is 2, so that the edge's shadow lies at 4/3."""
    light = replace(ABOVE, position=np.array([0.2, 0.0, 2.0]))
    shadow = 0.2 + (edge - 0.2) * 4 / 3
    case = seen(floor(), card(edge), light=light, eye=(shadow, -1e-3, 0.45), technique=technique, near=0.01)
    case = replace(case, camera=cameras.camera((shadow, -1e-3, 0.45), (shadow, 0, 0), resolution=(96, 72), near=0.01))
    assert shadows_of(case) == {"shadow maps"}
    lit = np.nanmean(share(case), axis=1)
    across = 2 * 0.45 * np.tan(np.radians(20))
    assert np.abs(lit - 0.5).max() * across < 1e-3  # measured at most 6.4e-4, a fifth of a pixel
    assert abs(lit.mean() - 0.5) * across < 1e-3  # measured at most 6.4e-4


@pytest.mark.parametrize("technique", TECHNIQUES)
@pytest.mark.parametrize(
    "light",
    [ABOVE, build.sun(3.0, (0.3, 0.4, -1.0)), replace(ABOVE, radius=0.3), DISK],
    ids=["point", "sun", "lamp", "disk"],
)
def test_what_nothing_shades_does_not_shade_itself(technique, light):
    """A ball of triangles, a bowl, which is hollow toward the light, and balls, each alone."""
    smooth = build.mesh(meshes.sphere_mesh("ball that is lit", 48), "POLYGONS"), build.moved((0, 0, 0), 0.8)
    lone = build.points(
        "lone ball", replace(clouds.sphere_cloud(1), normal=None, radii=np.full((1, 1), 0.5, np.float32))
    )
    for thing in (smooth, (lone, build.moved((0, 0, -1)))):
        toward = np.nan_to_num(share(seen(thing, light=light, technique=technique)), nan=1.0)
        lit = picture(seen(thing, light=light, technique=technique))
        bright = lit > 0.3 * lit.max()
        assert toward[bright].min() > 0.999  # measured 1 but for rounding


@pytest.mark.parametrize("name", WIDE)
def test_normals_that_lean_do_not_make_a_surface_shade_itself(name):
    """A plane whose corners' normals are bent by 40 degrees, as those of a leaf; below it lies what it shades, so that
    it casts."""
    flat = meshes.plane_mesh(f"leaf under a {name}", 1.0, cells=8)
    a, b, c = flat.position[flat.triangles[0]]
    own = np.cross(b - a, c - a)
    leaning = np.cos(0.7) * own / np.linalg.norm(own) + [np.sin(0.7), 0, 0]
    leaning = np.broadcast_to(leaning.astype(np.float32), (len(flat.position), 3))
    leaf = build.mesh(replace(flat, vertex_normal=leaning, corner_normal=None), "POLYGONS"), LAID
    below = build.mesh(meshes.sphere_mesh("what a leaf hides", 12), "POLYGONS"), build.moved((0, 0, -0.5), 0.1)
    case = seen(leaf, below, light=WIDE[name])
    close = cameras.camera((0, -0.03, 0.02), (0, 0, 0), resolution=(96, 72), near=1e-3)  # texels are wider than pixels
    lit = share(replace(case, camera=close))
    assert np.nanmin(lit) > 0.999  # measured 1 but for rounding


def test_lights_of_different_size_add_up():
    """A narrow sun and a wide lamp are seen from different numbers of points."""
    ball = build.mesh(meshes.sphere_mesh("ball of two lights", 48), "POLYGONS"), build.moved((0, 0, 0.6), 0.4)
    narrow, wide = replace(build.sun(1.0, (0.3, 0.4, -1.0)), radius=0.01), replace(ABOVE, radius=0.2)
    case = seen(floor(), ball, light=wide)
    dark = World(np.zeros(3))  # the spread of normals, which is for lights alone, changes that of one colour by 0.2 %
    *alone, both = (
        picture(replace(case, scene=replace(case.scene, lights=lights, world=dark)))
        for lights in ((narrow,), (wide,), (narrow, wide))
    )
    assert np.abs(both - alone[0] - alone[1]).max() < 1e-5 * both.max()


def test_tables_are_for_what_light_passes():
    ball = build.mesh(meshes.sphere_mesh("ball of tables", 24), "POLYGONS"), build.moved((0, 0, 0.6), 0.4)
    smoke = build.points("smoke of tables", clouds.smoke_cloud()), build.moved((1, 0, 1), 0.3)
    sharp, wide = ABOVE, replace(ABOVE, radius=0.2)
    assert shadows_of(seen(floor(), ball, light=sharp)) == {"shadow maps"}
    assert shadows_of(seen(floor(), ball, light=wide)) == {"shadow maps"}
    assert shadows_of(seen(floor(), ball, smoke, light=sharp)) == {"shadows", "shadow maps"}


def test_maps_stay_where_they_are_when_the_camera_moves():
    ball = build.mesh(meshes.sphere_mesh("ball of kept maps", 24), "POLYGONS"), build.moved((0, 0, 0.6), 0.4)
    renderer = Renderer(opengl().device)
    passes = []
    for eye in ((0.0, -4.0, 2.5), (1.0, -4.0, 2.0)):
        case = seen(floor(), ball, light=ABOVE, eye=eye)
        report = renderer.render(case.scene, case.request(COMBINED, 16)).report
        passes.append({entry["name"] for entry in report["passes"]})
        skipped = {entry["name"]: entry["because"] for entry in report["skipped"]}
    renderer.release()
    assert "shadow maps" in passes[0]
    assert "shadow maps" not in passes[1]
    assert skipped["shadow maps"] == KEPT
    assert skipped["shadows"] == "depth maps show all that casts"


def test_without_image_atomics_shadows_are_the_same(monkeypatch):
    scan = clouds.sphere_cloud(2000)
    scan = (
        build.points("scan in a light", replace(scan, normal=None, radii=np.full((2000, 1), 0.05, np.float32))),
        build.moved((0, 0, 0.6), 0.5),
    )
    case = seen(floor(), scan, light=ABOVE)
    found = []
    for atomics in (True, False):
        device = opengl().device
        monkeypatch.setattr(device, "limits", replace(device.limits, image_atomics=atomics))
        renderer = Renderer(device)
        found.append(renderer.render(case.scene, case.request(COMBINED, 16)).pixels["combined"][..., 0].astype(float))
        renderer.release()
    assert np.sqrt(((found[0] - found[1]) ** 2).mean()) < 1e-6  # measured 0


def test_light_among_balls_is_that_of_rays():
    """A layer of balls that touch, under a sun: the share of its light that the balls seen from above receive."""
    cells, spacing = 24, 2.0
    x, y = np.meshgrid(np.arange(cells) - cells / 2 + 0.5, np.arange(cells) - cells / 2 + 0.5)
    centre = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1) * spacing
    cloud = replace(
        clouds.sphere_cloud(x.size),
        position=centre.astype(np.float32), normal=None, radii=np.full((x.size, 1), 1.0, np.float32),
    )  # fmt: skip
    direction = np.array([0.8, 0.0, -0.6])
    light = Light("SUN", np.full(3, 3.0), np.zeros(3), direction)
    width = 8.0
    case = seen((build.points("layer", cloud), build.moved()), light=light)
    case = replace(case, camera=cameras.camera((0, -1e-6, 20), (0, 0, 0), resolution=(64, 64), parallel=width, far=50))
    # Rays straight down onto the balls, and from there to the sun.
    u = (np.arange(512) + 0.5) / 512 * width - width / 2
    px, py = (a.ravel() for a in np.meshgrid(u, u))
    offset = np.stack([px - np.round((px - 1) / 2) * 2 - 1, py - np.round((py - 1) / 2) * 2 - 1])
    height2 = 1 - (offset**2).sum(axis=0)
    on = height2 > 0
    point = np.stack([px[on], py[on], np.sqrt(height2[on])], axis=1)
    normal = np.stack([offset[0, on], offset[1, on], point[:, 2]], axis=1)
    cosine = -normal @ direction
    free = cosine > 0
    for dx in range(-4, 1):
        for dy in (-2, 0, 2):
            other = point - normal + [2 * dx, dy, 0] - point  # centres of neighbours from the point
            along = other @ -direction
            apart = (other**2).sum(axis=1) - along**2
            itself = dx == 0 and dy == 0
            free &= itself | ~((along > 0) & (apart < 1 - 1e-9))
    expected = np.sum(np.where(free, cosine, 0)) / len(px)
    unlit = picture(replace(case, scene=replace(case.scene, lights=())))
    without = picture(replace(case, settings=replace(case.settings, use_shadows=False))) - unlit
    found = (picture(case) - unlit).mean() / without.mean() * np.maximum(cosine, 0).sum() / len(px)
    assert abs(found / expected - 1) < 0.02  # measured 0.0094


def first_hits(origin: np.ndarray, direction: np.ndarray, centre: np.ndarray, radius: float) -> np.ndarray:
    """Distances at which parallel rays from (N, 3) meet the first of balls (M, 3), beyond 1e-9; infinite: none."""
    near = np.full(len(origin), np.inf)
    across = np.linalg.svd(direction[None])[2][1:]
    beside = centre @ across[0], centre @ across[1]
    for rows in np.array_split(np.arange(len(origin)), max(1, len(origin) * len(centre) // 4_000_000)):
        along = centre @ direction - (origin[rows] @ direction)[:, None]
        from_ray = beside[0] - (origin[rows] @ across[0])[:, None], beside[1] - (origin[rows] @ across[1])[:, None]
        half = radius**2 - from_ray[0] ** 2 - from_ray[1] ** 2
        with np.errstate(invalid="ignore"):
            entry = np.where(half > 0, along - np.sqrt(half), np.inf)
        near[rows] = np.where(entry > 1e-9, entry, np.inf).min(axis=1)
    return near


@pytest.mark.parametrize("radius", [0.5, 1.5], ids=["touching", "overlapping"])
def test_light_on_a_scan_is_that_of_rays(radius):
    """Balls at jittered places of a rough surface; those that overlap shade each other in creases alone."""
    rng = np.random.default_rng(5)
    cells = 40
    at = np.indices((cells, cells)).reshape(2, -1).T - cells / 2 + rng.uniform(0, 1, (cells**2, 2))
    centre = np.column_stack([at, np.sin(0.5 * at[:, 0]) + 0.2 * rng.normal(size=len(at))])
    cloud = replace(
        clouds.sphere_cloud(len(at)),
        position=centre.astype(np.float32), normal=None, radii=np.full((len(at), 1), radius, np.float32),
    )  # fmt: skip
    direction, width = np.array([0.7, 0.2, -0.6]) / np.linalg.norm([0.7, 0.2, -0.6]), 24.0
    light = Light("SUN", np.full(3, 3.0), np.zeros(3), direction)
    case = seen((build.points(f"scan of radius {radius}", cloud), build.moved()), light=light)
    eye = cameras.camera((0, -1e-6, 20), (0, 0, 0), resolution=(96, 96), parallel=width, far=50)
    # Texels of maps are then half a radius wide, as those of large scans.
    case = replace(case, camera=eye, settings=replace(case.settings, shadow_resolution=24))
    u = (np.arange(192) + 0.5) / 192 * width - width / 2
    start = np.column_stack([*(axis.ravel() for axis in np.meshgrid(u, u)), np.full(len(u) ** 2, 20.0)])
    depth = first_hits(start, np.array([0.0, 0, -1]), centre, radius)
    there = np.isfinite(depth)
    point = start[there] - depth[there, None] * [0, 0, 1]
    owner = np.concatenate([
        np.abs(np.linalg.norm(part[:, None] - centre, axis=2) - radius).argmin(axis=1)
        for part in np.array_split(point, 16)
    ])  # fmt: skip
    normal = (point - centre[owner]) / radius
    cosine = np.maximum(-normal @ direction, 0)
    free = np.isinf(first_hits(point + 1e-6 * normal, -direction, centre, radius))
    expected = (cosine * free).sum() / cosine.sum()
    unlit = picture(replace(case, scene=replace(case.scene, lights=())))
    without = picture(replace(case, settings=replace(case.settings, use_shadows=False))) - unlit
    found = (picture(case) - unlit).sum() / without.sum()
    assert abs(found / expected - 1) < 0.02  # measured 0.0013, 0.0066


def test_maps_of_what_has_moved_do_not_stay():
    """An animation would fill the device with them: found without it, 25 MB more for each frame of this one."""
    base = seen(floor(), card(0.3), light=ABOVE)
    held = []
    for step in range(6):
        matrices = base.scene.instances.world_from_object.copy()
        matrices[1, 0, 3] += 0.1 * step
        moved = replace(base.scene, instances=replace(base.scene.instances, world_from_object=matrices))
        render(replace(base, scene=moved), COMBINED, 1)
        held.append(opengl().device.bytes_allocated())
    assert held[5] == held[4] == held[3]
