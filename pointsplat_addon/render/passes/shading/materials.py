"""The material table on the device: four texels for each material, six where something is coated,
seven where something is lit from behind.

They hold: base colour, alpha; emission, anisotropy; 1 where back faces are culled, roughness, metallic, the index of
refraction that stands for IOR and specular level; further parameters of hair (core.light.hair.hair_texels); of the coat
weight, roughness and index of refraction; its tint; the share of diffuse light that comes from behind.
"""

from __future__ import annotations

import numpy as np

from ....core.light.bsdf import relative_index
from ....core.light.hair import hair_texels
from ....core.scene.materials import MaterialTable

LEAST_SPREAD = 0.99  # of |g|: lobes narrower than this would alias between splats


def material_rows(table: MaterialTable, escape: np.ndarray) -> np.ndarray:
    """Returns the material table, (M, 4 | 6 | 7, 4) float32: one row of texels a material. escape: (M,), of hair."""
    texels = 7 if table.backlit is not None else 6 if table.coat is not None else 4
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
    return rows
