"""Draws polygons into the visibility buffer, and the attributes of those that stand for groups into the G-buffer."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Block, Interface
from ...device.packing import PAGE_WIDTH
from ...device.protocol import Device, Texture
from ..gbuffer import GBuffer, Variant
from ..grouping.groups import Groups, Leaders
from ..shading.lighting import SAMPLE_FIELDS
from ..uniforms import (
    CAMERA_FIELDS,
    FOOTPRINT_FIELDS,
    ONE_INSTANCE_FIELDS,
    RECTANGLE_FIELDS,
    Fields,
    SampleView,
    block,
)
from .buffer import (
    DEPTH_ONLY_DEFINE,
    DEPTH_OUTPUT,
    LATTICE_DEFINE,
    LATTICE_FIELDS,
    OUTPUTS,
    DepthBuffer,
    IdBuffer,
    VisibilityBuffer,
    member_defines,
    offset_defines,
    rank_defines,
)
from .pictures import define_entries, level_defines, level_samplers
from .polygon_draw import Drawn
from .polygon_mesh import BLOCK_DEFINES, CORNERS, Group
from .polygons import CUT_VARYING, PATCH_VARYING, needed_defines
from .small_triangles import LIST_SAMPLER, LISTED, group_fields, is_cut, triangle_program

MOST_VERTICES = 1 << 26  # of one draw
AVERAGE_DEFINE = ("PS_AVERAGE", "1")  # pictures are averaged over sub-samples
ID_FIELDS: Fields = (("int", "first_id"),)  # number of the first triangle of the first instance
# Of what is drawn layer by layer: from which depths on, and up to which.
FOLLOWING, OPAQUE = "ps_following", "ps_opaque_depths"
MESH_FIELDS: Fields = (
    ("int", "material"),
    *ID_FIELDS,
    ("int", "triangles"),  # of the mesh
)


def _block(name: str, group: Group, one: bool, own: Fields, of_one: Fields, *groups: Fields) -> Block:
    """The uniforms of a pass; `of_one`: what is read only where there is one instance."""
    alone = (*ONE_INSTANCE_FIELDS, ("int", "instance"), *of_one) if one else ()
    return block(name, CAMERA_FIELDS, ID_FIELDS if group.blocks else MESH_FIELDS, own, alone, *groups)


def depths_program(lattice: Lattice, group: Group, one: bool, listed: bool = False) -> Interface:
    """Returns the program that draws the depth of a group of triangles, whichever side they show. `one`: there is one
    instance. `listed`: those of a list alone."""
    return _cover_program(lattice, replace(group, cull=False), one, (), listed)


def ids_program(
    normal: bool,
    lattice: Lattice,
    group: Group,
    one: bool,
    listed: bool = False,
    peeled: tuple[str, ...] = (),
    keyed: bool = True,
) -> Interface:
    """Returns the program that draws a group of triangles into the visibility buffer.

    `normal`: something is lit, and normals tell surfaces apart. `one`: there is one instance. `listed`: those of a list
    alone. `peeled`: FOLLOWING, where only what lies behind the layers before is drawn, and OPAQUE, where it lies before
    what is opaque. `keyed`: into an IdBuffer otherwise.
    """
    varyings = [("flat", "uint", "v_id")]
    varyings += [("flat", "vec3" if group.blocks else "vec2", "v_about")] if keyed else []
    identity = (*varyings, *((("smooth", "vec3", "v_normal"),) if normal else ()))
    return _cover_program(lattice, group, one, identity, listed, peeled, keyed)


def _cover_program(
    lattice: Lattice,
    group: Group,
    one: bool,
    identity: tuple[tuple[str, str, str], ...],
    listed: bool,
    peeled: tuple[str, ...] = (),
    keyed: bool = True,
) -> Interface:
    """Returns the program that draws a group of triangles. `identity`: varyings that tell triangles and surfaces apart;
    none: only depths are drawn."""
    normal = any(name == "v_normal" for _, _, name in identity)
    baked = ("PS_UV", "PS_PICTURE", "PS_BAKED_ALPHA") if "PS_BAKED_ALPHA" in group.defines else ()
    names = [name for name in group.defines if name.startswith((*baked, "PS_CORNER_ALPHA"))]
    if "PS_CORNER_ALPHA" in names:
        names.append("PS_CORNER_COLOR")
    samplers = ["ps_corner", *(() if one else ("ps_instances",)), *(("ps_blocks",) if group.blocks else ())]
    varyings = [("smooth", "vec3", "v_position"), *identity]
    if "PS_UV" in names:
        samplers += ["ps_corner_uv", "ps_baked_color"]
        varyings.append(("smooth", "vec2", "v_uv"))
    if "PS_CORNER_COLOR" in names:
        samplers.append("ps_corner_color")
        varyings.append(("smooth", "vec4", "v_color"))
    cut = any(name.endswith("ALPHA") for name in names)
    if cut:
        varyings.append(CUT_VARYING)
    levels = level_samplers(group.textures, ["PS_BAKED_COLOR"]) if "PS_UV" in names else []
    samplers += levels
    varyings += [PATCH_VARYING] if levels else []
    names += level_defines(levels, ())
    own = group_fields(one, group.blocks)
    sample = (*(SAMPLE_FIELDS if cut else ()), *(FOOTPRINT_FIELDS if levels else ()))
    alone = (*ONE_INSTANCE_FIELDS, *((("int", "instance"),) if cut else ())) if one else ()
    flags = {"PS_CULL": group.cull, "PS_NORMAL": normal, "PS_ONE_INSTANCE": one, "PS_CUT": cut,
             "PS_LISTED": listed, "PS_PEELED": FOLLOWING in peeled, "PS_WITHOUT_KEYS": not keyed,
             "PS_BEFORE_OPAQUE": OPAQUE in peeled, DEPTH_ONLY_DEFINE[0]: not identity}  # fmt: skip
    return Interface(
        "polygons" if identity else "shadow maps",
        vertex="visibility/polygon_ids.vert",
        fragment="visibility/polygon_ids.frag",
        block=_block("PolygonIds", group, one, own, (("int", "mirrored"),), LATTICE_FIELDS, sample)
        if identity and keyed
        else block("PeeledIds", CAMERA_FIELDS, MESH_FIELDS[1:], own, alone, LATTICE_FIELDS, sample)
        if identity
        else block("PolygonDepths", CAMERA_FIELDS, own, alone, LATTICE_FIELDS, sample),
        samplers=(
            *(("FLOAT_2D", name) for name in samplers),
            *((LIST_SAMPLER,) if listed else ()),
            *(("UINT_2D", name) for name in peeled),
        ),
        varyings=tuple(varyings),
        outputs=(OUTPUTS if keyed else OUTPUTS[:2]) if identity else DEPTH_OUTPUT,
        defines=(
            LATTICE_DEFINE,
            *define_entries([*names, *(name for name, on in flags.items() if on)]),
            *(BLOCK_DEFINES if group.blocks else ()),
            *(rank_defines(lattice) if cut else ()),
        ),
        depth=True,
    )


def surface_program(
    variant: Variant, lattice: Lattice, group: Group, one: bool, leaders: Leaders, placed: Collection[str] = ()
) -> Interface:
    """Returns the program that writes the attributes of triangles that stand for groups of sub-samples. `placed`: the
    samplers of PLACED that hold what is evaluated there of them."""
    names = [name for name in needed_defines(variant, group) if not name.endswith("ALPHA")]
    names = [name for name in names if not (name.startswith("PS_CORNER") and _placed_name(name) in placed)]
    names += [name.upper() for name in placed]
    samplers = ["ps_corner", *(("ps_corner_uv",) if "PS_UV" in names else ()), *(() if one else ("ps_instances",))]
    samplers += ["ps_blocks"] if group.blocks else []
    samplers += [name for name in CORNERS if name.upper() in names]
    samplers += placed
    samplers += [name for name in group.textures if name.upper() in names]
    kinds = {"COLOR": variant.color, "SURFACE": variant.surface, "EMISSION": variant.emission}
    if any(on and not _ways(kind) & set(names) for kind, on in kinds.items()):
        samplers.append("ps_materials")
    averaged = not leaders.central and bool({"PS_BAKED_COLOR", "PS_BAKED_SURFACE", "PS_BAKED_EMISSION"} & set(names))
    keyed = variant.spread and "PS_PLACED_NORMAL" not in names
    read = ("ps_first", "ps_second") if averaged or keyed else ()
    bent = variant.spread and bool({"PS_BAKED_NORMAL", "PS_BAKED_HEIGHT"} & set(names))
    levels = level_samplers(group.textures, names) if averaged or bent else []
    samplers += levels
    read += ("ps_ids", "ps_depths") if averaged or bent else ()
    read += ("ps_keys",) if keyed and not bent else ()
    own: Fields = (("int", "first_triangle"), ("int", "last_triangle"), *(() if one else (("int", "slots"),)))
    if group.blocks:
        own = (*group_fields(one, group.blocks), ("int", "triangles"))
    return Interface(
        "attributes",
        vertex="common/rectangle.vert",
        fragment="grouping/polygon_surface.frag",
        block=_block(
            "PolygonSurface",
            group,
            one,
            own,
            (("int", "holdout"),),
            RECTANGLE_FIELDS,
            leaders.fields,
            LATTICE_FIELDS if read else (),
            FOOTPRINT_FIELDS if levels else (),
        ),
        samplers=(*(("FLOAT_2D", name) for name in samplers), *leaders.samplers, *(("UINT_2D", name) for name in read)),
        outputs=variant.outputs(),
        defines=(
            *define_entries([*variant.defines, *names, *level_defines(levels, group.defines)]),
            *((("PS_ONE_INSTANCE", "1"),) if one else ()),
            *offset_defines(lattice),
            *((LATTICE_DEFINE, *member_defines(lattice)) if read else ()),
            *((AVERAGE_DEFINE,) if averaged else ()),
            *(BLOCK_DEFINES if group.blocks else ()),
            *leaders.defines,
        ),
    )


def _ways(kind: str) -> set[str]:
    """The defines of where an attribute may come from, but for constants."""
    return {f"PS_{way}_{kind}" for way in ("BAKED", "CORNER", "PLACED")}


def _placed_name(name: str) -> str:
    return name.replace("PS_CORNER", "PS_PLACED").lower()


class PolygonDepths:
    """Draws the depths of polygons."""

    def __init__(self, device: Device, draws: list[Drawn], buffer: DepthBuffer) -> None:
        self._device, self.draws, self._depths = device, draws, buffer
        self._list: Texture | None = None  # of triangles that are not small, and its length
        self._length: Texture | None = None
        if any(draw.small for draw in draws):
            self._list = device.texture((PAGE_WIDTH, LISTED // PAGE_WIDTH), "R32UI")
            self._length = device.texture((1, 1), "R32UI")

    def rasterise(self, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws polygons, but for small ones of meshes that have many. Comes before `cover`."""
        for draw in self.draws:
            for group in draw.groups:
                if _in_compute(draw, group):
                    self._rasterise_wide(draw, group, view, shared)
                    continue
                for run in draw.runs(group):
                    self._rasterise(draw, run, view, shared)

    def cover(self, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws the others, nearer than what is there."""
        self._compute("DEPTH", view, shared, {"depths": self._depths.depths})

    def _raster_program(self, draw: Drawn, group: Group, listed: bool) -> Interface:
        return depths_program(self._depths.lattice, group, draw.one, listed)

    def _compute_program(self, draw: Drawn, group: Group, step: str) -> Interface:
        return triangle_program(self._depths.lattice, replace(group, cull=False), draw.one, step)

    def _compute(self, step: str, view: SampleView, shared: dict[str, Texture], images: dict[str, Texture]) -> None:
        """Runs one step of the compute shaders over all meshes of many small triangles."""
        for draw in self.draws:
            for group in draw.groups:
                if _in_compute(draw, group):
                    program = self._compute_program(draw, group, step)
                    for run in draw.runs(group):
                        for slot, slots in _steps(draw, run):
                            self._dispatch(program, draw, run, slot, slots, view, shared, images)

    def _dispatch(
        self,
        program: Interface,
        draw: Drawn,
        group: Group,
        slot: int,
        slots: int,
        view: SampleView,
        shared: dict[str, Texture],
        images: dict[str, Texture],
    ) -> None:
        elements = group.count // 3 * slots
        own = {"first_slot": slot, "elements": elements, "list_size": LISTED}
        textures = {**shared, **draw.mesh.textures, **draw.textures, **self._depths.textures}
        self._device.dispatch(
            program,
            -(-elements // program.local_size),
            uniforms=self._record(program, draw, group, view, **own),
            textures=textures,
            images=images,
        )

    def _rasterise(
        self,
        draw: Drawn,
        group: Group,
        view: SampleView,
        shared: dict[str, Texture],
        slot: int = 0,
        slots: int | None = None,
        listed: int = 0,
    ) -> None:
        """Draws a group of triangles, of `slots` instances from `slot` on; `listed`: so many that are listed."""
        program = self._raster_program(draw, group, listed > 0)
        lists = {} if self._list is None or not listed else {"ps_list": self._list}
        for first, count in _steps(draw, group, slot, slots):
            self._device.draw(
                program,
                self._depths.target,
                uniforms=self._record(program, draw, group, view, first_slot=first),
                textures={**shared, **draw.mesh.textures, **group.textures, **draw.textures, **lists},
                vertices=3 * listed or group.count * count,
                depth_test=True,
            )

    def _rasterise_wide(self, draw: Drawn, group: Group, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws the triangles of a group that are not small; where they are too many, all."""
        assert self._list is not None
        assert self._length is not None
        program = self._compute_program(draw, group, "LIST")
        images = {"list": self._list, "list_length": self._length}
        for slot, slots in _steps(draw, group):
            self._device.fill(self._list)
            self._device.fill(self._length)
            runs = draw.runs(group)
            for run in runs:
                self._dispatch(program, draw, run, slot, slots, view, shared, images)
            count = (int(self._device.read(self._length)[0, 0]) + 1) & 0xFFFFFFFF
            if 0 < count <= LISTED:
                # Triangles of one instance are listed by their numbers in the mesh.
                self._rasterise(draw, replace(group, first=0) if draw.one else group, view, shared, slot, slots, count)
            elif count:
                for run in runs:
                    self._rasterise(draw, run, view, shared, slot, slots)

    def _record(self, program: Interface, draw: Drawn, group: Group, view: SampleView, **own: object) -> np.ndarray:
        about = {"material": group.material, "first_id": draw.first_id, "triangles": draw.of_slot}
        where = {"first": group.first, "corners": group.count, **self._depths.values}
        return view.record_of(program.block, **about, **where, **draw.values, **own)

    def release(self) -> None:
        for draw in self.draws:
            draw.release()
        for texture in (self._list, self._length):
            if texture is not None:
                texture.release()


def _in_compute(draw: Drawn, group: Group) -> bool:
    """Whether compute shaders draw the small triangles of a group."""
    return draw.small and not is_cut(group)


def _steps(draw: Drawn, group: Group, slot: int = 0, slots: int | None = None) -> Iterator[tuple[int, int]]:
    """(first slot, number of slots) of what is drawn at once, of `slots` from `slot` on; None: of all."""
    end, step = draw.repeats if slots is None else slot + slots, max(MOST_VERTICES // group.count, 1)
    for first in range(slot, end, step):
        yield first, min(step, end - first)


class PolygonCover(PolygonDepths):
    """Draws the polygons of one picture into its visibility buffer."""

    def __init__(
        self,
        device: Device,
        draws: list[Drawn],
        buffer: IdBuffer,
        normal: bool,
        peeled: tuple[str, ...] = (),
    ) -> None:
        """`normal`: normals tell surfaces apart. `peeled`: see `ids_program`; the rasteriser draws all, and is given
        these textures."""
        super().__init__(device, draws, buffer)
        self._buffer, self._normal, self._peeled = buffer, normal, peeled

    def identify(self, view: SampleView, shared: dict[str, Texture]) -> None:
        """Draws the numbers of what `cover` has drawn."""
        assert isinstance(self._buffer, VisibilityBuffer)
        self._compute("IDENTIFY", view, shared, {"ids": self._buffer.ids, "keys": self._buffer.keys})

    def _raster_program(self, draw: Drawn, group: Group, listed: bool) -> Interface:
        return ids_program(
            self._normal, self._buffer.lattice, group, draw.one, listed, self._peeled, self._buffer.keyed
        )

    def _compute_program(self, draw: Drawn, group: Group, step: str) -> Interface:
        return triangle_program(self._buffer.lattice, group, draw.one, step, self._normal)

    def write_attributes(
        self,
        variant: Variant,
        view: SampleView,
        shared: dict[str, Texture],
        groups: Groups,
        leaders: Leaders,
        out: GBuffer,
        placed: dict[str, Texture],
    ) -> None:
        """Writes the attributes of the triangles that stand for groups. `placed`: textures of PLACED, as long as the
        list of groups."""
        sub_samples = {**leaders.bound, **groups.codes, **self._buffer.textures}
        footprint = view.footprint * self._buffer.lattice.spacing
        for draw in self.draws:
            where = groups.rectangle(leaders, draw.first_id)
            if where is None:
                continue
            for group in draw.groups:
                here = {name: placed[name] for name in group.placed if name in placed}
                program = surface_program(variant, self._buffer.lattice, group, draw.one, leaders, here)
                first = group.first // 3
                own = {"first_triangle": first, "last_triangle": first + group.count // 3, "slots": draw.repeats}
                own |= {"rectangle": where, "corner": leaders.place[1]}
                self._device.draw(
                    program,
                    out.target,
                    uniforms=self._record(program, draw, group, view, footprint=footprint, **own),
                    textures={**shared, **draw.mesh.textures, **group.textures, **draw.textures, **sub_samples, **here},
                    vertices=6,
                )
