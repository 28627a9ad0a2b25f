"""Makes the shadow tables of a scene's lights, once for all views, and caches them by lights and geometry.

All point sets, polygons and strands cast shadows, sampled as densely as the tables resolve, independent of any view.
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
from .floors import split_floors
from .packed_tables import PackedTables, pack
from .spacing import sample_spacings

MAX_TEXTURE_ROWS = 16384  # rows of a texture


@dataclass(frozen=True, eq=False)
class Shadows:
    """The shadow tables of all lights of a scene, packed for a device."""

    key: Key
    packed: PackedTables
    entries: int  # of all tables together
    wide: bool  # some light has a size: each sample of a picture uses another point of it
    warnings: tuple[str, ...] = ()

    @property
    def nbytes(self) -> int:
        return self.packed.data.nbytes


def make_shadows(
    scene: Scene, settings: Settings, store: Store, check: Callable[[], None] = lambda: None
) -> tuple[Shadows | None, str]:
    """Returns the shadow tables of all lights and an empty string; or None and the reason, if no light needs a table.

    The tables are in the order of the light table's rows.
    `check` is called between steps, and may raise to stop. A light whose table cannot be built casts no shadow, and
    a warning says so.
    """
    why = why_no_shadows(scene, settings)
    if why:
        return None, why
    casters = casting_geometries(scene, store)
    if not casters:
        return None, "nothing casts shadows"
    casters, floors = split_floors(scene, casters, store)
    if all(floors):
        return None, "there is nothing in the shadow of anything"
    held = tuple((c.geometry.key, c.matrices.tobytes()) for c in casters)
    casting_lights = tuple(light_key(light) for light in scene.lights if light.shadow)
    spacing = store.lookup(
        Key(Kind.CASTER_SPACINGS, hashed((held, casting_lights)), other=(settings.shadow_resolution, floors)),
        lambda: sample_spacings(casters, scene.lights, settings.shadow_resolution, store, floors),
    )
    look = tuple(
        (c.geometry.key, transmission_digest(scene, c.geometry), c.matrices.tobytes(), s)
        for c, s in zip(casters, spacing, strict=True)
    )
    casters_key = Key(Kind.CASTERS, hashed(look), other=settings.shadow_resolution)
    # Cells are as wide as if floors cast, so that shadows on a floor do not shift when the objects on it move.
    around = [box_corner_casters(c, store) for c, floor in zip(casters, floors, strict=True) if floor]
    lights = sorted_by_kind(scene.lights)
    keys = tuple(light_key(light) if light.shadow else None for light in lights)

    tables_key = Key(Kind.SHADOW_TABLES, casters_key, other=keys)

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
                    all_casters = [*batches, *(one.casters_toward(light) for one in strands)]
                    return builder.build_table(light, all_casters, settings.shadow_resolution, around)
                except ValueError as error:
                    warnings.append(f"{light.name or 'A light'} casts no shadow: {error}")
                    return None

            tables.append(store.lookup(Key(Kind.SHADOW_TABLE, casters_key, other=key), build))
        packed = pack(tables, MAX_TEXTURE_ROWS)
        entries = sum(table.entries for table in tables if table is not None)
        wide = any(light.shadow and (light.radius > 0 or light.kind == "AREA") for light in lights)
        return Shadows(tables_key, packed, entries, wide, tuple(warnings))

    return store.lookup(tables_key, make), ""
