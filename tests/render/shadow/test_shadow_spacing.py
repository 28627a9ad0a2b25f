"""How many samples of each mesh cast shadows."""

# pyright: reportOptionalMemberAccess=false
# Shadows may have no tables, or no maps; those that are asked for have both.
from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.expression import Expression
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import MaterialTable
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.renderer import Renderer
from pointsplat_addon.render.shadow import batches, maps, shadows
from pointsplat_addon.render.shadow.casting import casting_geometries
from pointsplat_addon.render.shadow.floors import split_floors
from pointsplat_addon.render.shadow.shadows import Shadows
from pointsplat_addon.render.shadow.spacing import samples_per_mesh
from scripts.scenes import build, cameras, clouds, drawing, meshes
from scripts.scenes.case import Case
from scripts.scenes.store import STORE


def test_small_meshes_keep_their_samples_and_large_ones_share_the_rest():
    asked = np.array([5e6, 1000.0, 300_000.0, 2e6])
    each = samples_per_mesh(asked, 1e6)
    got = np.minimum(asked, each)
    assert got.sum() == pytest.approx(1e6)
    assert got[1:3].tolist() == [1000.0, 300_000.0]
    assert got[0] == got[3]


def test_where_all_fit_none_is_coarser():
    asked = np.array([10.0, 20.0])
    assert (np.minimum(asked, samples_per_mesh(asked, 1e6)) == asked).all()


