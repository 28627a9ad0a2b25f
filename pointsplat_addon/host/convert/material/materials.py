"""Blender's materials to the material table: constants, graphs for inputs that vary over a surface, and media.

Light passes a translucent surface along a straight line and unchanged in colour: a surface has one alpha. Glass is
thin. What it reflects is a mirror that covers as much as Fresnel's equation reflects at normal incidence; the mean of
its tint tells how much of the rest passes, and what colour the tint has beyond that is shown as if it were painted on.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace

import bpy
import numpy as np

from ....core.material.evaluation import CHANNELS
from ....core.material.expression import Expression, constant
from ....core.material.graph import MaterialGraph
from ....core.material.masks import is_mask
from ....core.material.nodes import color_nodes, input_nodes, math_nodes
from ....core.material.nodes.hair_nodes import HairColor
from ....core.numeric.cryptomatte import cryptomatte_hash
from ....core.scene.materials import HairTable, MaterialTable, default_materials
from ....core.scene.volume import Medium
from .media import medium_of
from .nodes import Hair, Path, Reader, UnsupportedNodeError, Walker, default, of_strand, resolve

BLACK = input_nodes.Constant((0.0, 0.0, 0.0))
ZERO, ONE = input_nodes.Constant((0.0,)), input_nodes.Constant((1.0,))
GLASS = input_nodes.Constant((1.5,))  # Principled's default index of refraction
DEFAULT_SURFACE = "default_surface"  # what Cycles calls the surface of faces without a material
CLEAR = input_nodes.Constant((1.0, 1.0, 1.0))
FACING = input_nodes.Coordinates("normal")
PLACEHOLDER = {  # the table's constant of a channel that varies
    "base_color": (0.8, 0.8, 0.8),
    "roughness": (0.5,),
    "metallic": (0.0,),
    "alpha": (1.0,),
    "emission": (0.0, 0.0, 0.0),
}


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface as the Principled model has it. The defaults are a black body that shows nothing."""

    base_color: Expression = BLACK
    roughness: Expression = ONE
    metallic: Expression = ZERO
    alpha: Expression = ONE
    emission: Expression = BLACK
    normal: Expression = FACING
    ior: Expression = GLASS
    specular: Expression = ZERO


@dataclass(frozen=True, eq=False)
class Row:
    """One row of the material table."""

    constants: dict[str, tuple[float, ...]]  # every column of floats of MaterialTable
    graph: MaterialGraph | None
    cull: bool
    pass_index: int
    name: str
    hash: int
    translucent: bool = False
    medium: Medium | None = None
    hair: Hair | None = None
    warnings: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        varying = "" if self.graph is None else self.graph.digest
        volume = None if self.medium is None else [np.asarray(v).tolist() for v in vars(self.medium).values()]
        shown = sorted(self.constants.items()), varying, self.cull, self.translucent, volume, self.hair
        text = repr((*shown, self.pass_index, self.name))
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def convert_materials(materials: Iterable[bpy.types.Material | None]) -> tuple[MaterialTable, list[str]]:
    """The table, with the default material in row 0 and `materials` (evaluated ones) from row 1 on, and warnings.

    None, an empty material slot, is the default material.
    """
    table = default_materials()
    rows = [_default_row(table), *(_default_row(table) if m is None else convert_material(m) for m in materials)]
    floats = {
        name: np.array([row.constants[name] for row in rows], np.float32).reshape(
            len(rows), *getattr(table, name).shape[1:]
        )
        for name in rows[0].constants
    }
    converted = MaterialTable(
        **floats,
        cull=np.array([row.cull for row in rows]),
        pass_index=np.array([row.pass_index for row in rows], np.int32),
        hash=np.array([row.hash for row in rows], np.uint32),
        names=tuple(row.name for row in rows),
        anisotropy=_column(np.float32, [row.medium.anisotropy if row.medium else 0 for row in rows]),
        translucent=_column(bool, [row.translucent for row in rows]),
        media=tuple(row.medium for row in rows),
        graphs=tuple(row.graph for row in rows),
        hair=_hair_table(rows),
    )
    return converted, [warning for row in rows for warning in row.warnings]


