"""Decides which passes, targets and shader variants one view needs, with a reason for each that is left out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ...core.light.light_table import light_names
from ...core.material.graph import MaterialGraph
from ...core.numeric.record import record, value_record
from ...core.scene.cloud import PointCloud
from ...core.scene.scene import Scene
from ...core.scene.strands import Strands
from ...core.scene.world import World
from ...core.surface.appearance import graphs_of
from ..indirect.traced import sharp_mirrors
from ..passes.captured.project import UNLIT, CapturedLighting
from ..passes.ewa.options import EwaOptions
from ..passes.ewa.options import options as ewa_options
from ..passes.gbuffer import Variant
from ..passes.pages.point_page import PointOptions
from ..passes.shading.averages import averaged
from ..passes.shading.data import NEED_OWNER, data
from ..passes.shading.terms import ENVIRONMENT, GLOSSY, OCCLUSION, VOLUME, Term
from ..passes.translucent.options import TranslucentOptions
from ..passes.translucent.options import options as translucent_options
from ..prepare.point_sets import Layer, PointSet
from ..prepare.prepare import Prepared
from ..shadow.shadows import Shadows
from .plan import Plan
from .reasons import Absences, reasons
from .request import Request

EXACT_HALF = 2048  # integers below it are exact as half floats


@record
class ViewToPlan:
    """All that a plan depends on: one view of a scene, prepared."""

    scene: Scene
    prepared: Prepared  # for the painter and for defocus, with the splats that they draw among the translucent ones
    request: Request
    shadows: Shadows | None  # None: no light casts any
    mattes: bool  # some polygons are
    matte_shadows: Shadows | None  # that these receive
    captured_shadows: Mapping[int, Shadows | None]  # of those that captured splats receive, by row of geometries
    ewa: bool  # the technique of opaque points is EWA
    painter: bool  # the technique is the painter, and there are opaque points
    reflects: bool  # something that is drawn reflects light
    picture: bool  # Combined is wanted; else nothing is lit and nothing translucent is drawn
    sub_samples: int  # of each pixel in each sample, by the visibility buffer; 0: by another technique
    presented: bool  # the picture is shown between samples
    hasty: bool  # the first sample is soon replaced
    absences: Absences  # why what the view has not is not there

    @property
    def defocus(self) -> bool:
        """Whether something is out of focus, which the pass `defocus` draws together with all that is translucent."""
        return self.prepared.out_of_focus is not None


@value_record
class _Kinds:
    """The kinds of opaque things that a view has."""

    points: bool
    polygons: bool
    spheres: bool
    lines: bool
    solid: bool  # the G-buffer that is shaded holds something


@value_record
class _Attributes:
    """What varies within a material, among all that is opaque: the G-buffer has a texture for each."""

    color: bool
    surface: bool  # roughness and metallic
    emission: bool
    tangent: bool  # the direction of a stretched lobe


def make_plan(view: ViewToPlan) -> Plan:
    """Returns the plan of one view of a scene."""
    scene, passes = view.scene, view.request.passes
    kinds = _kinds(view)
    translucent = _translucent(view, kinds)
    attributes = _attributes(view, kinds)
    varies = attributes.surface or (translucent is not None and translucent.surface)
    lit = translucent is not None and not translucent.alone
    lighting = _lighting(view, varies, drawn=kinds.solid or lit)
    indirect, term = _indirect(view, kinds), view.request.term
    # All terms of the light of a picture see the same.
    normals = bool(lighting) or view.mattes or indirect or attributes.surface or "normal" in passes
    variant, data_variant = _variants(view, kinds, attributes, normals)
    variant = replace(variant, spread=_spreads(view, kinds, variant))
    ewa = _ewa(view, kinds)
    plan = Plan(
        kinds.points,
        kinds.polygons,
        kinds.spheres,
        kinds.lines,
        variant,
        data_variant,
        _point_options(view, kinds, normals, ewa),
        _of_term(lighting, term, scene),
        (*_materials(scene, varies), *(() if term is None else term.defines)),
        background=_background(view),
        data=_data(view, kinds),
        translucent=translucent,
        widest_translucent=view.prepared.widest_translucent,
        coarse=_coarse_translucent(view, translucent),
        ewa=ewa,
        world=_behind(view),
        painter=view.painter,
        sub_samples=view.sub_samples,
        filter_size=view.request.settings.filter_size,
        presented=view.presented,
        eye_dome=_eye_dome(view, kinds),
        defocus=view.defocus,
        captured_light=_captured_light(view),
        matte_light=_matte_light(view),
        indirect=indirect and (term is None or term.gathers),
        mirrors=indirect and _mirrors(view) and (term is None or (term.light == GLOSSY and not term.color)),
        backdrop=not view.absences.blurred_world and _shows_world(term),
        picture=view.picture,
        shades=view.picture or bool(averaged(passes)),
        panes=view.picture and len(view.prepared.panes) > 0,
        term=term,
    )
    return replace(plan, skipped=tuple(reasons(plan, passes, view.absences).items()))


# Points and other opaque things


def _kinds(view: ViewToPlan) -> _Kinds:
    prepared = view.prepared
    points = prepared.cut.splats > 0 or prepared.nodes.cut.splats > 0
    polygons = len(prepared.all_polygons) > 0
    spheres, lines = prepared.spheres.cut.splats > 0, len(prepared.strands) > 0
    return _Kinds(points, polygons, spheres, lines, polygons or spheres or lines or (points and not view.painter))


def _opaque_sets(prepared: Prepared) -> list[PointSet]:
    layers: tuple[Layer, ...] = (prepared, prepared.spheres, prepared.nodes)
    return [points for layer in layers for points in layer.point_sets.values()]


def _point_options(view: ViewToPlan, kinds: _Kinds, normals: bool, ewa: EwaOptions | None) -> PointOptions:
    """The shader variants of points and balls. `normals`: shading reads them. `ewa`: as in the plan."""
    scene, prepared, request = view.scene, view.prepared, view.request
    sets = _opaque_sets(prepared)
    normals = normals or view.painter or bool(data(request.passes))
    shown = np.concatenate([layer.cut.instance for layer in (prepared, prepared.spheres, prepared.nodes)])
    holdout = bool(_holdouts(scene)[shown].any())
    return PointOptions(
        shading_normal=normals and any(p.cloud.shading_normal is not None for p in sets),
        velocity=_moving(view),
        facets=normals and any(p.cloud.facets is not None for p in sets),
        cull=kinds.points and bool(scene.materials.cull.any()),
        holdout=holdout,
        ellipses=any(p.hierarchy is not None or p.cloud.axis is not None for p in sets),
        one_instance=not holdout and len(shown) > 0 and bool((shown == shown[0]).all()),
        disconnected=any(p.cloud.disconnected is not None for p in sets),
        depth=kinds.polygons or kinds.spheres or kinds.lines,
        coarse=request.coarse and ewa is None,
    )


def _holdouts(scene: Scene) -> np.ndarray:
    """(I,) bool: instances that cut holes into the picture."""
    return np.zeros(len(scene.instances), bool) if scene.instances.holdout is None else scene.instances.holdout


def _ewa(view: ViewToPlan, kinds: _Kinds) -> EwaOptions | None:
    """The options of EWA; None where it draws nothing."""
    if not (view.ewa and kinds.points):
        return None
    balls = any(p.cloud.has_balls for p in view.prepared.point_sets.values())
    request = view.request
    return ewa_options(request.camera, view.prepared.largest, balls, request.samples, request.settings.filter_size)


def _eye_dome(view: ViewToPlan, kinds: _Kinds) -> bool:
    """Whether the picture is darkened by its depths, which the visibility buffer has of what is opaque."""
    wanted = view.request.settings.use_eye_dome and view.picture
    return wanted and view.sub_samples > 0 and kinds.solid and not view.defocus


# Variants of the G-buffer


def _attributes(view: ViewToPlan, kinds: _Kinds) -> _Attributes:
    scene, prepared = view.scene, view.prepared
    clouds: list[PointCloud | Strands] = [p.cloud for p in _opaque_sets(prepared)]
    clouds += [found for row in prepared.strands if (found := scene.geometries[row].strands) is not None]
    channels = {name for graph in _graphs(scene, prepared) for name in graph.channels} if kinds.polygons else set()
    surface = any(c.surface is not None for c in clouds) or bool(channels & {"roughness", "metallic"})
    return _Attributes(
        color=surface or any(c.color is not None for c in clouds) or bool(channels & {"base_color", "alpha"}),
        surface=surface,
        emission=view.picture and (any(c.emission is not None for c in clouds) or "emission" in channels),
        tangent=view.picture and view.sub_samples > 0 and view.reflects and "tangent" in channels,
    )


def _graphs(scene: Scene, prepared: Prepared) -> list[MaterialGraph]:
    """The material graphs of the meshes that are drawn as polygons."""
    rows = np.unique(scene.instances.geometry[prepared.all_polygons])
    meshes = [scene.geometries[int(row)].mesh for row in rows]
    return [graph for mesh in meshes if mesh is not None for graph in graphs_of(mesh, scene.materials).values()]


def _variants(view: ViewToPlan, kinds: _Kinds, attributes: _Attributes, normals: bool) -> tuple[Variant, Variant]:
    """The variants of the G-buffer that is shaded and of the one that passes without averages read."""
    passes = view.request.passes
    owner = bool(passes & set(NEED_OWNER))
    wide = len(view.scene.materials) >= EXACT_HALF
    pyramid = kinds.points and not view.ewa and not view.sub_samples
    velocity = _moving(view)
    variant = Variant(
        normals,
        attributes.color,
        attributes.surface,
        attributes.emission,
        wide=wide,
        front=pyramid and not view.painter,
        tangent=normals and attributes.tangent,
    )
    if view.painter:
        data_variant = replace(variant, normal=True, emission=False, owner=owner, velocity=velocity, front=pyramid)
    else:
        data_variant = Variant(owner=owner, velocity=velocity, wide=wide, front=pyramid)
    if not view.picture and not averaged(passes):
        variant = data_variant
    return variant, data_variant


def _moving(view: ViewToPlan) -> bool:
    """Whether a pass asks how points move within their objects, and some do."""
    return "vector" in view.request.passes and any(p.cloud.velocity is not None for p in _opaque_sets(view.prepared))


def _spreads(view: ViewToPlan, kinds: _Kinds, variant: Variant) -> bool:
    """Whether the spread of normals among a group's sub-samples changes how it is lit: not by a world of one colour."""
    scene = view.scene
    shone = view.picture and view.reflects and (len(scene.lights) > 0 or scene.world.image is not None)
    return view.sub_samples > 1 and variant.normal and shone and (kinds.polygons or kinds.points)


