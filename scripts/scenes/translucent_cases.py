"""Cases of smoke and of glass."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import Fog, World
from scripts.scenes.build import materials, mesh, moved, points, scene, sun
from scripts.scenes.cameras import camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import smoke_cloud, sphere_cloud
from scripts.scenes.meshes import cube_mesh, plane_mesh


def smoke() -> Case:
    """A ball of smoke with a lamp in it, through which a cube of polygons and a sphere of points stick."""
    cloud = smoke_cloud()
    lamp = Light("POINT", np.full(3, 3.0), np.array([0.1, -0.3, 0.2]), np.array([0.0, 0, -1]))
    return Case(
        scene(
            (points("smoke", replace(cloud, color=np.abs(cloud.position))), moved()),
            (mesh(cube_mesh("cube in smoke", 0.5), "POLYGONS"), moved((0.8, 0, 0))),
            (points("sphere in smoke", sphere_cloud(200)), moved((-0.8, 0, 0), 0.5)),
            lights=(lamp, sun(1.0)),
            table=materials(anisotropy=np.array([0.4], np.float32)),
        ),
        camera(),
        Settings(technique="IMAGE_SPACE", shadow_resolution=64),
    )


def tinted_smoke() -> Case:
    """A ball whose extinction is coloured and that glows, before a plane on which its shadow falls."""
    cloud = smoke_cloud(10, (0.5, 1.0, 3.0))
    return Case(
        scene(
            (points("tinted smoke", replace(cloud, emission=0.1 * np.abs(cloud.position))), moved()),
            (mesh(plane_mesh("plane behind smoke", 2.0), "POLYGONS"), moved((0, 1.5, 0))),
        ),
        camera(),
        Settings(technique="IMAGE_SPACE", shadow_resolution=64),
    )


def panes() -> Case:
    """Coloured panes of glass, one behind the other, and a cube of which half is glass."""
    colors, alphas = [[0.8, 0.8, 0.8], [0.9, 0.2, 0.1], [0.1, 0.3, 0.9]], [1.0, 0.4, 0.7]
    table = materials(3, base_color=colors, alpha=alphas, translucent=np.array([False, True, True]))
    half = replace(cube_mesh("half a cube", 0.4), material=np.repeat(np.array([0, 2], np.uint16), 6), materials=(0, 2))
    front, back = (replace(plane_mesh(f"pane {row}", 0.7), materials=(row,)) for row in (1, 2))
    return Case(
        scene(
            (mesh(front), moved((-0.3, -0.5, 0.2))),
            (mesh(back), moved((0.3, 0.5, -0.2))),
            (mesh(half, "POLYGONS"), moved((0.5, 0, 0.5))),
            table=table,
        ),
        camera((0.5, -4, 0.5)),
        Settings(technique="IMAGE_SPACE", shadow_resolution=64),
    )


def panes_in_smoke(extinction: float | tuple[float, float, float] = 1.0) -> Case:
    """The panes and the cube in a ball of smoke, for the visibility buffer."""
    made = panes()
    smoke = points(f"smoke about panes {extinction}", smoke_cloud(8, extinction)), moved()
    things = zip(made.scene.geometries, made.scene.instances.world_from_object, strict=True)
    everything = scene(*things, smoke, table=made.scene.materials)
    return replace(made, scene=everything, settings=replace(made.settings, technique="VISIBILITY"))


def panes_in_coloured_smoke() -> Case:
    """Panes and a cube in a ball of smoke whose extinction is coloured, for the visibility buffer."""
    return panes_in_smoke((0.5, 1.0, 3.0))


def panes_of_functions() -> Case:
    """The panes, whose alpha changes along an axis, and of one the colour, too."""
    plain = panes()
    across, up = (color_nodes.Component(input_nodes.Coordinates("generated"), axis) for axis in (0, 2))
    graphs = None, MaterialGraph(alpha=across, base_color=color_nodes.Color(across)), MaterialGraph(alpha=up)
    table = replace(plain.scene.materials, graphs=graphs)
    return replace(plain, scene=replace(plain.scene, materials=table))


def tinted_panes() -> Case:
    """Two panes of coloured glass, one of which is painted, before each other and a plane, under a sun, whose shadows
    layers of maps show, and a lamp with a size."""
    table = materials(
        3, base_color=[[0.8, 0.8, 0.8], [0.0, 0.0, 0.0], [0.7, 0.6, 0.1]], alpha=[1.0, 0.0, 0.4],
        translucent=np.array([False, True, True]),
        transmission_color=np.array([[1, 1, 1], [0.9, 0.2, 0.1], [0.1, 0.4, 0.9]], np.float32),
        glass=np.array([False, True, True]),
    )  # fmt: skip
    front, back = (replace(plane_mesh(f"tinted pane {row}", 0.7), materials=(row,)) for row in (1, 2))
    lamp = Light("POINT", np.full(3, 9.0), np.array([-0.5, -2.5, 1.5]), np.array([0.0, 1, 0]), radius=0.3)
    return Case(
        scene(
            (mesh(front), moved((-0.3, -0.5, 0.2))),
            (mesh(back), moved((0.3, 0.5, -0.2))),
            (mesh(plane_mesh("plane behind panes", 2.0), "POLYGONS"), moved((0, 1.5, 0))),
            lights=(sun(2.0, (0.3, 1.0, -0.4)), lamp),
            table=table,
        ),
        camera(),
        Settings(technique="IMAGE_SPACE", shadow_resolution=64),
    )


def in_fog() -> Case:
    """A ball of smoke, a cube and a sphere of points in a world of fog, with a lamp and a spot out of view: the fog
    next to lamps is brighter than any number of samples shows."""
    lamp = Light("POINT", np.full(3, 9.0), np.array([1.2, -2.5, 1.5]), np.array([0.0, 0, -1]))
    spot = Light(
        "SPOT", np.full(3, 8.0), np.array([-0.8, -0.6, 2.0]), np.array([0.0, 0, -1]), spot_cos=0.8, spot_blend=0.3
    )
    fog = Fog(np.array([0.2, 0.25, 0.3]), np.array([0.15, 0.2, 0.2]), anisotropy=0.4)
    return Case(
        scene(
            (points("smoke in fog", smoke_cloud()), moved((0, 0, -0.2), 0.5)),
            (mesh(cube_mesh("cube in fog", 0.5), "POLYGONS"), moved((0.8, 0, 0))),
            (points("sphere in fog", sphere_cloud(200)), moved((-0.8, 0, 0), 0.5)),
            lights=(lamp, spot),
            world=World(fog=fog),
        ),
        camera(),
        Settings(technique="IMAGE_SPACE", shadow_resolution=64),
    )


def in_smoke() -> Case:
    """The camera stands in a ball of smoke."""
    return Case(scene((points("around the camera", smoke_cloud(10)), moved(scale=2))), camera((0.2, 0, 0), (0, 1, 0)))