def _hair_table(rows: list[Row]) -> HairTable | None:
    if not any(row.hair for row in rows):
        return None
    every = [row.hair or Hair() for row in rows]
    columns = {name: np.array([getattr(h, name) for h in every], np.float32) for name in vars(Hair())}
    return HairTable(used=np.array([row.hair is not None for row in rows]), **columns)


def _column(dtype: type, values: list) -> np.ndarray | None:
    """A column of the table, or None where it says nothing."""
    return np.array(values, dtype) if any(values) else None


def _default_row(table: MaterialTable) -> Row:
    names = (f.name for f in fields(MaterialTable) if getattr(getattr(table, f.name), "dtype", None) == np.float32)
    constants = {name: tuple(np.ravel(getattr(table, name)[0]).tolist()) for name in names}
    return Row(
        constants,
        None,
        bool(table.cull[0]),
        int(table.pass_index[0]),
        table.names[0],
        cryptomatte_hash(DEFAULT_SURFACE),
    )


def material_key(material: bpy.types.Material) -> str:
    """A digest of everything that affects how a material looks, pictures' content included; stable across runs."""
    return convert_material(material).key


def convert_material(material: bpy.types.Material) -> Row:
    """One row of the table. Surfaces that have no counterpart show the viewport colour, with one warning."""
    walker = Walker(material.name)
    output = _output_of(material)
    surface = _surface_of(material, output, walker)
    constants, graph = _split(surface, walker)
    return Row(
        constants=constants,
        graph=graph,
        cull=material.use_backface_culling,
        pass_index=material.pass_index,
        name=material.name,
        hash=cryptomatte_hash(material.name),
        translucent=_is_translucent(surface.alpha, material),
        medium=None if output is None else medium_of(walker, output.inputs["Volume"]),
        hair=walker.hair,
        warnings=tuple(walker.warnings),
    )


def _is_translucent(alpha: Expression, material: bpy.types.Material) -> bool:
    """Whether alpha is neither 1 nor a mask, whose edges alone lie between 0 and 1: those are cut out, which is sharp
    and fast. Materials that ask to be blended have their edges as they are."""
    value = constant(alpha)
    if value is not None:
        return bool(value[0] < 1 - 1e-6)
    return not is_mask(alpha, edges=material.surface_render_method != "BLENDED")


def _tree(material: bpy.types.Material) -> bpy.types.ShaderNodeTree | None:
    # Blender 5 has no materials without nodes, and use_nodes warns there
    without_nodes = bpy.app.version < (5, 0, 0) and not material.use_nodes
    return None if without_nodes else material.node_tree


def _output_of(material: bpy.types.Material) -> bpy.types.Node | None:
    tree = _tree(material)
    outputs = map(tree.get_output_node, ("ALL", "CYCLES", "EEVEE")) if tree else ()
    return next((o for o in outputs if o is not None), None)


def _surface_of(material: bpy.types.Material, output: bpy.types.Node | None, walker: Walker) -> Surface:
    if output is None:
        return Surface() if _tree(material) else _viewport_surface(material)
    if not output.inputs["Surface"].is_linked:
        # A volume has no surface of its own
        return Surface(alpha=ZERO) if output.inputs["Volume"].is_linked else Surface()
    try:
        return _shader(walker, output.inputs["Surface"], ())
    except UnsupportedNodeError as reason:
        # Whatever was wrong deeper in the tree no longer matters
        walker.hair = None
        walker.warnings[:] = [f'Material "{material.name}": {reason}; its viewport colour is shown']
        return _viewport_surface(material)


def _viewport_surface(material: bpy.types.Material) -> Surface:
    return Surface(
        base_color=input_nodes.Constant(tuple(material.diffuse_color)[:3]),
        roughness=input_nodes.Constant((material.roughness,)),
        metallic=input_nodes.Constant((material.metallic,)),
        specular=input_nodes.Constant((material.specular_intensity,)),
    )


# Shaders