# Lighting and materials


def _lighting(view: ViewToPlan, varies: bool, drawn: bool) -> tuple[str, ...]:
    """Names of the defines of lights, world and shadows. `varies`: roughness varies within a material. `drawn`:
    something is drawn."""
    scene = view.scene
    found: tuple[str, ...] = ()
    reflects = view.reflects or scene.world.fog is not None or _occlusion(view.request.term)
    if drawn and reflects and view.picture:
        table = scene.materials
        coats = () if table.coat is None else table.coat.roughness
        smoothest = 0.0 if varies else float(np.min([table.roughness.min(), *coats]))
        found = (*_world(scene.world), *light_names(scene.lights, smoothest))
        dims = not (table.coat is None and table.sheen is None) and (table.emission > 0).any()
        if not found and (dims or _gathers(view)):
            # A black one: coats and fibres dim what shines below them, and what is gathered is reflected by its table.
            found = ("PS_HAS_WORLD",)
    return found + (() if view.shadows is None else _shadows(view.shadows))


def _of_term(lighting: tuple[str, ...], term: Term | None, scene: Scene) -> tuple[str, ...]:
    """The names of `lighting` that a term of the light needs."""
    if term is None or term.lit:
        return lighting
    fog = () if scene.world.fog is None else ("PS_FOG",)
    # Surfaces reflect a share of a world's light, of which no more is read.
    return (*fog, "PS_HAS_WORLD") if lighting or term.color else ()


