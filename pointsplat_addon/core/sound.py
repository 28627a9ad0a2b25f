"""What of a scene is no number, or none that float32 can square, is left out or put into its range before it is drawn.

One such value in a sum would take the rest of the sum with it: a lamp without a place would put out all the others.
Points, triangles and strands are looked through where they are prepared.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .cloud import FARTHEST
from .scene import Light, MaterialTable, Scene, default_materials

BRIGHTEST = 65504.0  # of half floats
# Of a table's columns: the range. What is no number becomes the default material's value.
RANGES: dict[str, tuple[float, float]] = {
    "base_color": (-BRIGHTEST, BRIGHTEST),
    "roughness": (0, 1),
    "metallic": (0, 1),
    "ior": (0, 1e6),
    "specular": (0, 1e6),
    "emission": (-1e9, 1e9),
    "alpha": (0, 1),
    "anisotropy": (-1, 1),
}
HAIR_RANGES = {"radial": (0, 1), "coat": (0, 1), "tilt": (-np.pi, np.pi), "lobes": (0, BRIGHTEST)}
LIGHT_FIELDS = ("position", "direction", "radius", "spot_cos", "spot_blend", "axis_u", "axis_v", "spread", "diffuse",
                "specular")  # fmt: skip
STRONGEST = 1e30  # of a lamp's colour; float32 holds it with the factors of a lamp's formula


def sound(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """The scene with such values alone, and warnings; the scene itself where there are none others."""
    warnings: list[str] = []
    lights = tuple(light for light in scene.lights if _shines(light, warnings))
    materials = _in_range(scene.materials, warnings)
    color = np.nan_to_num(scene.world.color, nan=0.0, posinf=FARTHEST, neginf=0.0)
    world = scene.world if np.array_equal(color, scene.world.color) else replace(scene.world, color=color)
    if len(lights) == len(scene.lights) and materials is scene.materials and world is scene.world:
        return scene, ()
    return replace(scene, lights=lights, materials=materials, world=world), tuple(warnings)


def _shines(light: Light, warnings: list[str]) -> bool:
    given = {name: getattr(light, name) for name in LIGHT_FIELDS}
    wrong = [name for name, value in given.items() if value is not None and not _within(value, -FARTHEST, FARTHEST)]
    wrong += [] if _within(light.color, -STRONGEST, STRONGEST) else ["color"]
    if wrong:
        warnings.append(f'Light "{light.name}": its {" and ".join(wrong)} cannot be drawn, so it gives no light')
    return not wrong


def _in_range(table: MaterialTable, warnings: list[str]) -> MaterialTable:
    default = default_materials()
    changed: dict[str, Any] = _clipped(table, RANGES, {name: getattr(default, name) for name in RANGES})
    hair = {} if table.hair is None else _clipped(table.hair, HAIR_RANGES, {})
    if hair and table.hair is not None:
        changed["hair"] = replace(table.hair, **hair)
    if changed:
        warnings.append(f"Materials: values of {', '.join(changed)} that cannot be drawn were put into their range")
    return replace(table, **changed) if changed else table


def _clipped(owner: Any, ranges: dict[str, tuple[float, float]], defaults: dict[str, Any]) -> dict[str, Any]:
    """The columns (M, ...) of `owner` that have to change."""
    changed = {}
    for name, (low, high) in ranges.items():
        column = getattr(owner, name)
        if column is None or _within(column, low, high):
            continue
        default = defaults.get(name)
        missing = 0.0 if default is None else default[:1]
        changed[name] = np.clip(np.where(np.isnan(column), missing, column), low, high).astype(column.dtype)
    return changed


def _within(value: np.ndarray | float, low: float, high: float) -> bool:
    """Whether all lie within the range; NaN lies in none."""
    array = np.asarray(value)
    return array.size == 0 or bool(array.min() >= low and array.max() <= high)
