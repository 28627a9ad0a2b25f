"""A furnished room with twelve lights of 0.3 m, in Blender."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from scripts.common.volume_objects import surface
from scripts.studies import gallery

WIDE, DEEP, HIGH = 6.0, 5.0, 3.0  # metres
ACROSS, ALONG = 4, 3  # lights
LIGHT = 0.3  # metres across
POWER = 10.0  # watts


def room(below: float, size: int, aim: Callable) -> None:
    """About 20,000 triangles. Every other light is a disk that faces down, so many metres below the ceiling; the others
    are round bulbs."""
    scene = gallery.studio(size)
    bpy.data.objects.remove(scene.objects["Sun"])
    colors = {"walls": (0.75, 0.72, 0.66), "floor": (0.35, 0.22, 0.12), "wood": (0.5, 0.32, 0.18),
              "red": (0.6, 0.1, 0.08), "blue": (0.1, 0.2, 0.5), "white": (0.85, 0.85, 0.85)}  # fmt: skip
    looks = {name: surface(name, color) for name, color in colors.items()}

    def shown(look: str) -> bpy.types.Object:
        item = bpy.context.object
        item.data.materials.clear()
        item.data.materials.append(looks[look])
        return item

    def box(look: str, low: tuple[float, float, float], high: tuple[float, float, float]) -> None:
        bpy.ops.mesh.primitive_cube_add(size=1)
        item = shown(look)
        item.location = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
        item.scale = [b - a for a, b in zip(low, high, strict=True)]

    box("floor", (-WIDE / 2, -DEEP / 2, -0.1), (WIDE / 2, DEEP / 2, 0))
    box("white", (-WIDE / 2, -DEEP / 2, HIGH), (WIDE / 2, DEEP / 2, HIGH + 0.1))
    box("walls", (-WIDE / 2 - 0.1, -DEEP / 2, 0), (-WIDE / 2, DEEP / 2, HIGH))
    box("walls", (WIDE / 2, -DEEP / 2, 0), (WIDE / 2 + 0.1, DEEP / 2, HIGH))
    box("walls", (-WIDE / 2, DEEP / 2, 0), (WIDE / 2, DEEP / 2 + 0.1, HIGH))
    for x in (-1.4, 1.4):
        box("wood", (x - 0.9, -0.5, 0.7), (x + 0.9, 0.5, 0.75))
        for leg in ((-0.85, -0.45), (-0.85, 0.45), (0.85, -0.45), (0.85, 0.45)):
            bpy.ops.mesh.primitive_cylinder_add(radius=0.03, depth=0.7, location=(x + leg[0], leg[1], 0.35))
            shown("wood")
        for seat in (-0.45, 0.45):
            box("blue", (x + seat - 0.2, -1.1, 0.42), (x + seat + 0.2, -0.7, 0.46))
            box("blue", (x + seat - 0.2, -1.12, 0.46), (x + seat + 0.2, -1.08, 0.95))
    for shelf in range(4):
        box("wood", (-2.9, 2.0, 0.5 + 0.5 * shelf), (-1.0, 2.45, 0.53 + 0.5 * shelf))
    for i, x in enumerate((-1.9, -0.9, 0.9, 1.9)):
        bpy.ops.mesh.primitive_monkey_add(size=0.45, location=(x, 0.05, 0.95), rotation=(-0.4, 0, 0.3 * i - 0.5))
        head = shown(("red", "white", "blue", "white")[i])
        head.modifiers.new("Smooth", "SUBSURF").render_levels = 1
        head.data.shade_smooth()
    for i in range(6):
        location = (-2.7 + 0.32 * i, 2.2, 1.15)
        bpy.ops.mesh.primitive_torus_add(
            major_radius=0.1, minor_radius=0.03, location=location, rotation=(1.4, 0, 0.2 * i)
        )
        shown(("red", "white", "blue")[i % 3])
    lights(scene, below)
    scene.camera.data.angle, scene.camera.data.clip_end = 1.15, 100.0
    aim(scene.camera, (0.9, -2.45, 1.75), (-0.1, 0.6, 0.9))


def lights(scene: bpy.types.Scene, below: float) -> None:
    for i in range(ACROSS * ALONG):
        disk = i % 2 == 0
        data = bpy.data.lights.new("Light", "AREA" if disk else "POINT")
        data.energy = POWER
        if disk:
            data.shape, data.size = "DISK", LIGHT
        else:
            data.shadow_soft_size = LIGHT / 2
        item = bpy.data.objects.new("Light", data)
        x, y = WIDE * ((i % ACROSS + 0.5) / ACROSS - 0.5), DEEP * ((i // ACROSS + 0.5) / ALONG - 0.5)
        item.location = x, y, HIGH - (below if disk else 0.5)
        scene.collection.objects.link(item)
