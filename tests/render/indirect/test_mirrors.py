"""What sharp mirrors show, against the scene as it is behind them, and against rays in float64."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.indirect.lobes import half_vectors
from pointsplat_addon.core.indirect.triangle_tree import triangle_tree
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.numeric.vectors import unit_rows
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.indirect import traced
from pointsplat_addon.render.indirect.light import coherent_rows
from pointsplat_addon.render.passes.indirect.trace import TracedTriangles
from pointsplat_addon.render.plan import make_plan
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import drawing
from scripts.scenes.build import materials, mesh, moved, points, scene, sun
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.indirect_cases import LAID, SETTINGS
from scripts.scenes.meshes import cube_mesh, plane_mesh, sphere_mesh

SIZE = 160, 120
METAL, RED, GLOW, GREY = range(4)
WALL = 2.0  # where the mirror stands on the y axis


def table(roughness=0.0):
    return materials(
        4, base_color=[[1, 1, 1], [0.8, 0.1, 0.05], [0, 0, 0], [0.5, 0.5, 0.5]], specular=[0.0] * 4,
        metallic=[1, 0, 0, 0], roughness=[roughness, 1, 1, 1], emission=[[0] * 3, [0] * 3, [0.8, 0.9, 1.0], [0] * 3],
    )  # fmt: skip


def of(made, row):
    return mesh(replace(made, key=f"{made.key} of {row}", materials=(row,), material=None), "POLYGONS")


def drawn(case):
    """(H, W, 3) float32."""
    renderer = Renderer(drawing.opengl().device)
    found = renderer.render(case.scene, case.request(frozenset({"combined"}), 16)).pixels["combined"]
    renderer.release()
    return found[..., :3]


def rays(seen):
    """The eye, and unit directions through the pixels' centres, (H, W, 3)."""
    wide, high = SIZE
    y, x = np.mgrid[0:high, 0:wide] + 0.5
    ndc = np.stack([2 * x / wide - 1, 2 * y / high - 1, np.full(x.shape, -1.0), np.ones(x.shape)], axis=-1)
    near = ndc @ np.linalg.inv(seen.clip_from_view @ seen.view_from_world).T
    eye = np.linalg.inv(seen.view_from_world)[:3, 3]
    return eye, unit_rows(near[..., :3] / near[..., 3:] - eye)


def behind_the_eye():
    """Blocks and a ball, which a mirror before the eye shows."""
    return (
        (of(cube_mesh("red block", 1.0), RED), moved((-1.2, -6.5, 0.4))),
        (of(cube_mesh("shining block", 0.7), GLOW), moved((0.2, -6.0, -0.4))),
        (of(sphere_mesh("grey ball", 24), GREY), moved((1.3, -6.2, 0.5), 0.7)),
        (of(plane_mesh("grey floor", 30.0), GREY), LAID @ moved((0, 0, 0))),
    )


def lit(things, lights, table):
    return scene(*things, lights=lights, world=World(np.zeros(3)), table=table)


def test_a_plane_mirror_shows_what_stands_before_it_as_if_it_stood_behind_it():
    seen, rays_of_sun = camera((0.0, -1.0, 0.3), (0, WALL, 0.2), SIZE), np.array([0.35, 0.6, -0.7])
    wall = (of(plane_mesh("mirror", 40.0), METAL), moved((0, WALL, 0)))
    shown = drawn(Case(lit((*behind_the_eye(), wall), [sun(2.0, rays_of_sun)], table()), seen, SETTINGS))
    turn = np.diag([1.0, -1, 1, 1])
    turn[1, 3] = 2 * WALL
    turned = [(made, turn @ matrix) for made, matrix in behind_the_eye()]
    lights = [sun(2.0, rays_of_sun * [1, -1, 1])]
    truth = drawn(Case(lit(turned, lights, table()), seen, SETTINGS))
    off = np.abs(shown - truth)
    # The light tree of each is another: indirect light differs.
    assert np.median(off) < 2e-4  # 4.6e-5
    assert np.sqrt(np.mean(off**2)) < 0.01  # 0.0087


