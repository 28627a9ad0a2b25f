"""Baked pictures of materials on the device, with their smaller levels, and what shaders that read them are told."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ....core.material.baking import BORDER, reading, split_bumps
from ....core.material.graph import MaterialGraph
from ....core.material.levels import (
    Stored,
    interleaved,
    laid_out,
    shown_light,
    shown_normals,
    shown_slopes,
    smaller_levels,
)
from ....core.scene.materials import MaterialTable
from ...device.packing import paged
from ...device.protocol import CHANNELS, Device, Texture

LARGEST_PICTURE = 4096  # texels along a side of a baked picture
LEVELS = "_levels"  # after a picture's sampler name: its smaller levels
BENDING = {"ps_baked_normal": "RGBA16F", "ps_baked_height": "RGBA32F"}  # pictures whose levels hold moments: formats


def baked_defines(graph: MaterialGraph, emission: bool) -> tuple[str, ...]:
    """Returns the defines of shaders that read the baked pictures of a graph."""
    on, how = graph.channels.keys(), reading(graph)
    below, heights, _ = split_bumps(graph.normal)
    names = {
        "PS_UV": True,
        "PS_BAKED_COLOR": bool(on & {"base_color", "alpha"}),
        "PS_BAKED_ALPHA": "alpha" in on,
        "PS_BAKED_SURFACE": bool(on & {"roughness", "metallic"}),
        "PS_BAKED_EMISSION": emission and "emission" in on,
        "PS_BAKED_NORMAL": below is not None,
        "PS_BAKED_HEIGHT": heights is not None,
        "PS_PICTURE_MIRROR": how.extension == "MIRROR",
        "PS_PICTURE_BORDER": how.extension == "BORDER",
        "PS_PICTURE_CLOSEST": how.closest,
    }
    for channel, kind in (("base_color", "COLOR"), ("emission", "EMISSION")):
        names[f"PS_ENCODED_{kind}"] = channel in how.encoded and names[f"PS_BAKED_{kind}"]
        names[f"PS_ASSOCIATED_{kind}"] = channel in how.associated and names[f"PS_BAKED_{kind}"]
    return tuple(name for name, there in names.items() if there)


def level_samplers(textures: Iterable[str], names: Iterable[str]) -> list[str]:
    """Returns the samplers among `textures` of levels of those pictures that a shader with these defines reads."""
    return [name for name in textures if name.endswith(LEVELS) and name.removesuffix(LEVELS).upper() in names]


def level_defines(samplers: list[str], defines: Iterable[str]) -> list[str]:
    """Returns the defines of a shader that reads levels by these samplers, of a material with `baked_defines`; there
    are none where it reads none."""
    return ["PS_LEVELS", *(["PS_ALPHA_WEIGHTS"] if "PS_BAKED_ALPHA" in defines else [])] if samplers else []


def define_entries(names: Iterable[str]) -> tuple[tuple[str, str], ...]:
    """Returns defines with their values."""
    return tuple((name, str(BORDER) if name == "PS_PICTURE_BORDER" else "1") for name in names)


def _samplers(graph: MaterialGraph, emission: bool) -> dict[str, tuple[str, tuple[str, ...]]]:
    """By sampler name of a graph's pictures: format, and channels side by side, of which "" is one of zeros."""
    names = baked_defines(graph, emission)
    weight = "alpha" if "alpha" in graph.channels else ""
    kinds = {
        "ps_baked_color": ("RGBA16F", ("base_color", "alpha")),
        "ps_baked_surface": ("RG32F", ("roughness", "metallic")),
        "ps_baked_emission": ("RGBA16F", ("emission", weight)),
        "ps_baked_normal": ("RGBA16F", ("normal", "")),
        "ps_baked_height": ("RG32F", ("height",)),
    }
    return {name: kind for name, kind in kinds.items() if name.upper() in names}


def _constants(table: MaterialTable, row: int) -> dict[str, np.ndarray]:
    """The values (C,) by name of channels that do not vary but share a texture with one that does."""
    return {"base_color": table.base_color[row], "alpha": np.ones(1), "roughness": table.roughness[[row]],
            "metallic": table.metallic[[row]]}  # fmt: skip


class Pictures:
    """What varies of a material over the UV square, baked as textures by sampler name. They belong to no mesh: meshes
    share them, and may move without another."""

    def __init__(
        self,
        device: Device,
        graph: MaterialGraph,
        picture: dict[str, np.ndarray],
        table: MaterialTable,
        row: int,
        emission: bool,
    ) -> None:
        """`picture`: that of core.surface.appearance.baked."""
        constants = _constants(table, row)
        self.textures: dict[str, Texture] = {}
        for name, (format, channels) in _samplers(graph, emission).items():
            data = interleaved(picture, constants, channels)
            height, width = data.shape[:2]
            self.textures[name] = device.texture((width, height), format, data.reshape(-1))

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()


class Levels:
    """The smaller levels of a graph's pictures, as textures by sampler name. Those of normals and heights hold moments,
    of unit normals and of slopes."""

    def __init__(
        self,
        device: Device,
        graph: MaterialGraph,
        picture: dict[str, np.ndarray],
        table: MaterialTable,
        row: int,
        emission: bool,
        spread: bool,
    ) -> None:
        """`picture`: that of core.surface.appearance.baked. `spread`: the spread of normals is wanted."""
        constants, how = _constants(table, row), reading(graph)
        beyond = {"REPEAT": "wrap", "MIRROR": "symmetric"}.get(how.extension, "edge")
        self.textures: dict[str, Texture] = {}
        for name, (format, channels) in _samplers(graph, emission).items():
            if name in BENDING and not spread:
                continue
            first, texels = channels[0], interleaved(picture, constants, channels)
            weighted = "alpha" in graph.channels
            held = Stored(first in how.encoded, first in how.associated, weighted, how.closest, beyond)
            if name == "ps_baked_normal":
                texels = shown_normals(texels, held)
            elif name == "ps_baked_height":
                texels = shown_slopes(texels[..., 0], how.border, held)
            elif name != "ps_baked_surface":
                texels = shown_light(texels, held)
            format = BENDING.get(name, format)
            levels = smaller_levels(texels, how.border)
            if levels:
                size, data = paged(laid_out(levels), CHANNELS[format])
                self.textures[name + LEVELS] = device.texture(size, format, data)

    def release(self) -> None:
        for texture in self.textures.values():
            texture.release()
