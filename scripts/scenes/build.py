"""Builds a `Scene` from geometries, their transforms, lights and materials, with plain defaults for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.numeric.segments import offsets
from pointsplat_addon.core.scene.captured import CapturedSplats
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import MaterialTable, default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.scene.world import World
from scripts.scenes.cameras import Vector


def sun(strength: float = 3.0, direction: Vector = (0.4, 0.7, -0.5)) -> Light:
    return Light("SUN", np.full(3, strength), np.zeros(3), np.asarray(direction) / np.linalg.norm(direction))


def materials(count: int = 1, **columns) -> MaterialTable:
    """Rows like the default one, of which `columns` replace some."""
    table = default_materials()
    names = {f: np.repeat(getattr(table, f), count, axis=0) for f in table.__dataclass_fields__ if f not in FIELDS}
    hashes = np.arange(1, count + 1, dtype=np.uint32) * np.uint32(0x01234567)
    names |= {"pass_index": np.arange(10, 10 + count, dtype=np.int32), "hash": hashes}
    given = {name: np.asarray(value, names[name].dtype) for name, value in columns.items() if name in names}
    rest = {name: value for name, value in columns.items() if name not in names}
    return replace(
        table, **{**names, "names": tuple(map(str, range(count))), "graphs": (None,) * count, **given, **rest}
    )


FIELDS = ("names", "graphs", "anisotropy", "translucent", "transmission_color", "glass", "media", "hair", "coat",
          "backlit", "tint", "gloss", "diffuse_roughness", "sheen", "toon", "holdout")  # fmt: skip


def moved(offset: Vector = (0, 0, 0), scale: float | Vector = 1.0) -> np.ndarray:
    matrix = np.diag(np.append(np.broadcast_to(np.asarray(scale, float), 3), 1.0))
    matrix[:3, 3] = offset
    return matrix


def scene(
    *things: tuple[Geometry, np.ndarray],
    lights: Sequence[Light] | None = None,
    world: World | None = None,
    table: MaterialTable | None = None,
    transparent: bool = False,
    holdout: Sequence[bool] | None = None,
    **more,
) -> Scene:
    """Instances (geometry, world_from_object) lit by one sun and a weak world."""
    geometries = tuple(dict.fromkeys(geometry for geometry, _ in things))
    count = len(things)
    instances = Instances(
        np.array([geometries.index(geometry) for geometry, _ in things], np.int32),
        np.array([matrix for _, matrix in things], float).reshape(count, 4, 4),
        pass_index=np.arange(1, count + 1, dtype=np.int32),
        holdout=None if holdout is None else np.asarray(holdout, bool),
        object_hash=np.arange(1, count + 1, dtype=np.uint32) * np.uint32(0x02468ACE),
        names=tuple(f"{geometry.name} {i}" for i, (geometry, _) in enumerate(things)),
    )
    return Scene(
        geometries,
        instances,
        table or materials(),
        tuple([sun()] if lights is None else lights),
        world or World(np.array([0.1, 0.12, 0.15])),
        transparent,
        **more,
    )


def points(key: str, cloud: PointCloud) -> Geometry:
    return Geometry(key, key, cloud=cloud)


def captured(key: str, splats: CapturedSplats) -> Geometry:
    return Geometry(key, key, captured=splats)


def mesh(of: Mesh, primitive: str = "AUTO", spacing: float = 0.0) -> Geometry:
    return Geometry(of.key, of.name, mesh=of, primitive=primitive, spacing=spacing)


def picture(width: int = 16, height: int = 8) -> Image:
    """Smooth colours, so that a texel's share of a pixel matters little."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    texels = np.stack([u, v, 1 - u * v, np.ones_like(u)], axis=-1)
    return Image(texels.astype(np.float32))


def strand_lines(key: str, strands: Sequence[np.ndarray], radius: float | np.ndarray, **more) -> Geometry:
    """Strands (n, 3) with a radius for all or one for each of their points."""
    position = np.concatenate(strands).astype(np.float32)
    start = offsets([len(strand) for strand in strands])
    radii = np.broadcast_to(np.asarray(radius, np.float32), len(position)).copy()
    return Geometry(key, key, strands=Strands(key, key, position, start, radii, **more), primitive="LINES")
