"""Blender's materials to the material table: constants, graphs for inputs that vary over a surface, and media.

How translucent surfaces are simplified is said in surface.py.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from functools import partial
from typing import Any

import bpy
import numpy as np

from ....core.material.evaluation import CHANNELS
from ....core.material.expression import Expression, constant, walk
from ....core.material.graph import MaterialGraph
from ....core.material.masks import is_mask
from ....core.material.nodes import input_nodes
from ....core.material.nodes.view_nodes import READ_EYE
from ....core.numeric.cryptomatte import cryptomatte_hash
from ....core.numeric.record import record
from ....core.scene.materials import CoatTable, HairTable, MaterialTable, default_materials
from ....core.scene.volume import Medium
from .displacement import read_displacement
from .media import read_medium
from .nodes.table import tree_reader
from .nodes.tree import FindPlacement, HairConstants, Placement, TreeReader, UnsupportedNodeError, nowhere
from .surface import SURFACE_NORMAL, WHITE, ZERO, Surface, is_constant
from .surface_shaders import read_surface

DEFAULT_SURFACE = "default_surface"  # what Cycles calls the surface of faces without a material
VARYING_DEFAULTS = {  # the table's constant of a channel that varies
    "base_color": (0.8, 0.8, 0.8),
    "roughness": (0.5,),
    "metallic": (0.0,),
    "alpha": (1.0,),
    "emission": (0.0, 0.0, 0.0),
    "transmission_color": (1.0, 1.0, 1.0),
}


NO_GLOSS = (-1.0, -1.0, -1.0, 0.0)


@record
class Coat:
    """One row of core's CoatTable; the defaults are Blender's."""

    weight: float = 0.0
    roughness: float = 0.03
    ior: float = 1.5
    tint: tuple[float, ...] = (1.0, 1.0, 1.0)


@record
class MaterialRow:
    """One material as a row of core's MaterialTable."""

    constants: dict[str, tuple[float, ...]]  # every column of floats of MaterialTable
    graph: MaterialGraph | None
    cull: bool
    pass_index: int
    name: str
    hash: int
    translucent: bool = False
    glass: bool = False
    transmission_color: tuple[float, ...] | None = None
    medium: Medium | None = None
    hair: HairConstants | None = None
    coat: Coat | None = None
    backlit: tuple[float, ...] = (0.0, 0.0, 0.0)
    tint: tuple[float, ...] = (1.0, 1.0, 1.0)
    gloss: tuple[float, ...] = NO_GLOSS  # MaterialTable.gloss
    diffuse_roughness: float = 0.0
    sheen: tuple[float, ...] = (0.0, 0.0, 0.0, 0.5)  # colour times weight, roughness
    toon: tuple[float, ...] | None = None  # size and smoothness
    holdout: float = 0.0
    warnings: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Content key of all that affects how the material looks."""
        varying = "" if self.graph is None else self.graph.digest
        volume = None if self.medium is None else [np.asarray(v).tolist() for v in vars(self.medium).values()]
        light = self.translucent, self.glass, self.transmission_color
        shown = sorted(self.constants.items()), varying, self.cull, light, volume, self.hair, self.coat, self.backlit
        more = self.tint, self.gloss, self.diffuse_roughness, self.sheen, self.toon, self.holdout
        text = repr((*shown, *more, self.pass_index, self.name))
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def convert_materials(
    materials: Iterable[bpy.types.Material | None],
    placement: Callable[[bpy.types.Material], Placement | None] = lambda material: None,
) -> tuple[MaterialTable, list[str]]:
    """The table of materials, and warnings: the default material in row 0, then `materials` in their order.

    materials: evaluated ones; None, an empty material slot, is the default material. placement: returns where a
    material is shown; it is asked for those that read that.
    """
    table = default_materials()
    rows = [
        _default_row(table),
        *(_default_row(table) if m is None else convert_material(m, partial(placement, m)) for m in materials),
    ]
    floats = {
        name: np.array([row.constants[name] for row in rows], np.float32).reshape(
            len(rows), *getattr(table, name).shape[1:]
        )
        for name in rows[0].constants
    }
    converted = MaterialTable(
        **floats,
        transmission_color=_transmission_colors(rows),
        cull=np.array([row.cull for row in rows]),
        pass_index=np.array([row.pass_index for row in rows], np.int32),
        hash=np.array([row.hash for row in rows], np.uint32),
        names=tuple(row.name for row in rows),
        anisotropy=_column_or_none(np.float32, [row.medium.anisotropy if row.medium else 0 for row in rows]),
        translucent=_column_or_none(bool, [row.translucent for row in rows]),
        glass=_column_or_none(bool, [row.glass for row in rows]),
        media=tuple(row.medium for row in rows),
        graphs=tuple(row.graph for row in rows),
        hair=_hair_columns(rows),
        coat=_coat_columns(rows),
        backlit=_backlit_column(rows),
        tint=_column_unless(1, [row.tint for row in rows]),
        gloss=_gloss_column(rows),
        diffuse_roughness=_column_or_none(np.float32, [row.diffuse_roughness for row in rows]),
        sheen=np.array([row.sheen for row in rows], np.float32) if any(any(row.sheen[:3]) for row in rows) else None,
        toon=_column_unless(-1, [row.toon or (-1.0, -1.0) for row in rows]),
        holdout=_column_or_none(np.float32, [row.holdout for row in rows]),
    )
    return converted, [warning for row in rows for warning in row.warnings]


def _gloss_column(rows: list[MaterialRow]) -> np.ndarray | None:
    return None if all(row.gloss == NO_GLOSS for row in rows) else np.array([row.gloss for row in rows], np.float32)


def _hair_columns(rows: list[MaterialRow]) -> HairTable | None:
    """The constants of hair of all rows; None if no material has a shader for hair."""
    if not any(row.hair for row in rows):
        return None
    constants = [row.hair or HairConstants() for row in rows]
    columns = {name: np.array([getattr(h, name) for h in constants], np.float32) for name in vars(HairConstants())}
    return HairTable(used=np.array([row.hair is not None for row in rows]), **columns)


def _coat_columns(rows: list[MaterialRow]) -> CoatTable | None:
    """The coats of all rows; None if nothing is coated."""
    if not any(row.coat for row in rows):
        return None
    coats = [row.coat or Coat() for row in rows]
    return CoatTable(**{name: np.array([getattr(c, name) for c in coats], np.float32) for name in vars(Coat())})


def _backlit_column(rows: list[MaterialRow]) -> np.ndarray | None:
    """(M, 3) float32; None if nothing is lit from behind."""
    return np.array([row.backlit for row in rows], np.float32) if any(any(row.backlit) for row in rows) else None


def _transmission_colors(rows: list[MaterialRow]) -> np.ndarray | None:
    """The column of transmission colours; None if all materials pass all channels alike."""
    varying = any(row.graph is not None and row.graph.transmission_color is not None for row in rows)
    white = VARYING_DEFAULTS["transmission_color"]
    colors = np.array([row.transmission_color or white for row in rows], np.float32)
    return colors if varying or (colors < 1).any() else None


def _column_or_none(dtype: type, values: list) -> np.ndarray | None:
    """A column of the table; None, which the table allows, if all values are zero or False."""
    return np.array(values, dtype) if any(values) else None


def _column_unless(default: float, values: list[tuple[float, ...]]) -> np.ndarray | None:
    """A column of the table; None if all values are the default one."""
    column = np.array(values, np.float32)
    return None if (column == default).all() else column


def _default_row(table: MaterialTable) -> MaterialRow:
    """What faces without a material have in Cycles: a dull surface before Blender 5, then the Principled BSDF."""
    if bpy.app.version < (5, 0, 0):
        table = replace(table, specular=np.zeros(1, np.float32))
    names = (f.name for f in fields(MaterialTable) if getattr(getattr(table, f.name), "dtype", None) == np.float32)
    constants = {name: tuple(np.ravel(getattr(table, name)[0]).tolist()) for name in names}
    return MaterialRow(
        constants,
        None,
        bool(table.cull[0]),
        int(table.pass_index[0]),
        table.names[0],
        cryptomatte_hash(DEFAULT_SURFACE),
    )


def convert_material(material: bpy.types.Material, placement: FindPlacement = nowhere) -> MaterialRow:
    """One material as a row of the table.

    A surface that cannot be converted gets the viewport's colour, and one warning.
    """
    tree = tree_reader(material.name, placement, material.pass_index)
    output = output_node(material)
    if output is not None:
        tree.normal = read_displacement(tree, material, output)
    surface = _material_surface(material, output, tree)
    translucent = _is_translucent(surface)
    if not translucent:
        surface = replace(surface, transmission_color=WHITE)
    else:
        kinds = {type(node) for node in walk(surface.alpha, surface.transmission_color)}
        if kinds & {input_nodes.Backfacing, *READ_EYE}:
            seen = "all saw the front of it" if input_nodes.Backfacing in kinds else "it were seen from all sides"
            tree.warnings.append(f'Material "{material.name}": lights with a size cast its shadows as though {seen}')
    constants, graph = _split_constants(surface, tree)
    passes = constants.pop("transmission_color")
    return MaterialRow(
        constants=constants,
        graph=graph,
        cull=material.use_backface_culling,
        pass_index=material.pass_index,
        name=material.name,
        hash=cryptomatte_hash(material.name),
        translucent=translucent,
        glass=translucent and tree.glass,
        transmission_color=passes if min(passes) < 1 else None,
        medium=None if output is None else read_medium(tree, output.inputs["Volume"]),
        hair=tree.hair,
        coat=_coat(surface, tree),
        backlit=_backlit(surface, tree),
        **_reflection(surface, tree),
        warnings=tuple(tree.warnings),
    )


def _is_translucent(surface: Surface) -> bool:
    """Whether a surface has to be blended: its alpha is neither 1 nor a mask, or what passes is coloured.

    A mask lies between 0 and 1 along its edges alone. It is cut out, which is sharp and fast, and of whose edges pixels
    show the mean; what the material asks of other engines, blended or dithered, changes nothing.
    """
    value = constant(surface.alpha)
    if value is not None:
        return bool(value[0] < 1 - 1e-6)
    depends = input_nodes.ObjectValue, input_nodes.Backfacing, *READ_EYE
    if any(isinstance(node, depends) for node in walk(surface.alpha)):
        return True  # meshes that several objects show are cut out alike, and seen from either side
    return not is_mask(surface.alpha) or not is_constant(surface.transmission_color, 1)


def _node_tree(material: bpy.types.Material) -> bpy.types.ShaderNodeTree | None:
    """The material's nodes; None if it does not use them."""
    # Blender 5 has no materials without nodes, and use_nodes warns there
    without_nodes = bpy.app.version < (5, 0, 0) and not material.use_nodes
    return None if without_nodes else material.node_tree


