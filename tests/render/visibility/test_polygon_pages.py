"""Small meshes share pages: triangles of all meshes and materials are drawn at once, and look as they do alone."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.cache.keys import Kind
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.frame.uploads import polygons
from pointsplat_addon.render.frame.uploads.polygons import page_members
from pointsplat_addon.render.passes.visibility.polygon_mesh import BLOCK
from pointsplat_addon.render.passes.visibility.polygon_page import MOST_TRIANGLES
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render

SETTINGS = Settings(technique="VISIBILITY")
PASSES = frozenset({"combined", "depth", "normal", "object_index", "crypto_object", "crypto_material"})
EYE = cameras.camera((0.6, -7, 3.2), resolution=(96, 72), near=0.05, far=60)
COLORS = np.array([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]])
# A picture over the UV square, an alpha of one, and a colour that varies with the place, which is known at corners.
PICTURED = MaterialGraph(base_color=color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), build.picture())))
CUT = MaterialGraph(alpha=color_nodes.Component(texture_nodes.ImageTexture(input_nodes.UV(), build.picture()), 0))
PLACED = MaterialGraph(base_color=color_nodes.Color(input_nodes.Coordinates("position")))


def shapes(count: int) -> list[Mesh]:
    """Meshes of different numbers of triangles, none a multiple of a block's alone."""
    return [meshes.sphere_mesh(f"ball {i}", 5 + i % 4) for i in range(count)]


