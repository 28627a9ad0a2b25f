"""Cases of captured Gaussian splats, alone and among other things."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from scripts.scenes.build import captured, materials, mesh, moved, points, scene
from scripts.scenes.cameras import Vector, camera
from scripts.scenes.case import Case
from scripts.scenes.clouds import smoke_cloud
from scripts.scenes.meshes import cube_mesh, plane_mesh, sphere_mesh

# Turned, sheared, unevenly scaled and mirrored.
SHEARED = np.array([[-1, -0.6, 0, -0.2], [0, 1.2, -0.3, 0], [0.2, 0, 0.5, 0.1], [0, 0, 0, 1.0]])


def random_splats(
    count: int, coefficients: int = 15, size: float = 0.05, seed: int = 0, spread: float = 1.0, **more
) -> CapturedSplats:
    """Splats of all shapes, with so many coefficients beyond degree 0, normally distributed about the origin.

    `size`: the median standard deviation. `spread`: that of positions.
    """
    rng = np.random.default_rng(seed)
    rotation = rng.normal(size=(count, 4))
    given = {
        "position": rng.normal(0, spread, (count, 3)),
        "scale": size * np.exp(rng.normal(0, 0.8, (count, 3))),
        "rotation": rotation / np.linalg.norm(rotation, axis=1, keepdims=True),
        "base": rng.normal(0.3, 0.8, (count, 3)),
        "opacity": rng.uniform(0, 1, count),
        "sh": rng.normal(0, 0.2, (count, coefficients, 3)),
    }
    arrays = {name: value.astype(np.float32) for name, value in given.items()}
    if coefficients == 0:
        del arrays["sh"]
    return CapturedSplats(**(arrays | more))


def one_splat(
    position: Vector,
    scale: float | Vector = 0.1,
    opacity: float = 1.0,
    color: Vector = (0.5, 0.5, 0.5),
    rotation: Vector = (1, 0, 0, 0),
    **more,
) -> CapturedSplats:
    """A splat that shows one display colour from all sides."""
    given = (position, np.broadcast_to(scale, 3), rotation, (np.asarray(color) - 0.5) / 0.28209479177387814)
    position, scales, turn, base = (np.array(value, np.float32)[None] for value in given)
    return CapturedSplats(position, scales, turn, base, np.array([opacity], np.float32), **more)


def captured_sphere(count: int, **more) -> CapturedSplats:
    """Disks of many sizes on the unit sphere, as training leaves them: neighbours have colours that are alike."""
    rng = np.random.default_rng(4)
    normal = rng.normal(size=(count, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    # A half turn about the axis half-way between z and the normal.
    half = normal + np.array([0, 0, 1.0001])
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    rotation = np.column_stack([np.zeros(count), half])
    scale = 0.006 * np.exp(rng.normal(0, 0.5, (count, 3))) * (1, 1, 0.1)
    base = 0.8 * np.sin(5 * normal) + rng.normal(0, 0.2, (count, 3))
    sh = rng.normal(0, 0.05, (count, 3, 3))
    given = (normal, scale, rotation, base, rng.uniform(0.2, 1, count), sh)
    position, scale, rotation, base, opacity, sh = (array.astype(np.float32) for array in given)
    return CapturedSplats(position, scale, rotation, base, opacity, sh, **more)


def captured_alone() -> Case:
    """A cloud of splats twice, once sheared and mirrored."""
    splats = captured("captured twice", random_splats(600, size=0.08))
    table = Settings(use_shadows=False)
    return Case(scene((splats, moved((0.3, 0, 0))), (splats, SHEARED), lights=()), camera(), table)


def captured_trained() -> Case:
    """The same over a world, blended in display values, as training did."""
    case = captured_alone()
    world = World(np.array([0.02, 0.3, 0.9]))
    return replace(
        case, scene=replace(case.scene, world=world), settings=replace(case.settings, captured_blending="TRAINED")
    )


def captured_among() -> Case:
    """Splats around a cube in smoke."""
    return Case(
        scene(
            (captured("captured among", random_splats(400, 3, size=0.1)), moved()),
            (points("smoke among captured", smoke_cloud()), moved((0.2, 0, 0))),
            (mesh(cube_mesh("cube among captured", 0.5), "POLYGONS"), moved((0.4, 0.3, 0))),
        ),
        camera(),
        Settings(use_shadows=False),
    )


def captured_among_panes() -> Case:
    """Splats around a cube, and two panes of glass, one close behind the other, before half of them."""
    table = materials(3, base_color=[[0.8] * 3, [0.9, 0.2, 0.1], [0.1, 0.3, 0.9]], alpha=[1.0, 0.4, 0.6],
                      translucent=np.array([False, True, True]))  # fmt: skip
    front, back = (replace(plane_mesh(f"pane {row} before captured", 0.7), materials=(row,)) for row in (1, 2))
    return Case(
        scene(
            (captured("captured among panes", random_splats(400, 3, size=0.1)), moved()),
            (mesh(cube_mesh("cube among captured and panes", 0.3), "POLYGONS"), moved((-0.4, 0.3, 0))),
            (mesh(front), moved((0.7, -0.6, 0))),
            (mesh(back), moved((0.7, -0.599, 0))),
            table=table,
        ),
        camera(),
        Settings(use_shadows=False),
    )


def captured_in_smoke() -> Case:
    """Splats in smoke, and nothing opaque."""
    return Case(
        scene(
            (captured("captured in smoke", random_splats(300, 0, size=0.1)), moved()),
            (points("smoke around captured", smoke_cloud()), moved()),
            world=World(np.array([0.1, 0.2, 0.3])),
        ),
        camera(),
        Settings(use_shadows=False),
    )


def captured_lit() -> Case:
    """A relit sphere of splats, and one that is shadowed by it and by a cube."""
    relit = replace(captured("captured relit", captured_sphere(2000)), lighting="RELIT")
    shadowed = replace(captured("captured shadowed", captured_sphere(2000)), lighting="SHADOWED")
    return Case(
        scene(
            (relit, moved((-0.6, -0.3, 0.3), 0.6)),
            (shadowed, moved((0.5, 0.4, -0.3), 0.8)),
            (mesh(cube_mesh("cube over captured", 0.3), "POLYGONS"), moved((0.3, -0.5, 0.6))),
        ),
        camera(),
        Settings(shadow_resolution=64),
    )


def captured_matte() -> Case:
    """A sphere of splats, a ball that stands for its surface, and a cube that casts a shadow onto both."""
    ball = mesh(sphere_mesh("matte of captured", 16), "POLYGONS")
    made = scene(
        (captured("captured on a matte", captured_sphere(2000)), moved((0, 0, -0.2), 0.8)),
        (ball, moved((0, 0, -0.2), 0.79)),
        (mesh(cube_mesh("cube over a matte", 0.3), "POLYGONS"), moved((-0.3, -0.7, 0.7))),
    )
    instances = replace(made.instances, matte=np.array([False, True, False]))
    return Case(replace(made, instances=instances), camera(), Settings(shadow_resolution=64))


def captured_far() -> Case:
    """Three spheres of many splats that are seen from so far away that nodes stand for them, with such a tolerance."""
    splats = captured("captured far", captured_sphere(40_000))
    eye = camera((0, -40, 0))
    return Case(
        scene((splats, moved()), (splats, moved((3, 0, 0))), (splats, moved((-3, 0, 0))), lights=()),
        eye,
        Settings(use_shadows=False, tolerance=2.0),
    )
