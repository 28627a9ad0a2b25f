"""Parameters of hair's BSDF for shaders/lib/strands/hair.glsl, and how much scattered light leaves a mass of hair.

The model is described in tests/reference/hair_lighting.py, its float64 twin.
"""

from __future__ import annotations

import numpy as np

from ..scene.strands import Strands

# Escape share of an infinite mass of hair. By Chiang et al. (2016, equation 9) a colour of (0.45, 0.2, 0.08) is that of
# strands which scatter (0.97, 0.87, 0.71): escapes of 0.029, 0.038 and 0.035.
LEAST_ESCAPE = 0.03
BELOW_ONE = 0.999  # largest roughness that fits into a fraction


def strands_crossed(lines: Strands) -> float:
    """Estimates how many strands a random line through a mass of hair crosses.

    That is the strands' projected area (pi / 4 of width times length, the mean over all directions), divided by the
    mean silhouette of the ellipsoid inscribed in their bounding box, along its three axes. Returns 0 for strands
    without extent.
    """
    with np.errstate(all="ignore"):
        p = lines.position.astype(np.float64)
        length = np.linalg.norm(np.diff(p, axis=0), axis=1)
        length[lines.start[1:-1] - 1] = 0
        width = lines.radius[1:].astype(np.float64) + lines.radius[:-1]
        area = np.pi / 4 * np.nansum(length * width)
        x, y, z = np.nanmax(p, axis=0, initial=-np.inf) - np.nanmin(p, axis=0, initial=np.inf)
        found = area / (np.pi / 12 * (x * y + y * z + z * x))
    return float(found) if np.isfinite(found) and found > 0 else 0.0


def escape_share(crossed: np.ndarray) -> np.ndarray:
    """Returns the share of scattered light that leaves a mass of hair: 1 / (1 + crossed), at least LEAST_ESCAPE.

    `crossed`: see `strands_crossed`; of any shape, which is that of the result.
    """
    return np.maximum(1 / (1 + crossed), LEAST_ESCAPE)


def hair_texels(
    used: np.ndarray, radial: np.ndarray, coat: np.ndarray, tilt: np.ndarray, lobes: np.ndarray, escape: np.ndarray
) -> np.ndarray:
    """Packs the fourth texel of each row of the material table, (M, 4) float32; 0 for materials that are not hair.

    used, radial, coat, tilt, lobes: columns of HairTable; escape: (M,), see `escape_share`. Channels: 1 plus the escape
    share; the coat in 8 bits, plus the azimuthal roughness as a fraction; the tilt; the lobes in 8 bits each.
    """
    steps = np.rint(np.clip(lobes, 0, 1) * 255)
    both = np.rint(np.clip(coat, 0, 1) * 255) + np.clip(radial, 0, BELOW_ONE)
    columns = (1 + np.clip(escape, 0, 1), both, tilt, steps @ [1.0, 256.0, 65536.0])
    return (np.stack(columns, axis=1) * used[:, None]).astype(np.float32)
