"""TODO: say what this module is."""

from __future__ import annotations

from ...device.protocol import Texture

LAMP_POINTS, MOST_LAMP_POINTS = 32, 4  # of a wide lamp: in a picture, and in one of its samples
ENOUGH_CELLS = 16  # samples that, each with a shadow cell of its own, make the mean of four between which it lies


def lighting_defines(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """Shadows of wide lamps differ from sample to sample: PS_SHADOW_SAMPLE is where the shader finds its number."""
    return tuple((name, "frame.size.z" if name == "PS_SHADOW_SAMPLE" else "1") for name in lighting)


def lighting_samplers(lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """What lib/light/lights.glsl reads."""
    wanted = (
        ("ps_lights", bool(lighting) and lighting != ("PS_BACKDROP",)),
        ("ps_backdrop", "PS_BACKDROP" in lighting),
        ("ps_environment", "PS_HAS_ENVIRONMENT" in lighting),
        ("ps_shadow_tables", "PS_SHADOWS" in lighting),
        ("ps_shadow_lights", "PS_SHADOWS" in lighting),
    )
    return tuple(("FLOAT_2D", name) for name, needed in wanted if needed)


def textures(**named: Texture | None) -> dict[str, Texture]:
    """Those that are there, by sampler name."""
    return {f"ps_{name}": texture for name, texture in named.items() if texture is not None}