@pytest.mark.parametrize("roughness", [0.0, 0.15])
def test_what_mirrors_show_of_a_room_knows_nothing_of_what_is_outside(roughness):
    """A closed room of thin walls that shine evenly, under a sky five times as bright. Cells in which light is
    gathered for what is mirrored at the rim of a ball are wider than the room."""
    around = [
        (of(cube_mesh("walls", 1.0), RED), moved(middle, size))
        for middle, size in (
            ((0, 0, -1.55), (6, 6, 0.1)), ((0, 0, 1.55), (6, 6, 0.1)), ((-3.05, 0, 0), (0.1, 6, 3)),
            ((3.05, 0, 0), (0.1, 6, 3)), ((0, -3.05, 0), (6, 0.1, 3)), ((0, 3.05, 0), (6, 0.1, 3)),
        )
    ]  # fmt: skip
    ball = of(sphere_mesh("mirror ball", 24), METAL), moved((-1, 1.5, -0.3), 0.35)
    walls = materials(
        4, base_color=[[1.0] * 3, [0.5] * 3, [0] * 3, [0.5] * 3], specular=[0.0] * 4, metallic=[1, 0, 0, 0],
        roughness=[roughness, 1, 1, 1], emission=[[0] * 3, [0.5] * 3, [0] * 3, [0] * 3],
    )  # fmt: skip
    sky = World(np.full(3, 5.0))
    seen = camera((-1.0, -0.8, -0.1), (-1, 1.5, -0.3), SIZE)
    of_room = scene(ball, *around, lights=(), world=sky, table=walls)
    shown = drawn(Case(of_room, seen, replace(SETTINGS, bounces=12)))
    # E / (1 - albedo) is 1; next to corners of the room, and beside the ball. Receivers within walls: 0.197.
    assert np.abs(shown - 1).max() < 0.09  # 0.080


def test_a_mirror_ball_shows_a_shining_square_where_rays_meet_it():
    """A ball of points, which is exact, before a square above which there is nothing."""
    seen, middle, radius = camera((0.0, -4.0, 0.6), (0, 0, 0), SIZE), np.array([0.0, 0, 0.1]), 1.0
    cloud = PointCloud(np.zeros((1, 3), np.float32), radii=np.ones((1, 1), np.float32), material=None)
    square = (of(plane_mesh("square", 3.0), GLOW), LAID @ moved((0, -0.7, 0)))
    things = ((points("mirror ball", cloud), moved(middle, radius)), square)
    shown = drawn(Case(lit(things, (), table()), seen, SETTINGS))[..., 2]
    eye, ray = rays(seen)
    b = ray @ (eye - middle)
    c = ((eye - middle) ** 2).sum() - radius**2
    inside = b * b - c > 0
    t = -b - np.sqrt(np.maximum(b * b - c, 0))
    place = eye + t[..., None] * ray
    normal = unit_rows(place - middle)
    away = ray - 2 * (ray * normal).sum(axis=-1, keepdims=True) * normal
    corners = plane_mesh("square", 3.0).position.astype(float)
    corners = corners @ square[1][:3, :3].T + square[1][:3, 3]
    low, high = corners.min(axis=0), corners.max(axis=0)
    with np.errstate(all="ignore"):
        s = (low[2] - place[..., 2]) / away[..., 2]
        met = place + s[..., None] * away
    hit = (s > 0) & ((met >= low) & (met <= high))[..., :2].all(axis=-1)
    truth = np.where(hit, 1.0, 0.0)
    # Pixels around which all show one thing, well inside of the ball.
    near = [np.roll(np.where(inside, truth, np.nan), (y, x), (0, 1)) for y in (-2, 0, 2) for x in (-2, 0, 2)]
    even = inside & (np.min(near, axis=0) == np.max(near, axis=0))
    assert even.sum() > 2000
    assert (even & hit).sum() > 300
    assert np.abs(shown - truth)[even].max() < 1e-3  # 0


