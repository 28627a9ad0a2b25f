"""Leaves out lights, world and emission that add nothing measurable to a view.

Together they stay below 1/1024 of white in every pixel. All are bounds, not estimates.
A light of irradiance E adds at most E times

    a / pi + 2 s / (2 pi alpha^3)        on surfaces: albedo a; s of multiple over single scattering (Kulla and Conty
                                         2017); the GGX lobe times n.l is at most D V with D <= 1 / (pi alpha^2) and,
                                         for height-correlated Smith (Heitz 2014), V <= 1 / (2 alpha). Twice that is
                                         more than the closed forms of lights with a size make of it.
    a (1 + g) / (4 pi (1 - g)^2)         in media: Henyey and Greenstein's phase function straight ahead.

Where colours have no bound that is known without reading every texel, only what is exactly black is left out.
Translucent matter is left out only if it is exactly clear (render/prepare/in_view.py): the radiance behind it has no
bound. Mist affects only its own pass.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.light.bsdf import MIN_ALPHA, largest_multiple_scattering, relative_index
from ...core.light.light_shapes import irradiance_bound
from ...core.numeric.record import value_record
from ...core.scene.lights import Light
from ...core.scene.scene import Scene
from ...core.scene.world import World
from ...core.surface.appearance import graphs_of
from ..cache.keys import Key, Kind
from ..cache.store import Store
from .captured import lit_captured
from .in_view import ball_of_all_drawn
from .point_sets import Layer, PointSet
from .prepare import Prepared

MEASURABLE = 1 / 1024  # of white
LIGHTS, WORLD, EMISSION = MEASURABLE / 2, MEASURABLE / 4, MEASURABLE / 4  # the share of MEASURABLE of each
FIRST_TEXELS = 4096  # texels of a picture that are tested first: most pictures are bright


@value_record
class Reflection:
    """Upper bounds of how much light anything that is drawn reflects toward the eye; infinite: unknown."""

    albedo: float  # of diffuse light
    lobe: float  # radiance of the specular lobe for an irradiance of 1
    phase: float  # radiance of media for an irradiance of 1
    world: float  # radiance for a world of 1

    @property
    def black(self) -> bool:
        """Whether nothing that is drawn reflects light."""
        return self.world == 0.0

    def of(self, light: Light, irradiance: float) -> float:
        """Returns a bound of the radiance that a light of this `irradiance` adds."""
        if irradiance == 0.0 or self.black:
            return 0.0
        parts = ((light.diffuse / np.pi, self.albedo), (light.specular, self.lobe), (1.0, self.phase))
        return irradiance * sum(abs(factor) * bound for factor, bound in parts if factor != 0.0 and bound != 0.0)


def without_negligible(
    scene: Scene, prepared: Prepared, view_from_world: np.ndarray, store: Store
) -> tuple[Scene, bool, tuple[tuple[str, str], ...]]:
    """Returns the scene without lights, world and emission that add nothing measurable to the view.

    Where light changes captured splats, whose colours have no bound, and where the world's fog scatters it, all stays.
    Also returns whether anything that is
    drawn reflects light, and what was left out: tuples (what, because).
    """
    if lit_captured(scene, prepared.captured) or scene.world.fog is not None:
        return scene, True, ()
    bounds, notes = reflection(scene, prepared, store), []
    world = _world_or_black(scene, bounds)
    if world is not scene.world:
        notes.append(("world", "it adds less than 1/1024 of white"))
    lights = tuple(scene.lights)
    if lights:
        near = any(light.kind != "SUN" and np.any(light.color) for light in lights)
        ball = ball_of_all_drawn(scene, prepared, store) if near else (np.zeros(3), np.inf)
        added = np.array(
            [bounds.of(light, _irradiance_bound_in_ball(light, ball, view_from_world)) for light in lights]
        )
        order = np.argsort(added, kind="stable")
        left_out = np.zeros(len(lights), bool)
        left_out[order] = np.cumsum(added[order]) <= LIGHTS
        lights = tuple(light for light, gone in zip(lights, left_out, strict=True) if not gone)
        if left_out.any():
            why = (
                "nothing that is drawn reflects light"
                if bounds.black
                else "together they add less than 1/1024 of white"
            )
            notes.append(("lights", f"{left_out.sum()} of {len(left_out)}: {why}"))
    table = scene.materials
    if 0.0 < table.emission.max(initial=0.0) <= EMISSION and not _emission_varies(scene, prepared):
        table = replace(table, emission=np.zeros_like(table.emission))
        notes.append(("emission", "it adds less than 1/1024 of white"))
    scene = replace(scene, lights=lights, world=world, materials=table) if notes else scene
    return scene, not bounds.black, tuple(notes)


def reflection(scene: Scene, prepared: Prepared, store: Store) -> Reflection:
    """Returns bounds of how much of the arriving light anything that is drawn reflects toward the eye."""
    table = scene.materials
    rows, albedo, smooth = _used_materials(scene, prepared, store)
    known = np.array(sorted(rows), int)
    colors = max(albedo, float(table.base_color[known].max(initial=0.0)))
    shaped = any(column is not None for column in (table.diffuse_roughness, table.sheen, table.toon))
    colors = np.inf if shaped else colors  # at grazing angles
    metal = smooth or bool((table.metallic[known] > 0).any())
    smoothest = float(table.roughness[known].min(initial=1.0))
    coats = np.zeros(0) if table.coat is None else table.coat.roughness[known][table.coat.weight[known] > 0]
    smoothest = min(smoothest, float(coats.min(initial=1.0)))
    shines = metal or len(coats) > 0 or bool((relative_index(table.ior[known], table.specular[known]) != 1).any())
    alpha = MIN_ALPHA if smooth else max(smoothest**2, MIN_ALPHA)
    # The lobes of strands (core/light/hair.py) have no bound here, nor have splats that are diced from them.
    blurred = prepared.out_of_focus is not None and any(geometry.strands is not None for geometry in scene.geometries)
    strands = len(prepared.strands) > 0 or blurred
    lobe = np.inf if strands else largest_multiple_scattering() / (np.pi * alpha**3) if shines else 0.0
    media = any(points.cloud.extinction is not None for points in _point_sets(prepared))
    g = 0.0 if table.anisotropy is None else min(float(np.abs(table.anisotropy[known]).max(initial=0.0)), 0.99)
    phase = colors * (1 + g) / (4 * np.pi * (1 - g) ** 2) if media and colors > 0 else 0.0
    world = np.inf if strands else colors + (largest_multiple_scattering() if shines else 0.0)
    return Reflection(colors, lobe, phase, world)


def _point_sets(prepared: Prepared) -> list[PointSet]:
    layers: tuple[Layer, ...] = (prepared, prepared.translucent, prepared.spheres, prepared.nodes)
    return [points for layer in layers for points in layer.point_sets.values()]


def _used_materials(scene: Scene, prepared: Prepared, store: Store) -> tuple[set[int], float, bool]:
    """Returns the rows of the materials that are drawn, the brightest colour of point attributes and shader graphs, and
    whether roughness or metallic vary within a geometry."""
    rows: set[int] = set()
    albedo, smooth = 0.0, False
    for points in _point_sets(prepared):
        cloud = points.cloud
        rows |= set(store.lookup(Key(Kind.MATERIAL_ROWS, points.key), cloud.material_rows).tolist())
        if (color := cloud.color) is not None:
            albedo = max(albedo, store.lookup(Key(Kind.BRIGHTEST_COLOR, points.key), lambda c=color: _brightest(c)))
        smooth |= cloud.surface is not None
    for row in (
        np.unique(scene.instances.geometry[prepared.all_polygons]).tolist() if len(prepared.all_polygons) else ()
    ):
        mesh = scene.geometries[row].mesh
        if mesh is None:
            continue
        rows |= set(mesh.materials)
        channels = {name for graph in graphs_of(mesh, scene.materials).values() for name in graph.channels}
        albedo = np.inf if "base_color" in channels else albedo
        smooth |= bool(channels & {"roughness", "metallic"})
    for row in prepared.strands:
        lines = scene.geometries[row].strands
        rows |= set() if lines is None else set(lines.materials)
        albedo = np.inf
    return {row for row in rows if row < len(scene.materials)}, albedo, smooth


def _brightest(values: np.ndarray) -> float:
    """Returns the largest of `values` (N, 3); infinite if one is not finite."""
    most = float(np.max(values, initial=0.0))
    return most if np.isfinite(most) else np.inf


def _irradiance_bound_in_ball(light: Light, ball: tuple[np.ndarray, float], view_from_world: np.ndarray) -> float:
    """Returns a bound of a light's irradiance anywhere in a ball: centre (3,) in view space, and radius."""
    if not np.any(light.color):
        return 0.0
    at = view_from_world[:3, :3] @ np.asarray(light.position, float) + view_from_world[:3, 3]
    with np.errstate(all="ignore"):
        nearest = float(np.linalg.norm(at - ball[0])) - ball[1]
    found = irradiance_bound(light, max(nearest, 0.0) if np.isfinite(nearest) else 0.0)
    return found if np.isfinite(found) else np.inf


