"""Rows of splats that lie beyond the picture are not drawn, and nothing of it is missed."""

from typing import Any

import numpy as np
import pytest

from pointsplat_addon.core.lod.balls.covered import node_shape
from pointsplat_addon.core.numeric.vectors import basis
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.passes.uniforms import view_of
from pointsplat_addon.render.passes.visibility import in_picture, splat_ids
from scripts.scenes import build, cameras
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

COUNT = 250_000
EYES = {
    "outside": cameras.camera((0, -4, 0), (0, 0, 0), (64, 48), field_of_view=8, near=0.01, far=100),
    "among": cameras.camera((0, 0, 0), (1, 0.3, 0.2), (64, 48), field_of_view=70, near=0.01, far=100),
    "parallel": cameras.camera((0, -4, 0), (0.4, 0, 0.3), (64, 48), parallel=0.5, near=0.01, far=100),
    "near depths": cameras.camera((0, -4, 0), (0, 0, 0), (64, 48), field_of_view=60, near=3.2, far=3.5),
}


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES)
@pytest.mark.parametrize("seed", range(3))
def test_no_box_with_a_point_in_the_picture_is_left_out(eye, seed):
    """Of 2,000 boxes most are left out, and none that holds one of 50 random points that
    are seen."""
    rng = np.random.default_rng(seed)
    middle, half = rng.uniform(-2, 2, (2000, 1, 3)), rng.uniform(0, 0.3, (2000, 1, 3))
    bounds = np.concatenate([middle - half, middle + half], axis=1)
    matrix = np.eye(4)
    matrix[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.5, 1.5, 3)
    matrix[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    view = view_of(eye, offset=(0.3, -0.2))
    view_from_box = eye.view_from_world @ matrix
    shown = in_picture.boxes_in_picture(bounds.astype(np.float32), view_from_box, view)

    inside = middle + half * rng.uniform(-1, 1, (2000, 50, 3))
    at = inside @ view_from_box[:3, :3].T + view_from_box[:3, 3]
    depth = -at[..., 2]
    fx, fy = eye.pixel_from_view()[:2]
    with np.errstate(all="ignore"):
        pixel = at[..., :2] * [fx, fy] / (depth[..., None] if eye.perspective else 1.0) + view.principal_point
    seen = (depth > eye.near) & (depth < eye.far) & ((pixel > 0) & (pixel < eye.resolution)).all(axis=-1)
    assert seen.any()
    assert shown[seen.any(axis=1)].all()
    assert shown.mean() < 0.5


def scan() -> PointCloud:
    rng = np.random.default_rng(5)
    position = rng.uniform(-1, 1, (COUNT, 3)).astype(np.float32)
    radii = rng.uniform(0.001, 0.01, (COUNT, 1)).astype(np.float32)
    return PointCloud(position, radii=radii, color=rng.uniform(0, 1, (COUNT, 3)).astype(np.float32))


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES)
def test_pictures_are_those_of_all_splats(eye, monkeypatch):
    """To the bit, of fewer splats: half to seven tenths of them."""
    scene = build.scene((build.points("in picture", scan()), np.diag([1.0, 1.2, 0.8, 1.0])), lights=[build.sun()])
    case = Case(scene, eye, Settings(technique="VISIBILITY", use_shadows=False))
    drawn, _ = looked_at(case, monkeypatch)
    assert max(drawn) < 0.75 * COUNT  # measured 0.51 to 0.71


def looked_at(case: Case, monkeypatch) -> tuple[list[int], list[int]]:
    """How many splats were drawn each time, and how many nodes looked at for wide ones. The picture is that of all."""
    drawn: list[int] = []
    looked: list[int] = []

    def counted(draw, view, wide=0.0):
        runs = in_picture.splats_in_picture(draw, view, wide)
        drawn.append(sum(last - first for first, last in runs))
        if wide > 0 and draw.page.nodes:
            looked.append(drawn[-1])
        return runs

    monkeypatch.setattr(splat_ids, "splats_in_picture", counted)
    few = render(case, frozenset({"combined"}), 16).pixels["combined"]
    monkeypatch.setattr(splat_ids, "splats_in_picture", lambda draw, view, wide=0.0: [(0, draw.elements)])
    whole = render(case, frozenset({"combined"}), 16).pixels["combined"]
    assert few[..., :3].max() > 0
    assert np.array_equal(few, whole)
    return drawn, looked


