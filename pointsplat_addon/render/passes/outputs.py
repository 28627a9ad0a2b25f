"""The render passes in one table: read by the engine's registration, by plan.py and by the output alike; and what they
hold where nothing is."""

from __future__ import annotations

from collections.abc import Set

import numpy as np

from ...core.numeric.record import value_record


@value_record
class RenderPass:
    """One pass of a view layer, named as Cycles names it."""

    key: str  # PointSplat's own name
    names: tuple[str, str]  # Cycles' name in Blender 4.5 and from 5.0
    channels: int
    ids: str  # channel letters
    kind: str  # COLOR, VALUE or VECTOR
    switch: str  # the property that asks for it, by its path from the view layer; "": always
    averaged: bool = True  # over the samples; else taken from the first one (at the pixel's centre)


PASSES = (
    RenderPass("combined", ("Combined", "Combined"), 4, "RGBA", "COLOR", ""),
    RenderPass("depth", ("Depth", "Depth"), 1, "Z", "VALUE", "use_pass_z", averaged=False),
    RenderPass("mist", ("Mist", "Mist"), 1, "Z", "VALUE", "use_pass_mist"),
    RenderPass("position", ("Position", "Position"), 3, "XYZ", "VECTOR", "use_pass_position", averaged=False),
    RenderPass("normal", ("Normal", "Normal"), 3, "XYZ", "VECTOR", "use_pass_normal"),
    RenderPass("vector", ("Vector", "Vector"), 4, "XYZW", "VECTOR", "use_pass_vector", averaged=False),
    RenderPass("object_index", ("IndexOB", "Object Index"), 1, "X", "VALUE", "use_pass_object_index", averaged=False),
    RenderPass(
        "material_index", ("IndexMA", "Material Index"), 1, "X", "VALUE", "use_pass_material_index", averaged=False
    ),
    RenderPass("crypto_object", ("CryptoObject", "CryptoObject"), 4, "RGBA", "COLOR", "use_pass_cryptomatte_object"),
    RenderPass(
        "crypto_material", ("CryptoMaterial", "CryptoMaterial"), 4, "RGBA", "COLOR", "use_pass_cryptomatte_material"
    ),
)


def _of_light(key: str, short: str, long: str, switch: str = "") -> RenderPass:
    return RenderPass(key, (short, long), 3, "RGB", "COLOR", switch or f"use_pass_{key}")


# Each is a picture of its own: render/light_passes.py.
LIGHT_PASSES = (
    _of_light("diffuse_direct", "DiffDir", "Diffuse Direct"),
    _of_light("diffuse_indirect", "DiffInd", "Diffuse Indirect"),
    _of_light("diffuse_color", "DiffCol", "Diffuse Color"),
    _of_light("glossy_direct", "GlossDir", "Glossy Direct"),
    _of_light("glossy_indirect", "GlossInd", "Glossy Indirect"),
    _of_light("glossy_color", "GlossCol", "Glossy Color"),
    _of_light("transmission_direct", "TransDir", "Transmission Direct"),
    _of_light("transmission_indirect", "TransInd", "Transmission Indirect"),
    _of_light("transmission_color", "TransCol", "Transmission Color"),
    _of_light("volume_direct", "VolumeDir", "Volume Direct", "pointsplat.use_pass_volume_direct"),
    _of_light("volume_indirect", "VolumeInd", "Volume Indirect", "pointsplat.use_pass_volume_indirect"),
    _of_light("emission", "Emit", "Emission", "use_pass_emit"),
    _of_light("environment", "Env", "Environment"),
    _of_light("ambient_occlusion", "AO", "Ambient Occlusion"),
)
BY_KEY = {p.key: p for p in (*PASSES, *LIGHT_PASSES)}
OF_LIGHT = frozenset(p.key for p in LIGHT_PASSES)
CRYPTO = ("crypto_object", "crypto_material")  # each becomes ceil(levels / 2) passes with suffix 00, 01, ...
BACKGROUND_DEPTH = 1e10  # Cycles' value where a ray meets nothing


def empty_pixels(keys: Set[str], size: tuple[int, int], color: np.ndarray, crypto_levels: int) -> dict[str, np.ndarray]:
    """Pictures (H, W, C) float32 of passes where nothing is but a world of one `color` (4,). `size`: width, height."""
    width, height = size
    out = {}
    for key in keys:
        channels = BY_KEY[key].channels
        if key in CRYPTO:
            for i in range((crypto_levels + 1) // 2):
                out[f"{key}{i:02d}"] = np.zeros((height, width, 4), np.float32)
            continue
        # What is filled at once is not zeroed first: that takes several times as long.
        if key == "combined":
            out[key] = np.empty((height, width, channels), np.float32)
            out[key].reshape(height, -1)[:] = np.tile(color.astype(np.float32), width)
        elif key in ("depth", "mist"):
            out[key] = np.full((height, width, channels), BACKGROUND_DEPTH if key == "depth" else 1.0, np.float32)
        else:
            out[key] = np.zeros((height, width, channels), np.float32)
    return out