def _world_or_black(scene: Scene, bounds: Reflection) -> World:
    """Returns the world, or a black one if they cannot be told apart."""
    world = scene.world
    seen = None if scene.transparent else world.seen
    each = max(bounds.world, 0.0 if scene.transparent or seen is not None else 1.0)
    if world.mirrored is not None and bounds.world > 0.0:
        return world
    values = np.asarray(world.color if world.image is None else world.image).reshape(-1)
    if world.image is None and not (values > 0).any():
        return world
    if each == 0.0:
        return World(seen=seen)
    least = WORLD / each
    few = values[:: max(len(values) // FIRST_TEXELS, 1)]
    bright = not (np.abs(few) <= least).all() or not (np.abs(values) <= least).all()
    return world if bright else World(seen=seen)


def _emission_varies(scene: Scene, prepared: Prepared) -> bool:
    """Tells whether some emission is not a material's constant, or is that of media, whose radiance has no bound."""
    if (
        any(p.cloud.emission is not None or p.cloud.extinction is not None for p in _point_sets(prepared))
        or prepared.strands
    ):
        return True
    meshes = [scene.geometries[int(row)].mesh for row in np.unique(scene.instances.geometry[prepared.all_polygons])]
    graphs = [g for mesh in meshes if mesh is not None for g in graphs_of(mesh, scene.materials).values()]
    return any("emission" in graph.channels for graph in graphs)