def nodes() -> Geometry:
    """Row by row from small to large ones, the largest of which are several pixels wide."""
    rng = np.random.default_rng(6)
    position = np.sort(rng.uniform(-1, 1, (COUNT // 4, 3)).astype(np.float32), axis=0)
    normal = rng.normal(size=position.shape)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    radii = (
        np.sort(rng.uniform(0.3, 1.0, position.shape), axis=1)[:, ::-1]
        * np.geomspace(0.003, 0.1, len(position))[:, None]
    )
    covered = rng.uniform(0.1, 1.0, len(position)).astype(np.float32)
    shape, radius = node_shape(normal, basis(normal.T)[0].T, radii.astype(np.float32), covered)
    cloud = PointCloud(position, radii=radius[:, None], share=covered)
    return Geometry("nodes in picture", "Nodes", cloud=cloud, node_shape=shape)


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES)
def test_pictures_are_those_of_all_nodes(eye, monkeypatch):
    """To the bit, those of which are drawn that a view shows, and those looked at for wide ones that may be wide."""
    scene = build.scene((nodes(), np.diag([1.0, 1.2, 0.8, 1.0])), lights=[build.sun()])
    case = Case(scene, eye, Settings(technique="VISIBILITY"))  # with shadows: nodes cast as balls
    _, looked = looked_at(case, monkeypatch)
    assert max(looked) < 0.9 * COUNT / 4


@pytest.mark.parametrize("eye", EYES.values(), ids=EYES)
def test_no_ellipsoid_in_the_picture_is_wider_than_it_may_be(eye):
    """Points on 3,000 spheres, each in a box of its own: how far those in the picture lie apart at most."""
    rng = np.random.default_rng(8)
    radius, turn = rng.uniform(0.01, 0.3, 3000), np.linalg.qr(rng.normal(size=(3, 3)))[0]
    middle, along = rng.uniform(-3, 3, (3000, 3)), rng.normal(size=(2000, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    matrix = np.eye(4)
    matrix[:3, :3] = turn * 1.3
    view_from_box = eye.view_from_world @ matrix
    bounds = np.stack([middle - radius[:, None], middle + radius[:, None]], axis=1).astype(np.float32)
    view = view_of(eye, offset=(0.3, -0.2))
    found = in_picture.widths_in_picture(bounds, radius.astype(np.float32), view_from_box, view)
    centre = middle @ view_from_box[:3, :3].T + view_from_box[:3, 3]
    tight = 0.0
    for row in np.flatnonzero(np.isfinite(found)):
        at = centre[row] + 1.3 * radius[row] * along
        pixel = at[:, :2] * eye.pixel_from_view()[:2] / (-at[:, 2:] if eye.perspective else 1.0) + view.principal_point
        if not ((pixel > 0) & (pixel < eye.resolution)).all(axis=1).any():
            continue
        angle = rng.uniform(0, np.pi, 8)
        width = np.ptp(pixel @ np.stack([np.cos(angle), np.sin(angle)]), axis=0).max()
        assert width <= found[row]
        tight = max(tight, width / found[row])
    assert tight > 0.7


def test_runs_cover_what_is_shown_and_join_over_short_gaps(monkeypatch):
    """Rows of 4,096: shown ones 1, 2, 4, 9 of 11, the last of which is short."""
    shown = np.zeros(11, bool)
    shown[[1, 2, 4, 9, 10]] = True
    monkeypatch.setattr(in_picture, "boxes_in_picture", lambda *given: shown)

    class Page:
        bounds, widest = np.zeros((11, 2, 3)), np.zeros(11)

    class Draw:
        page, view_from_page, elements, splats = Page(), np.eye(4), 11 * 4096, 10 * 4096 + 5

    view, draw = view_of(EYES["outside"]), Draw()
    runs: Any = in_picture.splats_in_picture
    assert runs(draw, view) == [(4096, 5 * 4096), (9 * 4096, 10 * 4096 + 5)]
    shown[:] = False
    assert runs(draw, view) == []
