"""Which passes, targets and shader variants a scene needs; each that is left out has its reason."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ...core.light.light_table import light_names
from ...core.material.graph import MaterialGraph
from ...core.scene.camera import Camera
from ...core.scene.cloud import PointCloud
from ...core.scene.scene import Scene
from ...core.scene.strands import Strands
from ...core.surface.appearance import graphs_of
from ..passes.ewa import options as options_module
from ..passes.gbuffer import Variant
from ..passes.pages.point_page import PointOptions
from ..passes.shading.averages import averaged
from ..passes.shading.data import NEED_OWNER, data
from ..passes.translucent.options import TranslucentOptions
from ..passes.translucent.options import options as translucent_options
from ..prepare.prepare import Prepared
from ..shadow.shadows import Shadows
from .reasons import reasons

EXACT_HALF = 2048  # integers below it are exact as half floats


@dataclass(frozen=True)
class Plan:
    """Everything that is decided before the first draw."""

    points: bool
    polygons: bool
    spheres: bool  # wide balls
    lines: bool  # strands
    variant: Variant  # of the G-buffer that is shaded
    data_variant: Variant  # of the one that the passes which are not averaged read
    options: PointOptions
    lighting: tuple[str, ...]  # PS_ names of what shines on what is drawn
    materials: tuple[str, ...]  # and of what surfaces do with it
    background: bool  # pixels that show nothing hold something
    data: bool
    translucent: TranslucentOptions | None  # None: nothing is
    coarse: bool  # the first sample's translucent layer has fewer pixels: views that move show it at once
    skipped: tuple[tuple[str, str], ...] = ()  # (pass, because)
    ewa: options_module.EwaOptions | None = None  # points are drawn by EWA; None: in image space
    world: tuple[str, ...] = ()  # and of what is behind it
    painter: bool = False  # opaque points are painted: what the G-buffer holds of them is for other passes alone
    backdrop: bool = False  # a picture of the world is out of focus: passes/backdrop.py
    picture: bool = True  # Combined is drawn, not passes beside it alone
    shades: bool = True  # it is, or passes that shading leaves behind
    defocus: bool = False  # what is translucent is drawn along with what is out of focus: passes/defocus.py

    @property
    def solid(self) -> bool:
        """Something is in the G-buffer."""
        return self.points or self.polygons or self.spheres or self.lines

    @property
    def shaded(self) -> Plan:
        """The plan of the G-buffer that is shaded."""
        return replace(self, points=False) if self.painter else self

    @property
    def behind(self) -> tuple[str, ...]:
        """PS_ names of what is behind everything, for those who draw it."""
        return ("PS_BACKDROP",) if self.backdrop else self.world

    def reach(self, largest: float) -> float:
        """Pixels that splats of at most the radius `largest` reach beyond their centres."""
        if not self.points:
            return 0.0
        return largest if self.ewa is None else self.ewa.reach(largest)


def make_plan(
    scene: Scene,
    prepared: Prepared,
    passes: frozenset[str],
    shadows: Shadows | None = None,
    unshadowed: str = "",
    interactive: bool = False,
    blended: tuple[Camera, int] | None = None,
    painter: bool = False,
    reflects: bool = True,
    unseen: Mapping[str, str] = MappingProxyType({}),
    in_focus: str = "",
    sharp_world: str = "the camera has no depth of field",
    picture: bool = True,
) -> Plan:
    """The plan for one view of a scene. `unshadowed`: why there are no shadows. `blended`: points are drawn by EWA, for
    this camera and number of samples. `painter`: opaque points are painted (render/prepare/painter.py). `reflects`: something
    that is drawn reflects light. `unseen`: kinds of things that are left out, and why (render/prepare/in_view.py). `in_focus`:
    why nothing is out of focus; prepared.out_of_focus is None. `sharp_world`: why the world is not blurred, or nothing.
    `picture`: Combined is wanted; else nothing is lit, and nothing that is translucent drawn."""
    points, polygons = prepared.cut.splats > 0, len(prepared.polygons) > 0
    spheres = prepared.spheres.cut.splats > 0
    lines = len(prepared.strands) > 0
    behind = [p.cloud for p in prepared.translucent.point_sets.values()]
    defocus = prepared.out_of_focus is not None
    solid = polygons or spheres or lines or (points and not painter)
    held = np.zeros(len(scene.instances), bool) if scene.instances.holdout is None else scene.instances.holdout
    cut = bool(held[prepared.translucent.set_of_instance >= 0].any())
    blends = bool(behind) and picture
    translucent = translucent_options(behind, scene.materials, solid, cut, defocus) if blends else None
    drawn = solid or translucent is not None
    graphs = _graphs(scene, prepared)
    channels = {name for graph in graphs for name in graph.channels}
    sets = [*prepared.point_sets.values(), *prepared.spheres.point_sets.values()]
    clouds: list[PointCloud | Strands] = [p.cloud for p in sets]
    clouds += [found for row in prepared.strands if (found := scene.geometries[row].strands) is not None]
    surface = any(c.surface is not None for c in clouds) or (polygons and bool(channels & {"roughness", "metallic"}))
    varies = surface or (translucent is not None and translucent.surface)
    materials = _materials(scene, varies)
    smoothest = 0.0 if varies else float(scene.materials.roughness.min())
    shining = light_names(scene.lights, smoothest) if drawn else ()
    world = _world(scene)
    lighting = (*world, *shining) if drawn and reflects and picture else ()
    if shadows is not None:
        packed = shadows.packed
        named = {"PS_SHADOW_COLORED": packed.colored, "PS_SHADOW_SOLID": packed.only_opaque, "PS_SHADOW_SUNS": packed.only_suns,
                 "PS_SHADOW_HARD": packed.no_light_has_size}  # fmt: skip
        lighting += ("PS_SHADOWS", "PS_SHADOW_SAMPLE", *(name for name, on in named.items() if on))
    color = (
        surface or any(c.color is not None for c in clouds) or (polygons and bool(channels & {"base_color", "alpha"}))
    )
    emission = picture and (any(c.emission is not None for c in clouds) or (polygons and "emission" in channels))
    wide = len(scene.materials) >= EXACT_HALF
    lit = bool(lighting) or surface or "normal" in passes
    pulled = points and blended is None
    variant = Variant(lit, color, surface, emission, wide=wide, front=pulled and not painter)
    owner = bool(passes & set(NEED_OWNER))
    data_variant = (
        replace(variant, normal=True, emission=False, owner=owner, front=pulled)
        if painter
        else Variant(owner=owner, wide=wide, front=pulled)
    )
    if not picture and not averaged(passes):
        variant = data_variant
    turned = lit or painter or bool(data(passes))
    shown = np.concatenate([prepared.cut.instance, prepared.spheres.cut.instance])
    holdout = bool(held[shown].any())
    one = not holdout and len(np.unique(shown)) == 1
    options = PointOptions(
        shading_normal=turned and any(p.cloud.shading_normal is not None for p in sets),
        facets=turned and any(p.cloud.facets is not None for p in sets),
        cull=points and bool(scene.materials.cull.any()),
        holdout=holdout,
        ellipses=any(p.hierarchy is not None or p.cloud.axis is not None for p in sets),
        one_instance=one,
        disconnected=any(p.cloud.disconnected is not None for p in sets),
        depth=polygons or spheres or lines,
    )
    plan = Plan(
        points, polygons, spheres, lines, variant, data_variant, options, lighting, materials,
        background=((not scene.transparent and picture) or "mist" in passes) and not defocus,
        data=(solid or points) and bool(data(passes)),
        translucent=translucent,
        coarse=interactive and translucent is not None and not defocus
        and not (translucent.tint or translucent.holdout or translucent.fuzzy),
        ewa=None if blended is None or not points else options_module.options(
            blended[0], prepared.largest, any(p.cloud.normal is None for p in prepared.point_sets.values()), blended[1]
        ),
        world=() if scene.transparent else world,
        painter=painter, defocus=defocus, backdrop=not sharp_world, picture=picture,
        shades=picture or bool(averaged(passes)),
    )  # fmt: skip
    asked = {"data": bool(data(passes)), "averaged": bool(averaged(passes))}
    unshadowed = "" if shadows is not None else unshadowed or "nothing casts shadows"
    return replace(plan, skipped=tuple(reasons(plan, asked, unshadowed, unseen, in_focus, sharp_world).items()))


def _graphs(scene: Scene, prepared: Prepared) -> list[MaterialGraph]:
    """Graphs of the meshes that are drawn as polygons."""
    rows = np.unique(scene.instances.geometry[prepared.polygons]) if len(prepared.polygons) else []
    meshes = [scene.geometries[int(row)].mesh for row in rows]
    return [graph for mesh in meshes if mesh is not None for graph in graphs_of(mesh, scene.materials).values()]


def _world(scene: Scene) -> tuple[str, ...]:
    if scene.world.image is not None:
        return ("PS_HAS_ENVIRONMENT",)
    return ("PS_HAS_WORLD",) if np.any(scene.world.color > 0) else ()


def _materials(scene: Scene, surface: bool) -> tuple[str, ...]:
    """`surface`: roughness and metallic vary within a material."""
    table = scene.materials
    metal = surface or bool((table.metallic > 0).any())
    found = {
        "PS_HAS_METAL": metal,
        "PS_HAS_GLOW": bool((table.emission > 0).any()),
        "PS_ONE_SURFACE": not metal
        and all(bool((values == values[0]).all()) for values in (table.roughness, table.ior, table.specular)),
    }
    return tuple(name for name, needed in found.items() if needed)
