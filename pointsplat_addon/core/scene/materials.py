"""The table of materials: constants of surfaces, hair and media, one row for each material."""

from __future__ import annotations

import numpy as np

from ..numeric.record import record
from .volume import Medium


@record
class HairTable:
    """The Principled Hair values of each row of a MaterialTable; rows that are not hair hold Blender's defaults.

    The table's `ior` and `roughness` (the longitudinal one) are hair's too, and its `base_color` is the colour that a
    head of such hair has; `core.pigment` turns that, or a point's own, and the radial roughness into absorption.
    """

    used: np.ndarray  # (M,) bool: this row is hair
    radial: np.ndarray  # (M,) float32, azimuthal roughness in [0, 1]; Huang's model: the longitudinal one
    coat: np.ndarray  # (M,) float32 in [0, 1]: how much smoother the first reflection is
    tilt: np.ndarray  # (M,) float32, radians: of the cuticle's scales, Blender's Offset
    lobes: np.ndarray  # (M, 3) float32: factors of reflection, transmission and second reflection; 1 in Chiang's model


@record
class CoatTable:
    """The clear layer above each row's surface: a dielectric GGX lobe, which shades what lies below."""

    weight: np.ndarray  # (M,) float32 in [0, 1]: the share of the surface that is coated
    roughness: np.ndarray  # (M,) float32, as that of the surface
    ior: np.ndarray  # (M,) float32
    tint: np.ndarray  # (M, 3) float32 in [0, 1]: transmittance of the layer along its normal


@record
class MaterialTable:
    """Constants for each material (row 0 is the default material). Attributes on points override them."""

    base_color: np.ndarray  # (M, 3) float32
    roughness: np.ndarray  # (M,) float32, Principled roughness (alpha = roughness^2)
    metallic: np.ndarray  # (M,) float32
    ior: np.ndarray  # (M,) float32
    specular: np.ndarray  # (M,) float32, Principled specular IOR level (0.5: F0 from ior; 0: no specular)
    emission: np.ndarray  # (M, 3) float32, emitted radiance
    alpha: np.ndarray  # (M,) float32
    cull: np.ndarray  # (M,) bool: backface culling
    pass_index: np.ndarray  # (M,) int32
    hash: np.ndarray  # (M,) uint32: cryptomatte hash of the name
    names: tuple[str, ...] = ()
    # (M,) float32, Henyey-Greenstein's g of media; None: all 0
    anisotropy: np.ndarray | None = None
    # (M,) bool: light passes through (alpha below 1 somewhere, or transmission), so the material's surfaces are drawn
    # as translucent splats; None: nowhere
    translucent: np.ndarray | None = None
    # (M, 3) float32, 0 to 1: the light that passes, 1 - alpha, is multiplied by this; None: all 1
    transmission_color: np.ndarray | None = None
    # (M,) bool: the light that passes is transmitted by glass, not left open by alpha, which only passes of light tell
    # apart; None: nowhere
    glass: np.ndarray | None = None
    media: tuple[Medium | None, ...] = ()  # what fills volumes of each material
    graphs: tuple[object | None, ...] = ()  # core.materials.Graph for materials whose inputs vary, else None
    hair: HairTable | None = None  # what strands of the materials are besides; None: none of them is hair
    coat: CoatTable | None = None  # None: nothing is coated
    # (M, 3) float32, 0 to 1: the share of the diffuse light that comes from behind the surface; None: none of it
    backlit: np.ndarray | None = None
    # (M, 3) float32 of the specular reflection: dielectrics' at normal incidence; metals' at 82 degrees, over what
    # Schlick's curve has there (F82 tint); None: all 1
    tint: np.ndarray | None = None
    # (M, 4) float32 of the metallic share: its colour, -1 where that is the base colour; and 1 where it reflects alike
    # at every angle, as the Glossy BSDF does, else 0; None: all (-1, -1, -1, 0)
    gloss: np.ndarray | None = None
    diffuse_roughness: np.ndarray | None = None  # (M,) float32, 0 to 1, of Oren and Nayar's model; None: all 0
    sheen: np.ndarray | None = None  # (M, 4) float32, 0 to 1: colour times weight, roughness; None: no sheen
    # (M, 2) float32: size and smoothness of materials whose diffuse light is the Toon BSDF's, else -1; None: none is
    toon: np.ndarray | None = None
    holdout: np.ndarray | None = None  # (M,) float32, 0 to 1: the share that is cut out of pictures; None: all 0

    def __len__(self) -> int:
        return len(self.roughness)


def default_materials() -> MaterialTable:
    """A table with only row 0: Blender's default Principled surface."""
    f = np.float32
    return MaterialTable(
        base_color=np.array([[0.8, 0.8, 0.8]], f),
        roughness=np.array([0.5], f),
        metallic=np.zeros(1, f),
        ior=np.array([1.5], f),
        specular=np.array([0.5], f),
        emission=np.zeros((1, 3), f),
        alpha=np.ones(1, f),
        cull=np.zeros(1, bool),
        pass_index=np.zeros(1, np.int32),
        hash=np.zeros(1, np.uint32),
        names=("Default",),
        graphs=(None,),
    )