def _shader(walker: Walker, socket: bpy.types.NodeSocket, path: Path) -> Surface:
    """The surface that feeds a shader input. Raises UnsupportedNodeError, naming the node."""
    found = resolve(socket, path)
    if found is None or not found[0].is_output:
        return Surface()
    output, path = found
    build = SHADERS.get(output.node.bl_idname)
    if build is None:
        raise UnsupportedNodeError(f'node "{output.node.label or output.node.name}" is not supported')
    return build(Reader(walker, output.node, path))


def _scaled(color: Expression, factor: Expression) -> Expression:
    return math_nodes.VectorMath(color, BLACK, BLACK, factor, "SCALE")


def _product(a: Expression, b: Expression) -> Expression:
    return math_nodes.Math(a, b, ZERO, "MULTIPLY")


def _principled(node: Reader) -> Surface:
    solid = Surface(
        base_color=node["Base Color"],
        roughness=node["Roughness"],
        metallic=node["Metallic"],
        emission=_scaled(node["Emission Color"], node["Emission Strength"]),
        normal=node["Normal"],
        ior=_constant_input(node, "IOR"),
        specular=_constant_input(node, "Specular IOR Level"),
    )
    weight = math_nodes.Clamp(node["Transmission Weight"], ZERO, ONE)
    if _is_constant(weight, 0):
        return replace(solid, alpha=node["Alpha"])
    # Metals reflect all the same (OpenPBR's and Blender's order of layers)
    weight = _product(weight, math_nodes.Math(ONE, solid.metallic, ZERO, "SUBTRACT"))
    # Light crosses two faces of a solid, hence the root
    tint = math_nodes.VectorMath(
        math_nodes.Clamp(solid.base_color, ZERO, ONE), input_nodes.Constant((0.5,) * 3), BLACK, ZERO, "POWER"
    )
    mixed = _mixed(solid, _glass_surface(tint, solid), weight)
    # Glass shines as much as what it takes the place of, however little of it shows
    shines = replace(mixed, emission=_over(solid.emission, mixed.alpha))
    return replace(shines, alpha=_product(node["Alpha"], mixed.alpha))


def _over(color: Expression, weight: Expression) -> Expression:
    """color / weight; black where the weight is 0."""
    return color if _is_constant(color, 0) else _scaled(color, math_nodes.Math(ONE, weight, ZERO, "DIVIDE"))


def _glass_surface(tint: Expression, like: Surface, *, reflects: bool = True) -> Surface:
    """Thin glass whose transmittance is `tint`: its alpha and what that covers (see above)."""
    passing = color_nodes.Gray(tint, mean=True)
    absorbed = math_nodes.Math(ONE, passing, ZERO, "SUBTRACT")
    beyond = math_nodes.VectorMath(tint, color_nodes.Color(passing), BLACK, ZERO, "SUBTRACT")
    painted = _over(math_nodes.VectorMath(beyond, BLACK, BLACK, ZERO, "MAXIMUM"), absorbed)
    paint = replace(like, base_color=painted, metallic=ZERO, emission=BLACK, alpha=absorbed)
    index = constant(like.ior)
    if not reflects or index is None:
        return paint
    # The paint reflects by itself
    fresnel = input_nodes.Constant((float((index[0] - 1) / (index[0] + 1)) ** 2,))
    mirror = replace(like, base_color=CLEAR, metallic=ONE, emission=BLACK)
    return _mixed(paint, mirror, _product(fresnel, passing))


def _constant_input(node: Reader, identifier: str) -> Expression:
    """An input that the table holds only as a constant: its own value where something that varies is linked."""
    if not node[identifier].varies:
        return node[identifier]
    node.warn(f'has a varying "{identifier}"; its own value is used')
    return default(node.socket(identifier))


def _diffuse(node: Reader) -> Surface:
    return Surface(base_color=node["Color"], normal=node["Normal"])


def _glossy(node: Reader) -> Surface:
    return Surface(base_color=node["Color"], roughness=node["Roughness"], metallic=ONE, normal=node["Normal"])


def _emission(node: Reader) -> Surface:
    return Surface(emission=_scaled(node["Color"], node["Strength"]))


