"""Makes what casts the shadows of a scene's lights, once for all views, and caches it by lights and geometry.

Lights see opaque meshes and clouds in depth maps, which the device draws (maps.py), and strands, too, where the
visibility buffer draws. Panes have layers of depth maps (panes.py), or faces that lights with a size look at
(pane_faces.py). All else casts into tables, sampled as densely as these resolve, independent of any view: what else
light passes through, strands as wide as ropes, and by other techniques all strands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...core.light.light_table import sorted_by_kind
from ...core.numeric.record import record
from ...core.scene.camera import Camera
from ...core.scene.lights import Light
from ...core.scene.scene import Scene
from ...core.scene.settings import Settings
from ...core.shadow import builder
from ...core.shadow.grid import Frame, Grid
from ...core.shadow.level import TableLevel
from ...core.shadow.strand_casters import StrandSegments
from ...core.shadow.table import Emitter, ShadowTable
from ..cache.keys import Key, Kind
from ..cache.keys import digest as hashed
from ..cache.on_disk import NOWHERE, OnDisk, form_of_records
from ..cache.store import Store
from .batches import box_corner_casters, splat_batches, strand_segments
from .casting import CastingGeometry, caster_keys, casting_geometries, light_key, why_no_shadows
from .floors import is_lone_body, split_floors
from .maps import ShadowMaps, casts_as_strands, casts_into_map, make_maps, takes_map
from .packed_tables import PackedTables, pack
from .pane_faces import PaneFaces, make_faces, takes_faces
from .panes import PaneMaps, casts_as_pane, make_panes, takes_panes
from .spacing import sample_spacings

MAX_TEXTURE_ROWS = 16384  # rows of a texture
TABLE_FORM = form_of_records(ShadowTable, Frame, Emitter, TableLevel, Grid)


@record
class Tables:
    """The shadow tables of those lights of a scene that have one, packed for a device."""

    key: Key
    packed: PackedTables
    entries: int  # of all tables together
    wide: bool  # some light has a size: each sample of a picture uses another point of it
    warnings: tuple[str, ...] = ()

    @property
    def nbytes(self) -> int:
        return self.packed.data.nbytes


@record
class Shadows:
    """What casts the shadows of a scene: at least one of these."""

    tables: Tables | None
    maps: ShadowMaps | None
    panes: PaneMaps | None = None
    faces: PaneFaces | None = None

    @property
    def key(self) -> tuple[Key | None, ...]:
        """Of what casts, for all views."""
        maps = self.maps and (self.maps.of_scene or self.maps)
        return tuple(one and one.key for one in (self.tables, maps, self.panes, self.faces))

    @property
    def wide(self) -> bool:
        """Whether each sample of a picture uses another point of some light."""
        return self.tables is not None and self.tables.wide

    @property
    def warnings(self) -> tuple[str, ...]:
        return () if self.tables is None else self.tables.warnings


def make_shadows(
    scene: Scene,
    settings: Settings,
    store: Store,
    check: Callable[[], None] = lambda: None,
    texture_size: int = MAX_TEXTURE_ROWS,
    camera: Camera | None = None,
    on_disk: OnDisk = NOWHERE,
) -> tuple[Shadows | None, str]:
    """Returns the shadows of all lights and an empty string; or None and the reason, if no light casts any.

    Tables and maps are in the order of the light table's rows. `check` is called between steps, and may raise to stop.
    A light whose table cannot be built casts no shadow, and a warning says so. `texture_size`: of the device. `camera`:
    that sees the shadows; None: they are for all cameras, also inside of things. `on_disk`: where tables are kept.
    """
    why = why_no_shadows(scene, settings)
    if why:
        return None, why
    casters = casting_geometries(scene, store)
    if not casters:
        return None, "nothing casts shadows"
    fog = scene.world.fog is not None  # which lies behind everything
    if camera is not None and not fog and is_lone_body(scene, casters, camera, store):
        return None, "a convex body is alone"
    casters, floors = (casters, (False,) * len(casters)) if fog else split_floors(scene, casters, store)
    if all(floors):
        return None, "there is nothing in the shadow of anything"
    lights = sorted_by_kind(scene.lights)
    solid = [casts_into_map(scene, caster) for caster in casters]
    # Where sub-samples are not looked at one by one, single texels are noisier than tables.
    fine = settings.technique == "VISIBILITY"
    fibres = [fine and casts_as_strands(caster) for caster in casters]
    drawn = [one or other for one, other in zip(solid, fibres, strict=True)]
    shown = [caster for caster, one, floor in zip(casters, drawn, floors, strict=True) if one and not floor]
    maps = make_maps(scene, lights, shown, settings.shadow_resolution, store, texture_size)
    clear, even = ([casts_as_pane(scene, caster, varying) for caster in casters] for varying in (True, False))
    shown = [caster for caster, one, floor in zip(casters, clear, floors, strict=True) if one and not floor]
    panes = make_panes(scene, lights, shown, settings.shadow_resolution, store, texture_size)
    shown = [caster for caster, one, floor in zip(casters, even, floors, strict=True) if one and not floor]
    faces = make_faces(scene, lights, shown, store)
    build = _TableBuilder(scene, settings.shadow_resolution, store, on_disk, check)
    everything = _Cast(casters, floors)
    unmapped = [light for light in lights if light.shadow and not takes_map(light)]
    mapped = [light for light in lights if light.shadow and takes_map(light)]
    through_maps = [one for one in mapped if panes is not None and takes_panes(one)]
    through_faces = [one for one in mapped if faces is not None and takes_faces(one)]
    others = [one for one in mapped if one not in through_maps and one not in through_faces]
    wanted = [(unmapped, everything), (others, everything.without(drawn))]
    for looking, shown_there in ((through_maps, clear), (through_faces, even)):
        neither = [one or other for one, other in zip(drawn, shown_there, strict=True)]
        wanted.append((looking, everything.without(neither)))
    tables = build.tables(lights, wanted)
    if tables is None and maps is None and panes is None and faces is None:
        return None, "there is nothing in the shadow of anything"
    return Shadows(tables, maps, panes, faces), ""


@record
class _Cast:
    """Casters of some tables."""

    casters: list[CastingGeometry]
    floors: tuple[bool, ...]  # which of them have nothing behind them

    @property
    def any(self) -> bool:
        return not all(self.floors)

    def without(self, some: Sequence[bool]) -> _Cast:
        """Returns all casters but some, (C,)."""
        rest = [k for k, one in enumerate(some) if not one]
        return _Cast([self.casters[k] for k in rest], tuple(self.floors[k] for k in rest))


class _TableBuilder:
    """Builds tables of lights."""

    def __init__(self, scene: Scene, resolution: int, store: Store, on_disk: OnDisk, check: Callable[[], None]) -> None:
        self._scene, self._resolution, self._store, self._check = scene, resolution, store, check
        self._on_disk = on_disk
        self._warnings: list[str] = []

    def tables(self, lights: Sequence[Light], wanted: list[tuple[list[Light], _Cast]]) -> Tables | None:
        """Returns the tables of `lights`, of which each is `wanted` for some casters or has none; None if none has
        one."""
        found: dict[int, tuple[Key, Callable[[], builder.ShadowTable | None]]] = {}
        for some, cast in wanted:
            if some and cast.any:
                found |= self._of_lights(some, cast)
        if not found:
            return None
        keys = tuple(found[id(light)][0] if id(light) in found else None for light in lights)
        key = Key(Kind.SHADOW_TABLES, keys)

        def make() -> Tables:
            made: list[builder.ShadowTable | None] = []
            for light in lights:
                self._check()
                one = found.get(id(light))
                made.append(None if one is None else self._store.lookup(*one))
            entries = sum(table.entries for table in made if table is not None)
            wide = any(light.radius > 0 or light.kind == "AREA" for light in lights if id(light) in found)
            return Tables(key, pack(made, MAX_TEXTURE_ROWS), entries, wide, tuple(self._warnings))

        return self._store.lookup(key, make)

    def _of_lights(
        self, lights: list[Light], cast: _Cast
    ) -> dict[int, tuple[Key, Callable[[], builder.ShadowTable | None]]]:
        """Returns the key of each light's table, and what builds it."""
        scene, store, resolution, casters = self._scene, self._store, self._resolution, cast.casters
        held = tuple((c.geometry.key, c.matrices.tobytes()) for c in casters)
        spacing = store.lookup(
            Key(
                Kind.CASTER_SPACINGS,
                hashed((held, tuple(light_key(light) for light in lights))),
                other=(resolution, cast.floors),
            ),
            lambda: sample_spacings(casters, tuple(lights), resolution, store, cast.floors),
        )
        look = tuple((*key, length) for key, length in zip(caster_keys(scene, casters), spacing, strict=True))
        casters_key = Key(Kind.CASTERS, hashed(look), other=resolution)
        # Cells are as wide as if floors cast, so that shadows on a floor do not shift when the objects on it move.
        around = [box_corner_casters(c, store) for c, floor in zip(casters, cast.floors, strict=True) if floor]
        batches: list[builder.Casters] = []
        strands: list[StrandSegments] = []

        def build(light: Light) -> builder.ShadowTable | None:
            if not batches and not strands:
                batches.extend(splat_batches(scene, casters, spacing, store, self._check))
                strands.extend(strand_segments(casters, spacing, store))
            try:
                all_casters = [*batches, *(one.casters_toward(light) for one in strands)]
                return builder.build_table(light, all_casters, resolution, around)
            except ValueError as error:
                self._warnings.append(f"{light.name or 'A light'} casts no shadow: {error}")
                return None

        keys = [Key(Kind.SHADOW_TABLE, casters_key, other=light_key(light)) for light in lights]
        return {
            id(light): (key, lambda key=key, light=light: self._on_disk.lookup(key, lambda: build(light), TABLE_FORM))
            for key, light in zip(keys, lights, strict=True)
        }