def _shows_world(term: Term | None) -> bool:
    return term is None or term.light == ENVIRONMENT


def _indirect(view: ViewToPlan, kinds: _Kinds) -> bool:
    """Whether surfaces hide the world from each other, or send each other light."""
    return view.sub_samples > 0 and kinds.solid and _gathers(view)


def _gathers(view: ViewToPlan) -> bool:
    """Whether something that is drawn may receive light that is not of lamps alone."""
    if view.absences.indirect or not view.picture:
        return False
    if _occlusion(view.request.term):
        return not view.defocus  # whatever surfaces reflect, and whatever shines
    return view.reflects and sends_light(view.scene, view.request.settings.bounces)


def _occlusion(term: Term | None) -> bool:
    return term is not None and term.light == OCCLUSION


def sends_light(scene: Scene, bounces: int) -> bool:
    """Whether a scene has a world, or what shines or sends light on."""
    emits = bool((scene.materials.emission > 0).any()) or any(
        isinstance(graph, MaterialGraph) and "emission" in graph.channels for graph in scene.materials.graphs
    )
    emits = emits or any(
        one.cloud is not None and one.cloud.extinction is not None and one.cloud.emission is not None
        for one in scene.geometries
    )
    emits = emits or any(one.captured is not None for one in scene.geometries)
    world = scene.world.image is not None or bool(np.any(scene.world.color > 0))
    return emits or world or (bounces > 0 and bool(scene.lights))