def output_node(material: bpy.types.Material) -> bpy.types.Node | None:
    """The active output node for any engine, else that for Cycles or EEVEE; None if there is none."""
    tree = _node_tree(material)
    outputs = map(tree.get_output_node, ("ALL", "CYCLES", "EEVEE")) if tree else ()
    return next((o for o in outputs if o is not None), None)


def _material_surface(material: bpy.types.Material, output: bpy.types.Node | None, tree: TreeReader) -> Surface:
    if output is None:
        return Surface() if _node_tree(material) else _surface_without_nodes(material)
    if not output.inputs["Surface"].is_linked:
        # A volume has no surface of its own
        return Surface(alpha=ZERO) if output.inputs["Volume"].is_linked else Surface()
    try:
        return read_surface(tree, output.inputs["Surface"], ())
    except UnsupportedNodeError as reason:
        # Other warnings of the tree no longer matter
        tree.hair, tree.glass = None, False
        tree.warnings[:] = [f'Material "{material.name}": {reason}; its viewport colour is shown']
        return _viewport_surface(material)


def _surface_without_nodes(material: bpy.types.Material) -> Surface:
    """What Cycles makes of a material without nodes: Lambert's, of its viewport colour alone."""
    return Surface(
        base_color=input_nodes.Constant(tuple(material.diffuse_color)[:3]), specular=input_nodes.Constant((0.0,))
    )


