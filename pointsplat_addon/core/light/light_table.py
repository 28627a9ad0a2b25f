"""The texture that shaders/lib/light reads: reflectance tables, the world's colour and one row for each light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.lights import Light
from ..scene.world import World
from .bsdf import MIN_ALPHA, TABLE_ROWS, WIDTH, reflectance_table, surface_row
from .fog import TEXELS, fog_texels
from .light_shapes import KINDS, area_axes, beam_mean, blend_range, is_narrowed, light_kind

# ps_lights, (FIRST_LIGHT + lights, WIDTH, 4) float32:
#   rows 0 .. TABLE_ROWS      reflectance table, see bsdf.reflectance_table
#   row TABLE_ROWS            (0) world colour; (1..3) columns of image_from_view; (4) where each kind but the last
#                             ends; (5..7) fog, see fog.fog_texels
#   row SURFACE_ROW           dielectrics of one kind: see bsdf.surface_row
#   rows FIRST_LIGHT ..       one light each, sorted by kind, see light_records
SURFACE_ROW = TABLE_ROWS + 1
FIRST_LIGHT = TABLE_ROWS + 2
COLUMNS = 6
FOG = 5  # column of the world's row
SMALL = 0.2  # angular radius of a light over the lobe's alpha, below which it is a point: 0.5 % in the peak
SMALL_SINE = 0.01  # of an angular radius whose cut by the horizon is not seen


def light_names(lights: Sequence[Light], roughness: float) -> tuple[str, ...]:
    """Names (PS_...) that switch on the parts of shaders/lib/light which the lights need.

    roughness: the smallest of all surfaces; lights that are small against its lobe are treated as points.
    """
    kinds = {light_kind(light) for light in lights}
    found = {f"PS_HAS_{kind}S": kind in kinds for kind in KINDS}
    found["PS_ONE_KIND"] = len(kinds) == 1
    found["PS_HAS_WIDE_LIGHTS"] = any(_is_wide(light, roughness) for light in lights)
    found["PS_HAS_BEAMS"] = any(light.kind == "AREA" and is_narrowed(light) for light in lights)
    return tuple(name for name, needed in found.items() if needed)


def sorted_by_kind(lights: Sequence[Light]) -> list[Light]:
    """Lights in the order of their rows in the light table: by kind."""
    return sorted(lights, key=lambda light: KINDS.index(light_kind(light)))


def light_texture(
    lights: Sequence[Light],
    world: World,
    view_from_world: np.ndarray,
    roughness: float = 0.5,
    eta: float = 1.5,
    near: float = 0.0,
) -> np.ndarray:
    """The light table ps_lights that shaders/lib/light reads: (FIRST_LIGHT + L, WIDTH, 4) float32.

    roughness, eta: of the whole scene, where PS_ONE_SURFACE says that all of it is alike and nothing metallic. near: of
    the camera.
    """
    lights = sorted_by_kind(lights)
    texture = np.zeros((FIRST_LIGHT + len(lights), WIDTH, 4), np.float32)
    texture[:TABLE_ROWS] = reflectance_table()
    texture[SURFACE_ROW] = surface_row(roughness, eta)
    kinds = [KINDS.index(light_kind(light)) for light in lights]
    texture[TABLE_ROWS, 4] = np.searchsorted(kinds, np.arange(len(KINDS) - 1), side="right")
    texture[TABLE_ROWS, 0, :3] = world.color
    texture[TABLE_ROWS, 1:4, :3] = (world.world_rotation @ view_from_world[:3, :3].T).T  # columns as rows
    if world.fog is not None:
        texture[TABLE_ROWS, FOG : FOG + TEXELS] = fog_texels(world.fog, near)
    texture[FIRST_LIGHT:, :COLUMNS] = light_records(lights, view_from_world)
    return texture


def light_records(lights: Sequence[Light], view_from_world: np.ndarray) -> np.ndarray:
    """Records of lights, (L, COLUMNS, 4) float32 in view space; what a kind does not name is 0.

    column  xyz                                      w
    0       color, as in scene.Light                 diffuse factor
    1       position (SUN: direction to the light)   specular factor
    2       direction (not SUN)                      SUN: squared sine of half the angle. POINT, SPOT: radius, less
                                                     than 0 for a sphere. Area: 1 / mean of the beam, 0: not narrowed
    3       axis_u                                   SPOT: cosine of half the cone. Area: length of axis_u
    4       axis_v                                   SPOT: 1 / range of the blend's cosines. Area: length of axis_v
    5       x, area: tangent of half the beam's angle
    """
    rotation = view_from_world[:3, :3]
    records = np.zeros((len(lights), COLUMNS, 4))
    for record, light in zip(records, lights, strict=True):
        record[:2, 3] = light.diffuse, light.specular
        record[0, :3] = light.color
        if light.kind == "SUN":
            record[1, :3], record[2, 3] = rotation @ -light.direction, np.sin(min(light.radius, np.pi / 2)) ** 2
            continue
        record[1, :3] = rotation @ light.position + view_from_world[:3, 3]
        record[2] = *(rotation @ light.direction), light.radius if light.soft else -light.radius
        axes = area_axes(light)
        record[3:5, :3] = axes @ rotation.T
        if light.kind == "SPOT":
            record[3:5, 3] = light.spot_cos, 1 / blend_range(light)
        if light.kind == "AREA":
            record[3:5, 3] = np.linalg.norm(axes, axis=1)
            record[2, 3] = 1 / beam_mean(light.spread / 2) if is_narrowed(light) else 0
            record[5, 0] = np.tan(light.spread / 2) if is_narrowed(light) else 0
    return records.astype(np.float32)


def _is_wide(light: Light, roughness: float) -> bool:
    """Whether a light's size may show: on surfaces of this roughness for suns, always for spheres and spots."""
    if light.kind != "SUN":
        return light.kind != "AREA" and light.radius > 0
    return np.sin(light.radius) >= SMALL_SINE or light.radius >= SMALL * max(roughness**2, MIN_ALPHA)