def in_rows(things: list[Mesh]) -> list[tuple[Geometry, np.ndarray]]:
    """Meshes in rows that overlap in the picture; every third is mirrored."""
    places = [(1.3 * (i % 4) - 2, 1.3 * (i // 4) - 1, 0.1 * i) for i in range(len(things))]
    scales = [(-0.9 if i % 3 == 2 else 0.9, 1.0, 1.0) for i in range(len(things))]
    return [(build.mesh(mesh), build.moved(*where)) for mesh, *where in zip(things, places, scales, strict=True)]


def plain() -> Scene:
    things = [replace(mesh, materials=(i % 3,)) for i, mesh in enumerate(shapes(8))]
    return build.scene(*in_rows(things), table=build.materials(3, base_color=COLORS))


def of_several_materials() -> Scene:
    def mixed(mesh: Mesh) -> Mesh:
        rows = (np.arange(len(mesh.triangles)) * 7 % 3).astype(np.int32)
        return replace(mesh, material=rows, materials=(0, 1, 2))

    table = build.materials(3, base_color=COLORS, cull=[False, True, False])
    return build.scene(*in_rows([mixed(mesh) for mesh in shapes(8)]), table=table)


def of_graphs() -> Scene:
    things = [replace(meshes.plane_mesh(f"card {i}", 1.2, 2 + i), materials=(i % 4,)) for i in range(8)]
    return build.scene(*in_rows(things), table=build.materials(4, graphs=(PICTURED, CUT, PLACED, None)))


def of_fine_pictures() -> Scene:
    """Pictures of which a sub-sample spans many texels: of two materials, cut out, and repeated otherwise."""

    def repeated(mesh: Mesh, times: float) -> Mesh:
        return replace(mesh, uv={"UV": np.asarray(mesh.uv["UV"]) * np.float32(times)})

    noise = Image(np.random.default_rng(6).random((32, 32, 4)).astype(np.float32))
    texture = texture_nodes.ImageTexture(input_nodes.UV(), noise)
    fine = MaterialGraph(base_color=color_nodes.Color(texture), alpha=color_nodes.Component(texture, 3))
    things = [repeated(meshes.plane_mesh(f"fine {i}", 1.2, 1 + i % 3), 8.0 + i) for i in range(8)]
    things = [replace(mesh, materials=(i % 4,)) for i, mesh in enumerate(things)]
    return build.scene(
        *in_rows(things), table=build.materials(4, graphs=(fine, PICTURED, replace(fine, alpha=None), CUT))
    )


def with_instances_and_holdouts() -> Scene:
    rows = in_rows(shapes(6))
    again = [(geometry, build.moved((0, 0, 1.3)) @ matrix) for geometry, matrix in rows[:3]]
    things = [*rows, *again]
    return build.scene(*things, holdout=[i == 4 for i in range(len(things))], transparent=True)


SCENES = {
    "plain": plain,
    "materials": of_several_materials,
    "graphs": of_graphs,
    "fine pictures": of_fine_pictures,
    "instances": with_instances_and_holdouts,
}


@pytest.mark.parametrize("name", SCENES)
def test_pictures_are_those_of_meshes_alone(name, monkeypatch):
    scene = SCENES[name]()
    assert sum(map(len, page_members(scene))) == len(scene.geometries)
    found = render(Case(scene, EYE, SETTINGS), PASSES, 16)
    monkeypatch.setattr(polygons, "page_members", lambda scene: [])
    expected = render(Case(scene, EYE, SETTINGS), PASSES, 16)
    assert found.report["technique"]["name"] == "VISIBILITY"
    assert found.pixels.keys() == expected.pixels.keys()
    for key, values in expected.pixels.items():
        np.testing.assert_array_equal(found.pixels[key], values, err_msg=key)


def recorded(scene: Scene, eye=EYE, renderer: Renderer | None = None) -> tuple[NullDevice, Renderer]:
    renderer = renderer or Renderer(NullDevice(), Store())
    device = renderer.device
    assert isinstance(device, NullDevice)
    device.calls.clear()
    renderer.render(scene, Case(scene, eye, SETTINGS).request(frozenset({"combined"}), 16))
    return device, renderer


def draws(device: NullDevice, name: str) -> list[int]:
    return [call.count for call in device.calls if call.interface.name == name]


def test_many_meshes_and_materials_are_one_draw():
    scene = plain()
    device, _ = recorded(scene)
    blocks = sum(
        -(-len(geometry.mesh.triangles) // BLOCK) for geometry in scene.geometries if geometry.mesh is not None
    )
    assert draws(device, "polygons") == [3 * BLOCK * blocks]
    assert draws(device, "shadow maps")[0] == 3 * BLOCK * blocks


def test_meshes_out_of_view_are_not_drawn():
    scene = plain()
    aside = cameras.camera((-2, -4, 0.2), target=(-2, 0, 0), resolution=(24, 24), near=0.05, far=60)
    near, _ = recorded(scene, aside)
    whole, _ = recorded(scene)
    assert 0 < draws(near, "polygons")[0] < draws(whole, "polygons")[0]


def test_pages_do_not_depend_on_the_view():
    """Shadow maps draw the page of the picture, and so do other views."""
    scene = plain()
    _, renderer = recorded(scene)
    aside = cameras.camera((-2, -4, 0.2), target=(-2, 0, 0), resolution=(24, 24), near=0.05, far=60)
    recorded(scene, aside, renderer)
    kept = [key.kind for key in renderer.kept.keys()]  # noqa: SIM118 - no dictionary
    assert kept.count(Kind.POLYGON_PAGE) == 1
    assert Kind.POLYGON_MESH not in kept


def test_what_shares_pages():
    dense, lone = build.mesh(meshes.sphere_mesh("dense", 120)), build.mesh(meshes.sphere_mesh("lone", 8))
    panes = build.mesh(replace(meshes.plane_mesh("pane"), materials=(1,)))
    table = build.materials(2, alpha=[1.0, 0.5], translucent=np.array([False, True]))
    scene = build.scene(*[(thing, np.eye(4)) for thing in (dense, lone, panes)], table=table)
    assert page_members(scene) == []  # one mesh shares its page with none
    other = build.mesh(meshes.sphere_mesh("other", 8))
    scene = build.scene(*[(thing, np.eye(4)) for thing in (dense, lone, panes, other)], table=table)
    assert page_members(scene) == [[lone, other]]
    # Many instances of a mesh are a draw of their own, which compute shaders may take.
    scene = build.scene(*[(lone, np.eye(4))] * 400, (other, np.eye(4)), table=table)
    assert page_members(scene) == []


def test_pages_are_limited():
    """A mesh that changes takes along those on its page: so many."""
    many = [build.mesh(meshes.sphere_mesh(f"many {i}", 60)) for i in range(24)]
    pages = page_members(build.scene(*[(thing, np.eye(4)) for thing in many]))
    sizes = [sum(len(thing.mesh.triangles) for thing in members if thing.mesh is not None) for members in pages]
    assert len(pages) > 1
    assert max(sizes) <= MOST_TRIANGLES
    assert [thing for members in pages for thing in members] == many