def _mirrors(view: ViewToPlan) -> bool:
    """Whether something may mirror meshes sharply, by way of a bounce."""
    scene = view.scene
    meshes = any(geometry.mesh is not None for geometry in scene.geometries)
    return meshes and view.request.settings.bounces > 0 and bool(sharp_mirrors(scene.materials).any())


def _shadows(shadows: Shadows) -> tuple[str, ...]:
    """Names of the defines of shadows."""
    maps = shadows.maps
    named = {
        "PS_SHADOWS": True,
        "PS_SHADOW_MAPS": maps is not None,
        "PS_SHADOW_SOFT": maps is not None and maps.soft,
        "PS_SHADOW_NESTED": maps is not None and maps.nested,
        "PS_SHADOW_STRANDS": maps is not None and maps.strands is not None,
        "PS_SHADOW_PANES": shadows.panes is not None,
        "PS_PANES_COLORED": shadows.panes is not None and shadows.panes.channels > 1,
        "PS_SHADOW_FACES": shadows.faces is not None,
        "PS_FACES_COLORED": shadows.faces is not None and shadows.faces.colored,
    }
    if shadows.tables is not None:
        packed = shadows.tables.packed
        named |= {
            "PS_SHADOW_TABLES": True,
            "PS_SHADOW_SAMPLE": True,
            "PS_SHADOW_COLORED": packed.colored,
            "PS_SHADOW_SOLID": packed.only_opaque,
            "PS_SHADOW_SUNS": packed.only_suns,
            "PS_SHADOW_HARD": packed.no_light_has_size,
        }
    return tuple(name for name, on in named.items() if on)


def _materials(scene: Scene, varies: bool) -> tuple[str, ...]:
    """Names of the defines of materials. `varies`: roughness and metallic vary within a material."""
    table = scene.materials
    metal = varies or bool((table.metallic > 0).any())
    found = {
        "PS_HAS_METAL": metal,
        "PS_HAS_GLOW": bool((table.emission > 0).any()),
        "PS_COAT": table.coat is not None,
        "PS_BACKLIT": table.backlit is not None,
        "PS_TINTED": table.tint is not None,
        "PS_GLOSS": metal and table.gloss is not None,
        "PS_ROUGH_DIFFUSE": table.diffuse_roughness is not None,
        "PS_SHEEN": table.sheen is not None,
        "PS_TOON": table.toon is not None,
        "PS_CUT_OUT": table.holdout is not None,
        "PS_ONE_SURFACE": not metal
        and table.coat is None
        and table.tint is None
        and all(bool((values == values[0]).all()) for values in (table.roughness, table.ior, table.specular)),
    }
    return tuple(name for name, needed in found.items() if needed)


