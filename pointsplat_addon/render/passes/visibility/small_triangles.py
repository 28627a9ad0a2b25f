"""Draws small triangles into the visibility buffer by compute shaders, where a mesh has many of them.

A rasteriser sets each triangle up before it knows whether it covers anything, which takes longer than drawing one of
a few cells. One compute invocation draws a triangle of some cells, in two passes of atomics, as splats are drawn
(splat_ids.py). Triangles that cover many cells or cross the near plane are listed and rasterised before that.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.lattice import Lattice
from ....shading.interface import Interface
from ..uniforms import CAMERA_FIELDS, ONE_INSTANCE_FIELDS, Fields, block
from .buffer import LATTICE_DEFINE, LATTICE_FIELDS
from .pictures import define_entries
from .polygon_mesh import BLOCK_DEFINES, Group

MOST_CELLS = 64  # of the rectangle around a triangle that a compute invocation draws
FEWEST_TRIANGLES = 20_000  # fewer are rasterised in the time that the passes take to start
CELLS_OF_SMALL = 8.0  # of a mesh's rectangle in the picture, for each of its triangles
LISTED = 1 << 18  # triangles that a list holds; where more are not small, the rasteriser is given all
LIST_SAMPLER = ("UINT_2D", "ps_list")


def group_fields(one: bool, blocks: bool = False) -> Fields:
    """Which triangles are drawn: the first corner of the group, its corners, and the first instance. `one`: there is
    one. `blocks`: the first block alone."""
    if blocks:
        return (("int", "first"),)
    return (("int", "first"), *(() if one else (("int", "corners"), ("int", "first_slot"))))


def are_small(count: int, rectangles: np.ndarray, cells: tuple[int, int]) -> bool:
    """Whether most of so many triangles of a mesh or a page cover few cells.

    rectangles: (I, 4) of all instances, in shares of a picture of `cells`, low and high corner.
    """
    low, high = rectangles[:, :2], rectangles[:, 2:]
    covered = float((high - low).clip(0.0).prod(axis=1).sum()) * cells[0] * cells[1]
    return count >= FEWEST_TRIANGLES and covered <= CELLS_OF_SMALL * count


def is_cut(group: Group) -> bool:
    """Whether the alpha of a group of triangles varies, which the rasteriser draws."""
    return any(name.endswith("ALPHA") for name in group.defines)


def triangle_program(lattice: Lattice, group: Group, one: bool, step: str, normal: bool = False) -> Interface:
    """Returns the compute program of one `step`: LIST, DEPTH or IDENTIFY. `one`: there is one instance. `normal`:
    normals tell surfaces apart."""
    images = {"LIST": ("list", "list_length"), "DEPTH": ("depths",), "IDENTIFY": ("ids", "keys")}[step]
    identify, culled = step == "IDENTIFY", group.cull and step != "LIST"
    sizes = ("elements", *(("list_size",) if step == "LIST" else ()))
    own: Fields = (*group_fields(one, group.blocks), *(("int", name) for name in sizes))
    if identify:
        own = (*own, ("int", "first_id"), *(() if group.blocks else (("int", "material"), ("int", "triangles"))))
    alone: Fields = ONE_INSTANCE_FIELDS if one else ()
    if one and (identify or culled):
        alone = (*alone, ("int", "instance"), ("int", "mirrored"))
    flags = {"PS_CULL": culled, "PS_NORMAL": identify and normal, "PS_ONE_INSTANCE": one,
             f"PS_{step}": step != "DEPTH"}  # fmt: skip
    return Interface(
        "polygons",
        compute="visibility/triangle.comp",
        block=block("Triangles", CAMERA_FIELDS, own, alone, LATTICE_FIELDS),
        samplers=(
            ("FLOAT_2D", "ps_corner"),
            *(() if one else (("FLOAT_2D", "ps_instances"),)),
            *((("FLOAT_2D", "ps_blocks"),) if group.blocks else ()),
            *((("UINT_2D", "ps_depths"),) if identify else ()),
        ),
        images=tuple(("R32UI", name) for name in images),
        defines=(
            LATTICE_DEFINE,
            ("PS_MOST_CELLS", str(MOST_CELLS)),
            *define_entries(name for name, on in flags.items() if on),
            *(BLOCK_DEFINES if group.blocks else ()),
        ),
    )