def _viewport_surface(material: bpy.types.Material) -> Surface:
    return Surface(
        base_color=input_nodes.Constant(tuple(material.diffuse_color)[:3]),
        roughness=input_nodes.Constant((material.roughness,)),
        metallic=input_nodes.Constant((material.metallic,)),
        specular=input_nodes.Constant((material.specular_intensity,)),
    )


def _split_constants(surface: Surface, tree: TreeReader) -> tuple[dict[str, tuple[float, ...]], MaterialGraph | None]:
    """The parameters that are constant, for the table, and a graph of the others; None if there are no others."""
    constants: dict[str, tuple[float, ...]] = {}
    varying: dict[str, Expression] = {}
    for name, (_, top) in CHANNELS.items():
        expression = getattr(surface, name)
        if name == "tangent":
            if expression.varies:
                varying[name] = expression
            continue
        if name == "normal":
            # A normal that is the same everywhere comes from an empty or broken input
            if (
                expression is not SURFACE_NORMAL
                and expression.varies
                and not isinstance(expression, input_nodes.Coordinates)
            ):
                varying[name] = expression
            continue
        value = constant(expression)
        if value is None:
            varying[name] = expression
            constants[name] = VARYING_DEFAULTS[name]
        else:
            constants[name] = tuple(np.clip(np.nan_to_num(value), 0, top).tolist())
    for name, fallback in (("ior", 1.5), ("specular", 0.5)):
        value = constant(getattr(surface, name))
        if value is None:
            tree.warnings.append(f'Material "{tree.material_name}": varying {name} is replaced by {fallback}')
        constants[name] = (fallback,) if value is None else (max(float(value[0]), 0.0),)
    return constants, MaterialGraph(**varying) if varying else None


