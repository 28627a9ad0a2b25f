"""Chooses how densely casters are sampled: meshes by points, strands by segments."""

from __future__ import annotations

import numpy as np

from ...core.scene.lights import Light
from ...core.shadow.grid import NARROW_ANGLE, rotation_to
from ...core.shadow.samples import surface_points
from ...core.surface.spacing import quantise_spacing
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .casting import CastingGeometry, cached_mesh_extents, cached_strands

MAX_SAMPLES = 1 << 20  # of all meshes together; if more are needed, the largest meshes are sampled more coarsely
CELLS_PER_SPACING = 1.2  # spacing in cells at which disks fit into cells once it is rounded to an octave
MIN_LIGHT_DISTANCE = 0.05  # of the scene's radius: lights nearer to a surface than this do not need finer samples
MAX_EXACT_INSTANCES = (
    64  # of one mesh, and meshes: of so many, the distance to a light is measured all over the surface
)


def sample_spacings(
    casters: list[CastingGeometry], lights: tuple[Light, ...], resolution: int, store: Store, floors: tuple[bool, ...]
) -> list[float]:
    """Returns the spacing of each caster's samples in object units: about a cell of the table with the finest cells.

    It is 0 for floors, and for clouds, whose own points cast. For strands it is the length of their segments.
    `resolution`: cells across a table.
    """
    meshes = [caster.geometry.mesh is not None for caster in casters]
    if not any(mesh or caster.geometry.strands is not None for mesh, caster in zip(meshes, casters, strict=True)):
        return [0.0] * len(casters)
    balls = [_bounding_balls(caster, store, len(casters)) for caster in casters]
    centre, radius = (np.concatenate(parts) for parts in zip(*balls, strict=True))
    low, high = (centre - radius[:, None]).min(axis=0), (centre + radius[:, None]).max(axis=0)
    reach = max(float(np.linalg.norm(high - low) / 2), 1e-30)
    cell = np.full(len(casters), np.inf)
    for light in lights:
        if light.shadow:
            step = _finest_cell(light, centre, radius, (low + high) / 2, resolution)
            near = [
                1.0 if light.kind == "SUN" else max(_distance_to_lit(light, c, r), MIN_LIGHT_DISTANCE * reach)
                for c, r in balls
            ]
            cell = np.minimum(cell, step * np.array(near))
    scale = np.array([c.scale.max() for c in casters])
    area = np.array([0.0 if floor else _total_area(c, store) for c, floor in zip(casters, floors, strict=True)])
    with np.errstate(divide="ignore", invalid="ignore"):
        spacing = CELLS_PER_SPACING * cell / scale
        samples = area / spacing**2
    some = np.array(meshes) & (spacing > 0) & np.isfinite(spacing) & (samples > 0)
    lengths = [_total_strand_length(caster, store) for caster in casters]
    strands = [max(s, sum(lengths) / MAX_SAMPLES) if one > 0 else 0.0 for s, one in zip(spacing, lengths, strict=True)]
    if not some.any():
        return strands
    many = samples[some] / samples_per_mesh(samples[some], MAX_SAMPLES)
    # Spacings are rounded down to an octave; if there are too many samples, to the nearest one.
    spacing[some] *= np.where(many > 1, np.sqrt(2 * many), 1)
    return [quantise_spacing(s) if ok else other for s, ok, other in zip(spacing.tolist(), some, strands, strict=True)]


def _total_strand_length(caster: CastingGeometry, store: Store) -> float:
    """Returns the length of all strands of all instances together, in object units."""
    if caster.geometry.strands is None:
        return 0.0
    strands = cached_strands(caster.geometry, store)
    step = np.linalg.norm(np.diff(strands.position, axis=0), axis=1)
    return len(caster.matrices) * float(step.sum() - step[strands.start[1:-1] - 1].sum())


def _bounding_balls(caster: CastingGeometry, store: Store, casters: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns centres (K, 3) and radii (K,), in world space, of balls that together bound a caster.

    For a mesh with few instances, in a scene of few `casters`, these are sample points all over it, with radius 0.
    """
    mesh = caster.geometry.mesh
    if mesh is None or max(len(caster.matrices), casters) > MAX_EXACT_INSTANCES:
        return caster.centre, caster.radius
    shape = cached_mesh_extents(caster.geometry, mesh, store)
    found = store.lookup(Key(Kind.CASTER_POSITIONS, caster.geometry.key), lambda: surface_points(mesh, shape))
    world = (
        np.einsum("iab,nb->ina", caster.matrices[:, :3, :3], found[:: len(caster.matrices)])
        + caster.matrices[:, None, :3, 3]
    )
    return world.reshape(-1, 3), np.zeros(world.size // 3)


def _total_area(caster: CastingGeometry, store: Store) -> float:
    """Returns the area of a mesh times its instances, in object units squared; 0 for other geometry."""
    mesh = caster.geometry.mesh
    return 0.0 if mesh is None else len(caster.matrices) * cached_mesh_extents(caster.geometry, mesh, store).size


def _distance_to_lit(light: Light, centre: np.ndarray, radius: np.ndarray) -> float:
    """Returns how near balls, centre (K, 3) and radius (K,), come to a light; infinity if it shines on none."""
    near = _distances_from_light(light, centre) - radius
    lit = near > -np.inf if light.kind != "AREA" else (centre - light.position) @ light.direction > -radius
    return float(near.min(where=lit, initial=np.inf))


def _distances_from_light(light: Light, points: np.ndarray) -> np.ndarray:
    return np.linalg.norm(points - light.position, axis=1)


def _finest_cell(light: Light, centre: np.ndarray, radius: np.ndarray, middle: np.ndarray, resolution: int) -> float:
    """Returns the side of the finest cells of a light's shadow table: radians, or world units for suns.

    `centre` (K, 3), `radius` (K,): balls that bound all casters. `middle`: (3,) their centre. `resolution`: cells
    across the table, which is framed as fit_frame does.
    """
    if light.kind == "SUN":
        along, half = (centre - middle) @ rotation_to(light.direction)[1:].T, radius[:, None]
        return float(((along + half).max(axis=0) - (along - half).min(axis=0)).max()) / resolution
    axis, seen, away = (
        middle - light.position,
        centre - light.position,
        np.maximum(_distances_from_light(light, centre), 1e-30),
    )
    cosine = seen @ axis / (away * max(float(np.linalg.norm(axis)), 1e-30))
    angle = np.arccos(np.clip(cosine, -1, 1)) + np.arcsin(np.clip(radius / away, 0, 1))
    widest = float(angle.max())
    return (2 * widest if widest <= NARROW_ANGLE else np.pi) / resolution


def samples_per_mesh(samples: np.ndarray, most: float) -> float:
    """Returns the largest number of samples that one mesh may have, so that all meshes together have at most `most`.

    `samples`: (M,) how many each mesh needs. Small meshes get all that they need, large ones equally many.
    """
    ascending = np.sort(samples)
    others = len(samples) - np.arange(len(samples))
    each = (most - (np.cumsum(ascending) - ascending)) / others
    fits = np.flatnonzero(ascending > each)
    return float(each[fits[0]]) if len(fits) else float(ascending[-1])
