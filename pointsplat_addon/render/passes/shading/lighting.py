"""What shaders of lib/light and lib/shadow read: defines, samplers, uniforms, and textures by sampler name."""

from __future__ import annotations

from ...device.protocol import Texture
from ..uniforms import Fields

LIGHT_POINTS, MOST_LIGHT_POINTS = 32, 4  # of a wide light: in a picture, and in one of its samples
FIRST_LIGHT_POINTS = 16  # that tell whether a point lies in a penumbra: with 6, its dark rim has a visible step
POINTS_OF_MEDIUM, POINTS_OF_STRAND = 2, 8  # that each voxel and each strand looks at: others than its neighbours do
ENOUGH_CELLS = 16  # samples that, each with a shadow cell of its own, make the mean of four between which it lies
# What lib/light and lib/shadow read: how many lights there are, and with shadows of wide lights the sample's number.
LIGHT_FIELDS: Fields = (("int", "light_count"),)
SAMPLE_FIELDS: Fields = (("int", "sample_index"),)


def lighting_defines(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Returns the defines of shaders that light. Shadows of wide lights differ from sample to sample: PS_SHADOW_SAMPLE
    is where the shader finds the sample's number. PS_SHADOW_STRANDS matters where groups of sub-samples are shaded,
    PS_FACES_COLORED to what keeps shares of light."""
    return tuple(
        (name, "u.sample_index" if name == "PS_SHADOW_SAMPLE" else "1")
        for name in lighting
        if name not in ("PS_SHADOW_STRANDS", "PS_FACES_COLORED")
    )


def is_colored(lighting: tuple[str, ...]) -> bool:
    """Tells whether shadows may differ between the channels."""
    return any(f"PS_{name}_COLORED" in lighting for name in ("SHADOW", "PANES", "FACES"))


def looks_at_points(lighting: tuple[str, ...]) -> bool:
    """Tells whether shadows are looked up from several points of some light."""
    tables = "PS_SHADOW_TABLES" in lighting and "PS_SHADOW_HARD" not in lighting
    return tables or "PS_SHADOW_SOFT" in lighting


def fog_defines(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Returns the defines of shaders that look up shadows along rays through fog, and at no surface of their own."""
    if "PS_FOG" not in lighting or "PS_SHADOWS" not in lighting:
        return ()
    medium = ("PS_POINTS_OF_MEDIUM", str(POINTS_OF_MEDIUM))
    spread = (("PS_SHADOW_SPREAD", "1"), medium) if looks_at_points(lighting) else ()
    return (*spread, *((("PS_SHADOW_TAPS", str(MOST_LIGHT_POINTS)),) if "PS_SHADOW_SAMPLE" in lighting else ()))


def lighting_samplers(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Returns the samplers that lib/light/lights.glsl and lib/shadow read."""
    wanted = (
        ("ps_lights", bool(lighting) and lighting != ("PS_BACKDROP",)),
        ("ps_backdrop", "PS_BACKDROP" in lighting),
        ("ps_environment", "PS_HAS_ENVIRONMENT" in lighting),
        ("ps_shadow_tables", "PS_SHADOW_TABLES" in lighting),
        ("ps_shadow_lights", "PS_SHADOW_TABLES" in lighting),
        ("ps_map_lights", "PS_SHADOW_MAPS" in lighting),
        ("ps_pane_lights", "PS_SHADOW_PANES" in lighting),
        ("ps_pane_faces", "PS_SHADOW_FACES" in lighting),
    )
    maps = (("ps_shadow_maps", "PS_SHADOW_MAPS" in lighting), ("ps_shadow_panes", "PS_SHADOW_PANES" in lighting))
    return tuple(
        (kind, name) for kind, names in (("FLOAT_2D", wanted), ("UINT_2D", maps)) for name, needed in names if needed
    )


def bound_textures(**named: Texture | None) -> dict[str, Texture]:
    """Returns the textures that are not None, by sampler name."""
    return {f"ps_{name}": texture for name, texture in named.items() if texture is not None}