def _transparent(node: Reader) -> Surface:
    tint = math_nodes.Clamp(node["Color"], ZERO, ONE)
    return Surface(alpha=ZERO) if _is_constant(tint, 1) else _glass_surface(tint, Surface(), reflects=False)


def _glass(node: Reader) -> Surface:
    reflects = node.node.bl_idname == "ShaderNodeBsdfGlass"
    like = Surface(
        roughness=node["Roughness"],
        normal=node["Normal"],
        ior=_constant_input(node, "IOR"),
        specular=input_nodes.Constant((0.5 if reflects else 0.0,)),
    )
    return _glass_surface(math_nodes.Clamp(node["Color"], ZERO, ONE), like, reflects=reflects)


def _translucent(node: Reader) -> Surface:
    node.warn("is lit on the side that is seen")
    return _diffuse(node)


def _principled_hair(node: Reader) -> Surface:
    """Hair whose colour is that of its absorption; on other surfaces that colour is all there is."""
    if node.walker.hair is not None:
        node.warn("is one of several for hair in its material; one of them gives the roughness and the like")
    huang = getattr(node.node, "model", "CHIANG") == "HUANG"
    if huang:
        node.warn("uses Huang's model, which is shown as a round fibre")
    random = node["Random"] if node.linked("Random") else of_strand("random")
    amount = math_nodes.Clamp(node["Random Roughness"], ZERO, ONE)
    roughness = node["Roughness"]
    if not _is_constant(amount, 0):
        off = math_nodes.Math(_product(input_nodes.Constant((2.0,)), random), ONE, ZERO, "SUBTRACT")
        roughness = _product(roughness, math_nodes.Math(ONE, _product(off, amount), ZERO, "ADD"))
    radial = _constant_input(node, "Roughness" if huang else "Radial Roughness")
    names = {"COLOR": "Color", "MELANIN": "Melanin", "ABSORPTION": "Absorption Coefficient"}
    kind = node.node.parametrization
    melanin = kind == "MELANIN"
    # Only melanin is random: what is not read must not make the colour vary
    use = {name: node[name] if melanin else ZERO for name in ("Melanin Redness", "Tint", "Random Color")}
    varied = melanin and not _is_constant(use["Random Color"], 0)
    value = node[names[kind]]
    color = HairColor(
        value, use["Melanin Redness"], use["Tint"], use["Random Color"], random if varied else ZERO, radial, kind
    )
    numbers = {name: _number(node, name) for name in ("Coat", "IOR", "Offset", "R lobe", "TT lobe", "TRT lobe")}
    lobes = tuple(max(numbers[f"{name} lobe"], 0.0) if huang else 1.0 for name in ("R", "TT", "TRT"))
    fibre = constant(radial)
    node.walker.hair = Hair(
        radial=0.3 if fibre is None else float(np.clip(fibre[0], 0, 1)),
        coat=0.0 if huang else min(max(numbers["Coat"], 0.0), 1.0),
        tilt=numbers["Offset"],
        lobes=lobes,
    )
    ior, specular = input_nodes.Constant((numbers["IOR"],)), input_nodes.Constant((0.5,))
    return Surface(base_color=color, roughness=roughness, ior=ior, specular=specular)


def _number(node: Reader, identifier: str) -> float:
    """An input that is a constant."""
    value = constant(_constant_input(node, identifier))
    return 0.0 if value is None else float(np.nan_to_num(value[0]))


def _hair(node: Reader) -> Surface:
    node.warn("is drawn like a diffuse surface of its colour")
    return Surface(base_color=node["Color"])


def _mix_shader(node: Reader) -> Surface:
    a, b = (_shader(node.walker, node.socket(name), node.path) for name in ("Shader", "Shader_001"))
    return _mixed(a, b, math_nodes.Clamp(node["Fac"], ZERO, ONE))


