"""Shadow tables of a scene's lamps: made once for lamps and geometry, and kept for every view.

What casts is every point set and every polygon, sampled as densely as the tables tell apart: not what a view draws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...core.light.light_table import sorted_by_kind
from ...core.scene.lights import Light
from ...core.scene.scene import Scene
from ...core.scene.settings import Settings
from ...core.shadow import builder
from ...core.shadow.strand_casters import StrandSegments
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.store import Store
from .batches import box_corner_casters, splat_batches, strand_segments
from .casting import casting_geometries, light_key, transmission_digest, why_no_shadows
from .floors import which_are_floors
from .packed_tables import PackedTables, pack
from .spacing import sample_spacings

MAX_TEXTURE_ROWS = 16384  # rows of a texture


@dataclass(frozen=True, eq=False)
class Shadows:
    """What lamps need to be shadowed on a device."""

    key: Key
    packed: PackedTables
    entries: int
    wide: bool  # some lamp's penumbrae are seen: samples of a picture see different points of it
    warnings: tuple[str, ...] = ()

    @property
    def nbytes(self) -> int:
        return self.packed.data.nbytes


def make_shadows(
    scene: Scene, settings: Settings, store: Store, check: Callable[[], None] = lambda: None
) -> tuple[Shadows | None, str]:
    """The tables of all lamps that cast shadows, in the order of lighting's rows; or None, and why."""
    why = why_no_shadows(scene, settings)
    if why:
        return None, why
    casters = casting_geometries(scene, store)
    if not casters:
        return None, "nothing casts shadows"
    floors = which_are_floors(scene, casters, store)
    if all(floors):
        return None, "there is nothing in the shadow of anything"
    held = tuple((c.geometry.key, c.matrices.tobytes()) for c in casters)
    lamps = tuple(light_key(light) for light in scene.lights if light.shadow)
    spacing = store.lookup(
        Key(Kind.CASTER_SPACINGS, hashed((held, lamps)), other=(settings.shadow_resolution, floors)),
        lambda: sample_spacings(casters, scene.lights, settings.shadow_resolution, store, floors),
    )
    look = tuple(
        (c.geometry.key, transmission_digest(scene, c.geometry), c.matrices.tobytes(), s)
        for c, s in zip(casters, spacing, strict=True)
    )
    matter = Key(Kind.CASTERS, hashed(look), other=settings.shadow_resolution)
    # Cells are as wide as they would be if floors cast, so that shadows on these do not move with what stands there.
    around = [box_corner_casters(c, store) for c, floor in zip(casters, floors, strict=True) if floor]
    lights = sorted_by_kind(scene.lights)
    keys = tuple(light_key(light) if light.shadow else None for light in lights)

    every = Key(Kind.SHADOW_TABLES, matter, other=keys)

    def make() -> Shadows:
        batches: list[builder.Casters] = []
        strands: list[StrandSegments] = []
        warnings: list[str] = []
        tables: list[builder.ShadowTable | None] = []
        for light, key in zip(lights, keys, strict=True):
            check()
            if key is None:
                tables.append(None)
                continue

            def build(light: Light = light) -> builder.ShadowTable | None:
                if not batches and not strands:
                    batches.extend(splat_batches(scene, casters, spacing, store, check))
                    strands.extend(strand_segments(casters, spacing, store))
                try:
                    every = [*batches, *(one.casters_toward(light) for one in strands)]
                    return builder.build_table(light, every, settings.shadow_resolution, around)
                except ValueError as error:
                    warnings.append(f"{light.name or 'A light'} casts no shadow: {error}")
                    return None

            tables.append(store.lookup(Key(Kind.SHADOW_TABLE, matter, other=key), build))
        packed = pack(tables, MAX_TEXTURE_ROWS)
        entries = sum(table.entries for table in tables if table is not None)
        wide = any(light.shadow and (light.radius > 0 or light.kind == "AREA") for light in lights)
        return Shadows(every, packed, entries, wide, tuple(warnings))

    return store.lookup(every, make), ""
