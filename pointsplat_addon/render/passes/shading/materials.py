"""The material table on the device: four texels for each material, and up to eleven where something has
more than the first columns hold.

They hold: base colour, alpha; emission, anisotropy; 1 where back faces are culled, roughness, metallic, the index of
refraction that stands for IOR and specular level; further parameters of hair (core.light.hair.hair_texels); of the coat
weight, roughness and index of refraction; its tint; the share of diffuse light that comes from behind; the tint of
reflections, diffuse roughness; colour and roughness of sheen; size and smoothness of toon shading, whether it is, and
the share that is cut out; the colour of gloss, and whether it is alike at every angle.
"""

from __future__ import annotations

import numpy as np

from ....core.light.bsdf import relative_index
from ....core.light.hair import hair_texels
from ....core.scene.materials import MaterialTable

LEAST_SPREAD = 0.99  # of |g|: lobes narrower than this would alias between splats


def material_rows(table: MaterialTable, escape: np.ndarray) -> np.ndarray:
    """Returns the material table, (M, 4 .. 11, 4) float32: one row of texels a material. escape: (M,), of hair."""
    further = {6: table.coat, 7: table.backlit, 8: _either(table.tint, table.diffuse_roughness), 9: table.sheen}
    further |= {10: _either(table.toon, table.holdout), 11: table.gloss}
    texels = max([4, *(count for count, column in further.items() if column is not None)])
    rows = np.zeros((len(table), texels, 4), np.float32)
    rows[:, 0, :3], rows[:, 0, 3] = table.base_color, table.alpha
    rows[:, 1, :3] = table.emission
    if table.anisotropy is not None:
        rows[:, 1, 3] = np.clip(table.anisotropy, -LEAST_SPREAD, LEAST_SPREAD)
    if table.hair is not None:
        of = table.hair
        rows[:, 3] = hair_texels(of.used, of.radial, of.coat, of.tilt, of.lobes, escape)
    rows[:, 2] = np.stack(
        [table.cull, table.roughness, table.metallic, relative_index(table.ior, table.specular)], axis=1
    )
    if table.coat is not None:
        rows[:, 4, :3] = np.stack([table.coat.weight, table.coat.roughness, table.coat.ior], axis=1)
        rows[:, 5, :3] = table.coat.tint
    if table.backlit is not None:
        rows[:, 6, :3] = table.backlit
    if table.tint is not None:
        rows[:, 7, :3] = table.tint
    if table.diffuse_roughness is not None:
        rows[:, 7, 3] = table.diffuse_roughness
    if table.sheen is not None:
        rows[:, 8] = table.sheen
    if table.toon is not None:
        rows[:, 9, :2] = np.maximum(table.toon, 0)
        rows[:, 9, 2] = table.toon[:, 0] >= 0
    if table.holdout is not None:
        rows[:, 9, 3] = table.holdout
    if table.gloss is not None:
        rows[:, 10] = table.gloss
    return rows


def _either(first: np.ndarray | None, second: np.ndarray | None) -> np.ndarray | None:
    return second if first is None else first