def _mixed(a: Surface, b: Surface, second: Expression) -> Surface:
    """(1 - f) A + f B: opacities mix by f, everything else by f weighted with the opacities."""
    first = math_nodes.Math(ONE, second, ZERO, "SUBTRACT")
    a_weight, b_weight = _product(a.alpha, first), _product(b.alpha, second)
    if _is_constant(b_weight, 0):
        return replace(a, alpha=a_weight)
    if _is_constant(a_weight, 0):
        return replace(b, alpha=b_weight)
    alpha = math_nodes.Math(a_weight, b_weight, ZERO, "ADD")
    both_opaque = _is_constant(a.alpha, 1) and _is_constant(b.alpha, 1)
    t = second if both_opaque else math_nodes.Math(b_weight, alpha, ZERO, "DIVIDE")
    mixed = {f.name: _blend(t, getattr(a, f.name), getattr(b, f.name)) for f in fields(Surface)}
    return Surface(**{**mixed, "alpha": ONE if both_opaque else alpha})


def _blend(t: Expression, a: Expression, b: Expression) -> Expression:
    return a if a.digest == b.digest else color_nodes.Mix(t, a, b)


def _is_constant(value: Expression, number: float) -> bool:
    found = constant(value)
    return found is not None and bool(np.all(found == number))


def _add_shader(node: Reader) -> Surface:
    """Light adds up where at least one of the two only shines."""
    a, b = (_shader(node.walker, node.socket(name), node.path) for name in ("Shader", "Shader_001"))
    if not _only_shines(b):
        a, b = b, a
    if not _only_shines(b):
        raise UnsupportedNodeError(f'node "{node.node.label or node.node.name}" adds two reflecting shaders')
    if not _is_constant(a.alpha, 1):
        raise UnsupportedNodeError(f'node "{node.node.label or node.node.name}" adds light to a transparent shader')
    return replace(a, emission=math_nodes.VectorMath(a.emission, b.emission, BLACK, ZERO, "ADD"))


def _only_shines(surface: Surface) -> bool:
    opaque_black = _is_constant(surface.base_color, 0) and _is_constant(surface.alpha, 1)
    return opaque_black and _is_constant(surface.specular, 0)


SHADERS: dict[str, Callable[[Reader], Surface]] = {
    "ShaderNodeBsdfPrincipled": _principled,
    "ShaderNodeBsdfDiffuse": _diffuse,
    "ShaderNodeBsdfAnisotropic": _glossy,
    "ShaderNodeBsdfGlossy": _glossy,
    "ShaderNodeEmission": _emission,
    "ShaderNodeBsdfTransparent": _transparent,
    "ShaderNodeBsdfGlass": _glass,
    "ShaderNodeBsdfRefraction": _glass,
    "ShaderNodeBsdfTranslucent": _translucent,
    "ShaderNodeBsdfHairPrincipled": _principled_hair,
    "ShaderNodeBsdfHair": _hair,
    "ShaderNodeMixShader": _mix_shader,
    "ShaderNodeAddShader": _add_shader,
}


# Constants and graphs


def _split(surface: Surface, walker: Walker) -> tuple[dict[str, tuple[float, ...]], MaterialGraph | None]:
    """Constant inputs for the table, all others for the graph."""
    constants: dict[str, tuple[float, ...]] = {}
    varying: dict[str, Expression] = {}
    for name, (_, top) in CHANNELS.items():
        expression = getattr(surface, name)
        if name == "normal":
            # A normal that is the same everywhere comes from an empty or broken input
            if expression is not FACING and expression.varies and not isinstance(expression, input_nodes.Coordinates):
                varying[name] = expression
            continue
        value = constant(expression)
        if value is None:
            varying[name] = expression
            constants[name] = PLACEHOLDER[name]
        else:
            constants[name] = tuple(np.clip(np.nan_to_num(value), 0, top).tolist())
    for name, fallback in (("ior", 1.5), ("specular", 0.5)):
        value = constant(getattr(surface, name))
        if value is None:
            walker.warnings.append(f'Material "{walker.material_name}": varying {name} is replaced by {fallback}')
        constants[name] = (fallback,) if value is None else (max(float(value[0]), 0.0),)
    return constants, MaterialGraph(**varying) if varying else None