def _coat(surface: Surface, tree: TreeReader) -> Coat | None:
    """The surface's coat; None if it has none or one that varies, with a warning."""
    if is_constant(surface.coat, 0):
        return None
    parts = (surface.coat, surface.coat_roughness, surface.coat_ior, surface.coat_tint)
    values = [value for part in parts if (value := constant(part)) is not None]
    if len(values) < len(parts):
        tree.warnings.append(f'Material "{tree.material_name}": its coat varies, and is left out')
        return None
    weight, roughness, ior, tint = (np.clip(np.nan_to_num(value), 0, None).tolist() for value in values)
    return Coat(min(weight[0], 1.0), min(roughness[0], 1.0), max(ior[0], 1.0), tuple(tint[:3]))


def _backlit(surface: Surface, tree: TreeReader) -> tuple[float, ...]:
    """The share of the diffuse light that comes from behind; where it varies none, with a warning."""
    value = constant(surface.backlit)
    if value is None:
        tree.warnings.append(f'Material "{tree.material_name}": its translucency varies, and is lit from the front')
        return (0.0, 0.0, 0.0)
    return tuple(np.clip(np.nan_to_num(np.broadcast_to(value, 3)), 0, 1).tolist())


def _reflection(surface: Surface, tree: TreeReader) -> dict[str, Any]:
    """The fields of MaterialRow that tell of reflection and holdouts; the defaults, with a warning, of what varies."""

    def known(name: str, what: str) -> list[float] | None:
        value = constant(getattr(surface, name))
        if value is None:
            tree.warnings.append(f'Material "{tree.material_name}": its {what} varies, and is left out')
            return None
        return np.clip(np.nan_to_num(value), 0, None).tolist()

    found: dict[str, Any] = {}
    if (tint := known("tint", "specular tint")) is not None:
        found["tint"] = tuple(np.broadcast_to(tint, 3).tolist())
    if (gloss := constant(surface.gloss)) is not None:
        found["gloss"] = tuple(gloss.tolist())
    if (rough := known("diffuse_roughness", "diffuse roughness")) is not None:
        found["diffuse_roughness"] = min(rough[0], 1.0)
    if not is_constant(surface.sheen, 0):
        sheen, rough = known("sheen", "sheen"), known("sheen_roughness", "sheen")
        if sheen is not None and rough is not None:
            found["sheen"] = *np.minimum(np.broadcast_to(sheen, 3), 1).tolist(), min(rough[0], 1.0)
    if (toon := known("toon", "toon shading")) is not None and toon[-1] > 0:
        if toon[-1] < 1:
            tree.warnings.append(f'Material "{tree.material_name}": all diffuse light of its mixture is a toon')
        found["toon"] = tuple((np.array(toon[:2]) / toon[-1]).tolist())
    if (cut := known("holdout", "holdout")) is not None:
        found["holdout"] = min(cut[0], 1.0)
        if cut[0] > 0 and not is_constant(surface.alpha, 1):
            tree.warnings.append(f'Material "{tree.material_name}": its holdout is transmissive, and is drawn black')
    return found
