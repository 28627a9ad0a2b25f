"""What of a scene is no number, or none that float32 can square, is left out or put into its range before it is drawn.

One such value in a sum would take the rest of the sum with it: a lamp without a place would put out all the others.
Points, triangles and strands are looked through where they are prepared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..numeric.vectors import cross, dot, each_block
from .camera import Camera
from .cloud import FARTHEST
from .lights import Light
from .materials import MaterialTable, default_materials
from .mesh import Mesh, squared_edges, triangle_corners
from .scene import Instances, Scene
from .world import World

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
# Lenses without a size blur nothing, and focus is as good as at infinity where it is farther than all else.
LENS_RANGES = {"radius": (-np.inf, FARTHEST), "focus": (1e-30, np.inf), "ratio": (1e-9, 1e9), "rotation": (-1e6, 1e6)}
LIGHT_FIELDS = ("position", "direction", "radius", "spot_cos", "spot_blend", "axis_u", "axis_v", "spread", "diffuse",
                "specular")  # fmt: skip
STRONGEST = 1e30  # of a lamp's colour; float32 holds it with the factors of a lamp's formula


def sound(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """The scene with such values alone, and warnings; the scene itself where there are none others."""
    warnings: list[str] = []
    lights = tuple(light for light in scene.lights if _shines(light, warnings))
    materials = _in_range(scene.materials, warnings)
    world, instances = _around(scene.world), _known_before(scene.instances)
    same = materials is scene.materials and world is scene.world and instances is scene.instances
    if len(lights) == len(scene.lights) and same:
        return scene, ()
    changed = replace(scene, lights=lights, materials=materials, world=world, instances=instances)
    return changed, tuple(warnings)


def sound_camera(camera: Camera) -> tuple[Camera, tuple[str, ...]]:
    """The same for a camera: without a lens that is none, and without a place before that is none."""
    changed: dict[str, Any] = {}
    warnings: tuple[str, ...] = ()
    lens = camera.aperture
    if lens is not None:
        wrong = [name for name, (low, high) in LENS_RANGES.items() if not _within(getattr(lens, name), low, high)]
        if wrong:
            changed["aperture"] = None
            warnings = (f"Camera: its lens's {' and '.join(wrong)} cannot be drawn, so nothing is out of focus",)
    before = "previous_view_from_world", "previous_clip_from_view"
    given = [matrix for name in before if (matrix := getattr(camera, name)) is not None]
    if not all(_within(matrix, -FARTHEST, FARTHEST) for matrix in given):
        changed |= dict.fromkeys(before)
    return (replace(camera, **changed) if changed else camera), warnings


def shown(scene: Scene, camera: Camera) -> tuple[Scene, Camera, tuple[str, ...]]:
    """The scene and its camera, and warnings. A camera that is nowhere, has no directions or projects all onto a line
    shows the world alone, as it does in Cycles: every ray of it is no number, and meets nothing."""
    wrong = [] if _turns(camera.view_from_world) else ["place or directions"]
    wrong += [] if _projects(camera.clip_from_view) else ["projection"]
    if not wrong:
        return scene, camera, ()
    camera = replace(camera, view_from_world=np.eye(4), clip_from_view=np.diag([1.0, 1.0, -1.0, 1.0]), aperture=None)
    nothing = replace(scene, geometries=(), instances=Instances(np.zeros(0, np.int32), np.zeros((0, 4, 4))), lights=())
    return nothing, camera, (f"Camera: its {' and '.join(wrong)} cannot be drawn, so only the world is seen",)


def _turns(matrix: np.ndarray) -> bool:
    return _within(matrix, -FARTHEST, FARTHEST) and bool(abs(np.linalg.det(matrix[:3, :3])) > 0.5)  # it is rigid


def _projects(matrix: np.ndarray) -> bool:
    return _within(matrix, -FARTHEST, FARTHEST) and bool(matrix[0, 0] and matrix[1, 1])


def _around(world: World) -> World:
    color = np.nan_to_num(world.color, nan=0.0, posinf=FARTHEST, neginf=0.0)
    if not np.array_equal(color, world.color):
        world = replace(world, color=color)
    turned = _within(world.world_rotation, -1.01, 1.01)  # float32's rounding, and no more
    return world if turned else replace(world, world_rotation=np.eye(3))


def _known_before(instances: Instances) -> Instances:
    """What was nowhere a frame before has not moved."""
    before = instances.previous
    if before is None or _within(before, -FARTHEST, FARTHEST):
        return instances
    good = (np.abs(before) <= FARTHEST).all(axis=(1, 2), keepdims=True)
    return replace(instances, previous=np.where(good, before, instances.world_from_object))


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


SMALLEST, LARGEST = 1e-18, 1e18  # edge length and coordinate whose squares float32 still holds


@dataclass(frozen=True)
class DroppedCounts:
    """Triangles that are not drawn, by reason. Each is counted once, under the first reason that holds."""

    bad_index: int = 0  # a corner refers to no vertex
    non_finite: int = 0  # a corner holds a NaN or an infinity
    huge: int = 0  # a coordinate beyond LARGEST
    tiny: int = 0  # all edges below SMALLEST
    degenerate: int = 0  # no area, or a height that is rounding noise

    @property
    def total(self) -> int:
        return self.bad_index + self.non_finite + self.huge + self.tiny + self.degenerate

    def message(self, name: str) -> str:
        """One warning that names the object, or "" where nothing was dropped."""
        reasons = {
            "with an index out of range": self.bad_index,
            "with NaN or infinite coordinates": self.non_finite,
            "too large": self.huge,
            "too small": self.tiny,
            "without area": self.degenerate,
        }
        parts = [f"{count} {reason}" for reason, count in reasons.items() if count]
        if not parts:
            return ""
        noun = "triangle is" if self.total == 1 else "triangles are"
        return f"{name}: {self.total} {noun} not drawn ({', '.join(parts)})"


def valid_triangles(mesh: Mesh) -> tuple[np.ndarray, DroppedCounts]:
    """Which triangles can be drawn, (T,) bool, and how many were dropped for which reason.

    A triangle is degenerate when a quarter of the spacing of float32 numbers, at its corner opposite the longest
    edge and along each coordinate axis, is enough to flatten it. Needles that are exactly representable stay,
    whatever their aspect ratio; so do triangles a few such spacings large, far from the origin.
    """
    triangles, vertices = mesh.triangles, len(mesh.position)
    count = len(triangles)
    ok = np.ones(count, bool)
    if count == 0:
        return ok, DroppedCounts()
    if triangles.min() < 0 or triangles.max() >= vertices:
        ok &= ((triangles >= 0) & (triangles < vertices)).all(axis=1)
    bad_index = count - int(np.count_nonzero(ok))

    dropped: list[list[int]] = []  # appending is safe from any thread

    def look(block: slice) -> None:
        rows = np.arange(block.start, block.stop)[ok[block]] if bad_index else block
        corners = triangle_corners(mesh, rows)
        extent = np.abs(corners).max(axis=0)  # per coordinate; NaN spreads
        largest = extent.max(axis=0)
        finite = np.isfinite(largest)
        small = largest <= LARGEST
        with np.errstate(invalid="ignore", over="ignore"):
            squared = squared_edges(corners)
            long_enough = squared.max(axis=0) >= SMALLEST**2
            flat = _degenerate(corners, squared, extent)
        kinds = ~finite, finite & ~small, small & ~long_enough, small & long_enough & flat
        dropped.append([int(np.count_nonzero(kind)) for kind in kinds])
        ok[rows] = small & long_enough & ~flat

    each_block(count, look)
    return ok, DroppedCounts(bad_index, *(sum(kind) for kind in zip(*dropped, strict=True)))


def _degenerate(corners: np.ndarray, squared: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """(n,) bool: moving the apex by a quarter of a float32 spacing flattens the triangle."""
    normal = cross(corners[1] - corners[0], corners[2] - corners[0])
    longest = squared.max(axis=0)
    # Most triangles are far from flat. The cross product of a shift and the base is at most shift times base.
    shift = 0.25 * np.finfo(np.float32).eps * extent.max(axis=0)
    flat = ~(dot(normal, normal) > 9 * shift * shift * longest)
    rows = np.flatnonzero(flat)
    if len(rows):
        corners, extent, normal = corners[:, :, rows], extent[:, rows], normal[:, rows]
        apex = squared[:, rows].argmax(axis=0)
        every = np.arange(len(rows))
        base = np.abs(corners[(apex + 2) % 3, :, every] - corners[(apex + 1) % 3, :, every]).T
        shift = 0.25 * np.finfo(np.float32).eps * extent
        noise = np.stack(
            [shift[(c + 1) % 3] * base[(c + 2) % 3] + shift[(c + 2) % 3] * base[(c + 1) % 3] for c in (0, 1, 2)]
        )
        flat[rows] = (np.abs(normal) <= noise).all(axis=0)
    return flat