# Translucent splats


def _translucent(view: ViewToPlan, kinds: _Kinds) -> TranslucentOptions | None:
    """The options of translucent splats; None where none is drawn."""
    layer = view.prepared.translucent
    clouds = [p.cloud for p in layer.point_sets.values()]
    captured = view.prepared.captured
    if not ((clouds or captured) and view.picture):
        return None
    holdouts = _holdouts(view.scene)
    holdout = bool(holdouts[layer.set_of_instance >= 0].any() or holdouts[list(captured)].any())
    grouped = view.sub_samples > 0 and not view.defocus
    opaque = kinds.solid or grouped
    found = translucent_options(
        clouds, view.scene.materials, opaque, holdout, view.defocus, grouped, bool(captured),
        bool(view.prepared.captured_nodes),
    )  # fmt: skip
    wanted, term = "depth" in view.request.passes, view.request.term
    return replace(
        found,
        gathered=found.media and _gathers(view) and (term is None or (term.light == VOLUME and not term.color)),
        received=view.defocus and any(map(_has_surfaces, clouds)) and _gathers(view) and (term is None or term.gathers),
        mattes=view.mattes and found.captured,
        depth=wanted and found.captured,
        trained=found.captured and not (view.absences.trained or _occlusion(term)),
        term=view.request.term,
    )


def _has_surfaces(cloud: PointCloud) -> bool:
    """Whether some splats of a cloud are lit as surfaces are."""
    return cloud.extinction is None or cloud.shading_normal is not None


def _captured_light(view: ViewToPlan) -> tuple[tuple[int, CapturedLighting], ...]:
    """What light does to captured splats, by row of geometries, of those that it changes."""
    if not view.picture:
        return ()
    return tuple(
        (row, CapturedLighting(view.scene.geometries[row].lighting, _lights_and_shadows(view, shadows)))
        for row, shadows in view.captured_shadows.items()
    )


def _matte_light(view: ViewToPlan) -> CapturedLighting:
    """What light does to mattes, where there are some."""
    if not (view.mattes and view.picture):
        return UNLIT
    return CapturedLighting("SHADOWED", _lights_and_shadows(view, view.matte_shadows))


def _lights_and_shadows(view: ViewToPlan, shadows: Shadows | None) -> tuple[str, ...]:
    """Names of the defines of lights, the world, and some shadows."""
    scene = view.scene
    return *_world(scene.world), *light_names(scene.lights, 1.0), *(() if shadows is None else _shadows(shadows))


def _coarse_translucent(view: ViewToPlan, translucent: TranslucentOptions | None) -> bool:
    """Whether the first sample's translucent layer has fewer pixels."""
    if translucent is None or view.defocus or not view.hasty:
        return False
    return not (translucent.tint or translucent.holdout or translucent.fuzzy or translucent.captured)


# World and background


def _world(world: World) -> tuple[str, ...]:
    """Names of the defines of a world's light."""
    fog = () if world.fog is None else ("PS_FOG",)
    if world.image is not None:
        return (*fog, "PS_HAS_ENVIRONMENT")
    return (*fog, "PS_HAS_WORLD") if np.any(world.color > 0) else fog


def _behind(view: ViewToPlan) -> tuple[str, ...]:
    """Names of the defines of what is behind everything: the world, and fog with the lights and shadows in it."""
    scene = view.scene
    term = view.request.term
    if scene.world.fog is not None and view.picture:
        return _of_term(_lights_and_shadows(view, view.shadows), term, scene)
    return () if scene.transparent or not _shows_world(term) else _world(scene.world.behind)


def _background(view: ViewToPlan) -> bool:
    """Whether the pass `background` draws the world: the pass `defocus` does so where it runs."""
    shown = not view.scene.transparent or view.scene.world.fog is not None
    return ((shown and view.picture) or "mist" in view.request.passes) and not view.defocus


# Passes for data


def _data(view: ViewToPlan, kinds: _Kinds) -> bool:
    """Whether the pass `data` runs."""
    return (kinds.solid or kinds.points) and bool(data(view.request.passes))