@pytest.mark.parametrize("roughness", [0.1, 0.2])
def test_a_rough_mirror_blurs_an_edge_as_its_lobe_does(roughness):
    """A wall that shines on one side of an edge, in a plane mirror before the eye."""
    seen = camera((0.0, -1.0, 0.0), (0, WALL, 0.0), SIZE)
    wall = (of(plane_mesh("mirror", 40.0), METAL), moved((0, WALL, 0)))
    side = (of(plane_mesh("shining side", 40.0), GLOW), moved((40.0, -6.0, 0)))
    shown = drawn(Case(lit((wall, side), (), table(roughness)), seen, SETTINGS))[..., 2]
    eye, ray = rays(seen)
    place = eye + ((WALL - eye[1]) / ray[..., 1])[..., None] * ray
    rng = np.random.default_rng(5)
    row = SIZE[1] // 2
    truth = np.empty(SIZE[0])
    for x in range(SIZE[0]):
        to_eye = np.broadcast_to(-ray[row, x], (4096, 3))
        normal = np.broadcast_to([0.0, -1.0, 0.0], (4096, 3))
        half = half_vectors(normal, to_eye, np.full(4096, roughness**2), rng.random((4096, 2)))
        away = 2 * (half * to_eye).sum(axis=1, keepdims=True) * half - to_eye
        met = place[row, x] + ((-6.0 - WALL) / away[:, 1])[:, None] * away
        truth[x] = (met[:, 0] > 0).mean()
    inner = slice(8, -8)
    off = shown[row - 8 : row + 8, inner] - truth[None, inner]
    assert np.sqrt(np.mean(off**2)) < 0.02  # 0.0126, 0.0139
    assert abs(off.mean()) < 0.005  # -0.0011, -0.0018


def test_half_vectors_are_spread_as_the_distribution_is():
    """Seen along the normal, tan^2 of the angle to it is alpha^2 u / (1 - u), with u even in [0, 1)."""
    alpha, count = 0.3, 4096
    u = (np.arange(count) + 0.5) / count
    up = np.broadcast_to([0.0, 0.0, 1.0], (count, 3))
    found = half_vectors(up, up, np.full(count, alpha), np.stack([u, (u * 617) % 1], axis=1))
    tangent2 = 1 / found[:, 2] ** 2 - 1
    np.testing.assert_allclose(tangent2, alpha**2 * u / (1 - u), rtol=1e-9)


def test_rays_meet_the_triangles_that_they_meet_first():
    rng = np.random.default_rng(3)
    corners = (rng.uniform(-1, 1, (3000, 1, 3)) + rng.normal(0, 0.05, (3000, 3, 3))).astype(np.float32)
    corners[0] = [[-5, -5, -1], [5, -5, -1], [0, 8, -1]]
    origin = rng.uniform(-1, 1, (200, 3))
    direction = unit_rows(rng.normal(size=(200, 3)))
    tree = TracedTriangles(drawing.opengl().device, corners, triangle_tree(corners))
    found, distance, weights = tree.trace(origin, direction, coherent_rows(origin, direction))
    tree.release()
    first = corners[:, 0].astype(float)
    a, b = corners[:, 1] - first, corners[:, 2] - first
    for i in range(len(origin)):
        p, away = np.cross(direction[i], b), origin[i] - first
        det, q = (a * p).sum(axis=1), np.cross(away, a)
        u, v, t = (away * p).sum(axis=1) / det, q @ direction[i] / det, (b * q).sum(axis=1) / det
        t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
        assert found[i] == (-1 if np.isinf(t).all() else t.argmin())
        if found[i] >= 0:
            assert distance[i] == pytest.approx(t.min(), rel=1e-4)
            np.testing.assert_allclose(weights[i], [u[found[i]], v[found[i]]], atol=1e-3)


def test_nothing_is_traced_without_bounces_or_sharp_mirrors(monkeypatch):
    seen, counts = camera((0.0, -1.0, 0.0), (0, WALL, 0.0), SIZE), []
    trace = TracedTriangles.trace

    def counted(self, origin, *rest):
        counts.append(len(origin))
        return trace(self, origin, *rest)

    monkeypatch.setattr(TracedTriangles, "trace", counted)
    things = (*behind_the_eye(), (of(plane_mesh("mirror", 40.0), METAL), moved((0, WALL, 0))))
    for roughness, bounces in ((0.0, 0), (0.3, 2)):
        drawn(Case(lit(things, [sun()], table(roughness)), seen, replace(SETTINGS, bounces=bounces)))
    assert not counts
    drawn(Case(lit(things, [sun()], table()), seen, SETTINGS))
    assert counts


