"""Scenes that have one thing more, or less, than another."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, normal_nodes, texture_nodes
from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import CoatTable, HairTable
from pointsplat_addon.core.scene.world import Fog, World
from pointsplat_addon.render.frame.visibility.occlusion import FEWEST_TRIANGLES
from scripts.scenes import (
    build,
    cameras,
    clouds,
    detailed_cases,
    lit_cases,
    meshes,
    solid_cases,
)
from scripts.scenes.case import Case


def with_scene(case: Case, **more) -> Case:
    """The case with parts of its scene replaced."""
    return replace(case, scene=replace(case.scene, **more))


def with_settings(case: Case, **more) -> Case:
    """The case with other settings."""
    return replace(case, settings=replace(case.settings, **more))


def only(case: Case, kind: Callable) -> Case:
    """Only the geometries that `kind` is true of, each once."""
    of, at = case.scene.instances.geometry, case.scene.instances.world_from_object
    things = [(g, at[np.flatnonzero(of == i)[0]]) for i, g in enumerate(case.scene.geometries) if kind(g)]
    only = build.scene(*things, lights=case.scene.lights, world=case.scene.world, table=case.scene.materials)
    return replace(case, scene=only)


def cloud_case(cloud: PointCloud, key: str, **more) -> Case:
    return Case(build.scene((build.points(key, cloud), build.moved()), **more), cameras.camera())


def world_only() -> Case:
    return Case(build.scene(lights=(), world=World(np.array([0.2, 0.3, 0.4]))), cameras.camera())


def picture_only() -> Case:
    image = np.ones((4, 8, 3), np.float32)
    return Case(build.scene(lights=(), world=World(np.zeros(3), image)), cameras.camera())


def dense_mesh() -> Case:
    return Case(build.scene((build.mesh(meshes.sphere_mesh("leave out: dense", 96)), build.moved())),
                cameras.camera(resolution=(32, 32)))  # fmt: skip


def behind_a_wall() -> Case:
    """Many triangles, and two that hide them all."""
    sphere = meshes.sphere_mesh("leave out: hidden", 80)
    count = -(-FEWEST_TRIANGLES // len(sphere.triangles))
    balls = [(build.mesh(sphere, "POLYGONS"), build.moved((0, 0.1 * i, 0), 0.2)) for i in range(count)]
    wall = build.mesh(meshes.plane_mesh("leave out: wall"))
    case = Case(build.scene((wall, build.moved((0, -1, 0))), *balls), cameras.camera(resolution=(32, 32)))
    return with_settings(case, technique="VISIBILITY")


def painted_picture(primitive: str) -> Case:
    """A plane with a picture on it: only its colours vary."""
    graph = MaterialGraph(base_color=color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), build.picture())))
    plane = build.mesh(meshes.plane_mesh(f"leave out: picture, {primitive}", cells=16), primitive)
    return Case(build.scene((plane, build.moved()), table=build.materials(graphs=(graph,))), cameras.camera())


def corner_colors() -> Case:
    """A cube whose colours do not repeat over its maps: from where its corners lie."""
    graph = MaterialGraph(base_color=color_nodes.Color(input_nodes.Coordinates("position")))
    block = build.mesh(meshes.cube_mesh("leave out: corners"), "POLYGONS")
    return Case(build.scene((block, build.moved()), table=build.materials(graphs=(graph,))), cameras.camera())


def rough_picture(primitive: str) -> Case:
    """The same, but only its roughness varies."""
    red = color_nodes.Gray(texture_nodes.ImageTexture(input_nodes.UV(), build.picture()))
    plane = build.mesh(meshes.plane_mesh(f"leave out: rough, {primitive}", cells=16), primitive)
    graph = MaterialGraph(roughness=red)
    return Case(build.scene((plane, build.moved()), table=build.materials(graphs=(graph,))), cameras.camera())


def bent_picture(repeats: float) -> Case:
    """A plane with a picture of normals, which repeats so many times a side."""
    color = color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), build.picture()))
    bent = normal_nodes.NormalMap(input_nodes.Constant((0.2,)), color, input_nodes.UV())
    plane = meshes.plane_mesh(f"leave out: bent {repeats}", cells=16)
    plane = replace(plane, uv={name: uv * np.float32(repeats) for name, uv in plane.uv.items()})
    table = build.materials(graphs=(MaterialGraph(normal=bent),))
    scene = build.scene((build.mesh(plane, "POLYGONS"), build.moved()), table=table)
    return with_settings(Case(scene, cameras.camera()), technique="VISIBILITY")


def glow() -> Case:
    """Points that only glow, under a light that they do not reflect."""
    cloud = clouds.sphere_cloud(emission=np.abs(clouds.sphere_points()).astype(np.float32))
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0.0])
    case = cloud_case(cloud, "leave out: glow", table=table)
    return with_settings(case, use_shadows=True, shadow_resolution=64)


def pane(**more) -> Case:
    """One pane of clear glass, and nothing else."""
    table = build.materials(alpha=[0.5], translucent=np.array([True]), **more)
    pane = replace(meshes.plane_mesh("leave out: pane", 0.7), materials=(0,))
    return Case(build.scene((build.mesh(pane), build.moved()), table=table), cameras.camera())


def two_smokes() -> Case:
    """Two instances of one cloud of smoke: none of them knows alone what light reaches it."""
    cloud = build.points("leave out: two smokes", clouds.smoke_cloud(8))
    case = Case(build.scene(*((cloud, build.moved((x, 0, 0))) for x in (-0.5, 0.5))), cameras.camera())
    return with_settings(case, use_shadows=True, shadow_resolution=64)


def held_smoke() -> Case:
    """Smoke, of which another ball of smoke cuts a hole."""
    cloud = build.points("leave out: held smoke", clouds.smoke_cloud(8))
    things = ((cloud, build.moved()), (cloud, build.moved((0.5, -0.5, 0), 0.4)))
    return Case(build.scene(*things, holdout=(False, True)), cameras.camera())


def smoke_and_cube(holdout: bool = False) -> Case:
    """A ball of smoke and a cube, for the visibility buffer. `holdout`: the smoke cuts a hole."""
    cube = build.mesh(meshes.cube_mesh("leave out: cube in smoke", 0.5), "POLYGONS")
    things = (
        (build.points("leave out: smoke", clouds.smoke_cloud(8)), build.moved()),
        (cube, build.moved((0.5, 0, 0))),
    )
    made = build.scene(*things, holdout=(True, False)) if holdout else build.scene(*things)
    return with_settings(Case(made, cameras.camera()), technique="VISIBILITY")


def mixed_materials() -> Case:
    """A plain cube, a metal one and one that glows."""
    table = build.materials(3, metallic=[0, 1, 0], emission=[[0, 0, 0], [0, 0, 0], [1, 2, 3]])
    things = []
    for row in range(3):
        block = replace(meshes.cube_mesh(f"leave out: material {row}", 0.4), materials=(row,),
                        material=np.full(12, row, np.uint16))  # fmt: skip
        things.append((build.mesh(block, "POLYGONS"), build.moved((row - 1.0, 0, 0))))
    return Case(build.scene(*things, table=table), cameras.camera())


def coated() -> Case:
    """Three cubes, of which one has a clear coat."""
    coat = CoatTable(*np.array([[0, 1, 0], [0.1] * 3, [1.5] * 3], np.float32), tint=np.ones((3, 3), np.float32))
    return with_scene(mixed_materials(), materials=build.materials(3, coat=coat))


def backlit() -> Case:
    """Three cubes, of which one is lit from behind in part."""
    table = build.materials(3, backlit=np.array([[0] * 3, [0.2, 0.5, 0.1], [0] * 3], np.float32))
    return with_scene(mixed_materials(), materials=table)


def with_column(**column) -> Case:
    """Three cubes, of whose materials one has something more."""
    return with_scene(mixed_materials(), materials=build.materials(3, **column))


def stretched() -> Case:
    """A cube whose reflections are stretched."""
    tangent = normal_nodes.Tangent(input_nodes.Constant((0.5,)), input_nodes.Constant((0.0,)))
    table = replace(build.materials(1, metallic=[1]), graphs=(MaterialGraph(tangent=tangent),))
    cube = build.mesh(meshes.cube_mesh("leave out: stretched", 0.8), "POLYGONS")
    return with_settings(
        Case(build.scene((cube, build.moved()), table=table), cameras.camera()), technique="VISIBILITY"
    )


def many_instances() -> Case:
    cloud = build.points("leave out: many", clouds.sphere_cloud(100))
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 6), np.linspace(-1, 1, 6)))
    return Case(build.scene(*((cloud, build.moved((a, 0, b), 0.1)) for a, b in zip(x, z, strict=True))),
                cameras.camera())  # fmt: skip


def far_crowd() -> Case:
    """So many instances of so many triangles that nodes stand for them."""
    ball = build.mesh(meshes.sphere_mesh("leave out: crowd", 96))
    at = np.arange(16) - 7.5
    crowd = build.scene(*((ball, build.moved((x, y, 0), 0.3)) for x in at for y in at))
    return with_settings(Case(crowd, cameras.camera((0, -60, 10), resolution=(32, 32))), technique="VISIBILITY")


def tube() -> Case:
    turn = np.linspace(0, 6, 20)
    way = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    return Case(build.scene((build.strand_lines("leave out: tube", [way], 0.2), build.moved())), cameras.camera())


def ribbon() -> Case:
    u = np.linspace(-1.3, 1.3, 30)
    normal = np.stack([0 * u, np.cos(3 * u), np.sin(3 * u)], axis=1).astype(np.float32)
    lines = build.strand_lines("leave out: ribbon", [np.stack([u, 0 * u, 0 * u], axis=1)], 0.12, normal=normal)
    return Case(build.scene((lines, build.moved())), cameras.camera())


def hair() -> Case:
    """Strands thinner than a pixel, of the Principled Hair BSDF."""
    table = build.materials()
    one = np.ones(1, np.float32)
    fibre = HairTable(np.array([True]), 0.3 * one, 0 * one, 0.03 * one, np.ones((1, 3), np.float32))
    case = only(detailed_cases.strands(), lambda g: g.name == "hair")
    return with_scene(case, materials=replace(table, hair=fibre))


def small_balls() -> Case:
    cloud = PointCloud(clouds.sphere_points().astype(np.float32), radii=np.full((400, 1), 0.02, np.float32))
    return cloud_case(cloud, "leave out: small balls")


def two_cubes() -> Case:
    """Of which one may shadow the other; a cube that is alone shadows nothing."""
    cube = solid_cases.cube().scene.geometries[0]
    return Case(build.scene((cube, build.moved()), (cube, build.moved((2.5, 0, 0)))), solid_cases.cube().camera)


def one_light(case: Case, radius: float) -> Case:
    light = Light("POINT", np.full(3, 20.0), np.array([1.0, -3, 2]), np.array([0.0, 0, -1]), radius)
    return with_settings(with_scene(case, lights=(light,)), use_shadows=True, shadow_resolution=64)


def in_fog(case: Case) -> Case:
    fog = Fog(np.full(3, 0.1), np.full(3, 0.08))
    return with_scene(case, world=World(fog=fog))


def normals() -> Case:
    """Points that are shaded by normals other than their own, once lit and once not."""
    return cloud_case(clouds.sphere_cloud(shading_normal=clouds.sphere_points().astype(np.float32)), "leave out: bent")


def looking_away(case: Case) -> Case:
    """The same from where nothing of it is in view."""
    return replace(case, camera=cameras.camera((0, -8, 0), (0, -16, 0)))


def further_lights(*lights: Light) -> Case:
    """Points beneath a sun and further lights, all with shadows."""
    return with_settings(
        with_scene(solid_cases.plain_sphere(), lights=(build.sun(), *lights)), use_shadows=True, shadow_resolution=64
    )


def far_light() -> Light:
    return Light("POINT", np.full(3, 20.0), np.array([0.0, -3e4, 0]), np.array([0.0, 1, 0]), 0.3)


def through_a_lens(method: str) -> Case:
    case = solid_cases.mixed()
    return with_settings(replace(case, camera=replace(case.camera, aperture=Aperture(0.3, 3.0))), dof_method=method)


def out_of_focus(case: Case, focus: float = 1.0) -> Case:
    """All of it, sharp at a distance of one, or what is not at another one."""
    return replace(case, camera=replace(case.camera, aperture=Aperture(0.3, focus)))


def before_a_picture() -> Case:
    """Points in focus before a picture of the world that is not."""
    case = lit_cases.environment()
    return replace(case, camera=replace(case.camera, aperture=Aperture(0.02, 4.0)))


def clear_smoke() -> Case:
    """Smoke without density before a sphere."""
    clear, ball = clouds.smoke_cloud(8, 0.0), build.points("leave out: behind", clouds.sphere_cloud())
    return Case(build.scene((build.points("leave out: clear", clear), build.moved((0, -2, 0))),
                             (ball, build.moved())), cameras.camera((0, -6, 0)))  # fmt: skip


def unlit(case: Case) -> Case:
    return with_scene(case, lights=(), world=World())