def test_nodes_of_many_instances_cast_the_shadows_of_their_points(monkeypatch):
    ball = build.mesh(meshes.sphere_mesh("many casters", 120), "POLYGONS")
    floor = build.mesh(meshes.plane_mesh("floor of many casters"), "POLYGONS")
    placed = [(ball, build.moved((0.22 * (i % 5) - 0.44, 0.22 * (i // 5) - 0.44, 0.2), 0.08)) for i in range(25)]
    scene = build.scene(
        *placed, (floor, build.moved()), lights=[replace(build.sun(3.0, (0.3, 0.2, -1.0)), radius=0.005)]
    )
    case = Case(
        scene,
        cameras.camera((0, -2.5, 2.5), resolution=(160, 120)),
        Settings(technique="IMAGE_SPACE", shadow_resolution=512),
    )
    found = []
    for module in (shadows, maps):
        monkeypatch.setattr(module, "takes_map", lambda light: False)
    for limit in (1 << 60, 0):
        STORE.clear()
        monkeypatch.setattr(batches, "MAX_POINTS_WITHOUT_NODES", limit)
        renderer = Renderer(drawing.opengl().device, STORE)  # what others keep is of other tables
        pixels = renderer.render(case.scene, case.request(frozenset({"combined"}), 4)).pixels["combined"]
        renderer.release()
        found.append(pixels[..., :3].astype(float))
    difference = found[0] - found[1]
    assert abs(difference.mean()) < 1e-3  # measured 3.3e-4
    assert np.sqrt((difference**2).mean()) < 5e-3  # measured 2.8e-3, at the rims of shadows


def test_shadows_are_those_of_alphas_whatever_the_colours(monkeypatch):
    store, plane = Store(), (build.mesh(meshes.plane_mesh("coloured caster", cells=4)), build.moved())
    below = build.mesh(meshes.cube_mesh("in the shadow of colours", 0.1)), build.moved((0, 0, -0.5))

    def shadows_of(table: MaterialTable) -> Shadows:
        lights = [replace(build.sun(), radius=0.01), build.sun()]
        scene = build.scene(plane, below, lights=lights, table=table)
        settings = Settings(technique="IMAGE_SPACE", shadow_resolution=64)
        with monkeypatch.context() as changed:
            found, _ = shadows.make_shadows(scene, settings, store)
            for module in (shadows, maps):
                changed.setattr(module, "takes_map", lambda light: False)
            without, _ = shadows.make_shadows(scene, settings, store)
        assert found is not None
        assert found.maps is not None
        assert found.tables is None
        assert without is not None
        assert without.tables is not None
        return Shadows(without.tables, found.maps)

    def of(**graphs: Expression) -> MaterialTable:
        return build.materials(graphs=(MaterialGraph(**graphs),))

    texture = texture_nodes.ImageTexture(input_nodes.UV(), build.picture())
    plain, red = (
        shadows_of(build.materials()),
        shadows_of(build.materials(base_color=np.array([[1, 0, 0]], np.float32))),
    )
    coloured = shadows_of(of(base_color=color_nodes.Color(texture), roughness=color_nodes.Component(texture, 0)))
    assert red.tables is coloured.tables is plain.tables
    assert red.maps is coloured.maps is plain.maps
    half = shadows_of(
        of(base_color=color_nodes.Color(texture), alpha=color_nodes.Component(texture, 0))
    )  # cut out where u < 1/2
    assert half.tables.entries < plain.tables.entries
    assert half.maps.key != plain.maps.key


LAID = np.array([[2.0, 0, 0, 0], [0, 0, -2, 0], [0, 2, 0, 0], [0, 0, 0, 1]])  # planes stand upright


def floored(*more, lights=None, sunk: float = 0.0) -> Case:
    """A ball above a floor, in the view of both."""
    ball = build.mesh(meshes.sphere_mesh("ball above a floor", 40), "POLYGONS"), build.moved((0, 0, 0.4 - sunk), 0.4)
    floor = build.mesh(meshes.plane_mesh("floor below a ball"), "POLYGONS"), LAID
    lights = lights or [build.sun(3.0, (0.3, 0.2, -1.0))]
    scene = build.scene(ball, floor, *more, lights=lights)
    return Case(
        scene,
        cameras.camera((0, -4, 2.5), resolution=(160, 120)),
        Settings(technique="IMAGE_SPACE", shadow_resolution=512),
    )


def names_of_casters(case: Case) -> set[str]:
    store = Store()
    casters = casting_geometries(case.scene, store)
    casters, floors = split_floors(case.scene, casters, store)
    return {c.geometry.name for c, floor in zip(casters, floors, strict=True) if not floor}


def test_a_floor_with_nothing_behind_it_casts_nothing_and_looks_the_same(monkeypatch):
    case, pictures = floored(), []
    for keep in (False, True):
        STORE.clear()
        if keep:
            keep_all = lambda scene, casters, store: (casters, (False,) * len(casters))  # noqa: E731
            monkeypatch.setattr(shadows, "split_floors", keep_all)
        renderer = Renderer(drawing.opengl().device, STORE)
        pixels = renderer.render(case.scene, case.request(frozenset({"combined"}), 4)).pixels["combined"]
        renderer.release()
        pictures.append(pixels[..., :3].astype(float))
    difference = np.abs(pictures[0] - pictures[1])
    assert np.sqrt((difference**2).mean()) < 1e-2  # measured 2.0e-3, at the rim of the shadow


def test_what_may_have_something_behind_it_casts():
    ball, floor = "ball above a floor", "floor below a ball"
    cellar = build.mesh(meshes.cube_mesh("in the cellar", 0.1), "POLYGONS"), build.moved((0, 0, -1.0))
    cloud = build.points("cloud", clouds.sphere_cloud()), build.moved((0, 0, 0.9))
    above, below = (build.sun(3.0, (0.3, 0.2, z)) for z in (-1.0, 1.0))
    assert names_of_casters(floored()) == {ball}
    assert names_of_casters(floored(lights=[below, replace(above, shadow=False)])) == {ball, floor}
    assert names_of_casters(floored(lights=[above, below])) == {ball, floor}
    assert names_of_casters(floored(sunk=0.01)) == {ball, floor}
    assert names_of_casters(floored(cellar)) == {ball, floor, "in the cellar"}
    assert names_of_casters(floored(cloud)) == {ball, floor, "cloud"}  # its lowest points lie below


def walls(thickness: float, *, open_below: bool = False) -> list:
    """Boxes of one mesh that enclose the cube from -1 to 1 but for its top."""
    cube = meshes.cube_mesh("wall")
    if open_below:
        cube = meshes.flat_mesh("wall without a side", cube.position, np.delete(cube.triangles, [0, 6], axis=0))
    box, found = build.mesh(cube, "POLYGONS"), []
    for axis, side in ((0, -1), (0, 1), (1, -1), (1, 1), (2, -1)):
        matrix = np.eye(4)
        matrix[axis, axis], matrix[axis, 3] = thickness / 2, side * (1 + thickness / 2)
        found.append((box, matrix))
    return found


@pytest.mark.parametrize(
    ("thickness", "open_below", "outside", "cast"),
    [
        (0.1, False, None, 0),
        (1.0, False, None, 5),  # thick enough for a camera inside
        (0.1, True, None, 5),
        (0.1, False, (1.5, 0.3, 0.3), 1),  # the wall between it and the light
        (0.1, False, (0.3, 0.3, -1.5), 1),
    ],
)
def test_walls_cast_where_something_is_behind_them(thickness, open_below, outside, cast):
    light = Light("POINT", np.ones(3), np.array([0.2, 0.1, 0.5]), np.array([0.0, 0, -1]), radius=0.1)
    inside = build.mesh(meshes.sphere_mesh("within walls", 20), "POLYGONS"), build.moved((0, 0, -0.5), 0.2)
    behind = [] if outside is None else [(inside[0], build.moved(outside, 0.2))]
    scene = build.scene(*walls(thickness, open_below=open_below), inside, *behind, lights=[light])
    store = Store()
    casters, floors = split_floors(scene, casting_geometries(scene, store), store)
    found = [len(c.matrices) for c, floor in zip(casters, floors, strict=True)
             if not floor and c.geometry.name.startswith("wall")]  # fmt: skip
    assert sum(found) == cast


def test_where_only_floors_could_cast_there_are_no_tables():
    floor = build.mesh(meshes.plane_mesh("only a floor"), "POLYGONS"), LAID
    scene = build.scene(floor, lights=[build.sun(3.0, (0.3, 0.2, -1.0))])
    assert shadows.make_shadows(scene, Settings(technique="IMAGE_SPACE"), Store()) == (
        None,
        "there is nothing in the shadow of anything",
    )