def test_mirrors_show_mirrors():
    """Between two plane mirrors that face each other, by rays as often as those are followed."""
    seen = camera((0.0, 0.0, 0.0), (0, WALL, 0.0), SIZE)
    walls = [(of(plane_mesh(f"mirror {y}", 40.0), METAL), moved((0, y, 0))) for y in (WALL, -WALL)]
    block = (of(cube_mesh("shining block", 0.5), GLOW), moved((0.0, -1.2, 0.0)))
    shown = drawn(Case(lit((*walls, block), (), table()), seen, SETTINGS))[..., 2]
    eye, ray = rays(seen)
    # Along rays, which mirrors fold, the block stands at these places.
    truth = np.zeros(SIZE[::-1], bool)
    corners = cube_mesh("cube", 0.5).position
    low, high = corners.min(axis=0) - [0, 1.2, 0], corners.max(axis=0) - [0, 1.2, 0]
    for y in (2 * WALL - np.array([high[1], low[1]]), 4 * WALL + np.array([low[1], high[1]])):
        slab = np.array([[low[0], y[0], low[2]], [high[0], y[1], high[2]]])
        with np.errstate(all="ignore"):
            t = (slab[:, None, None] - eye) / ray
        truth |= t.min(axis=0).max(axis=-1) < t.max(axis=0).min(axis=-1)
    same = (shown > 0.5) == truth
    assert truth.sum() > 500
    assert same.mean() > 0.99


def test_what_alpha_cuts_out_is_passed():
    """A card, half of which is cut out, before one that shines, as if both stood behind the mirror."""
    seen = camera((0.0, -1.0, 0.3), (0, WALL, 0.2), SIZE)
    texels = np.repeat(np.arange(64) < 40, 4).reshape(1, 64, 4).astype(np.float32)
    alpha = color_nodes.Component(texture_nodes.ImageTexture(input_nodes.UV(), Image(texels)), 0)
    looks = replace(table(), graphs=(None, MaterialGraph(alpha=alpha), None, None))
    cards = (
        (of(plane_mesh("cut card", 1.0), RED), moved((0.2, -5.0, 0.3))),
        (of(plane_mesh("shining card", 1.0), GLOW), moved((0.0, -6.0, 0))),
    )
    wall = (of(plane_mesh("mirror", 40.0), METAL), moved((0, WALL, 0)))
    shown = drawn(Case(lit((*cards, wall), (), looks), seen, SETTINGS))[..., 2]
    turn = np.diag([1.0, -1, 1, 1])
    turn[1, 3] = 2 * WALL
    turned = [(made, turn @ matrix) for made, matrix in cards]
    truth = drawn(Case(lit(turned, (), looks), seen, SETTINGS))[..., 2]
    whole = [(made, turn @ matrix) for made, matrix in cards[1:]]
    assert ((drawn(Case(lit(whole, (), looks), seen, SETTINGS))[..., 2] > 0.5) & (truth < 0.5)).sum() > 100
    # Mirrors cut where alpha is a half, pictures a share of each pixel's sub-samples.
    assert ((shown > 0.5) != (truth > 0.5)).sum() < 0.12 * (truth > 0.5).sum()  # 57 of 607
    assert abs(shown.sum() / truth.sum() - 1) < 0.05


def test_mirrors_show_points_as_cells_do_where_rays_meet_nothing():
    """A glowing ball of points behind the eye, which no triangle hides."""
    seen = camera((0.0, -1.0, 0.0), (0, WALL, 0.0), SIZE)
    cloud = PointCloud(
        np.zeros((1, 3), np.float32), radii=np.ones((1, 1), np.float32), material=np.full(1, GLOW, np.uint16)
    )
    ball = (points("glowing ball", cloud), moved((0, -5.0, 0), 2.0))
    wall = (of(plane_mesh("mirror", 40.0), METAL), moved((0, WALL, 0)))
    shown = drawn(Case(lit((ball, wall), (), table()), seen, SETTINGS))[..., 2]
    assert shown[SIZE[1] // 2, SIZE[0] // 2] > 0.3


def test_mirrors_show_what_cells_do_where_there_are_too_many_triangles(monkeypatch):
    seen = camera((0.0, -1.0, 0.3), (0, WALL, 0.2), SIZE)
    things = (*behind_the_eye(), (of(plane_mesh("mirror", 40.0), METAL), moved((0, WALL, 0))))
    case = Case(lit(things, [sun(2.0)], table()), seen, SETTINGS)
    monkeypatch.setattr(traced, "MOST_TRIANGLES", 10)
    found = drawn(case)
    monkeypatch.setattr(make_plan, "sharp_mirrors", lambda table: np.zeros(len(table), bool))
    np.testing.assert_array_equal(found, drawn(case))
