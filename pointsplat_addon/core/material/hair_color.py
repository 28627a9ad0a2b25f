"""The colour of hair: absorption by melanin or from a colour, as in Cycles' Principled Hair BSDF.

Chiang et al. 2016, "A practical and controllable hair and fur model for production path tracing", equation 9 relates
absorption to the colour that a head of such hair has; d'Eon et al. 2011 give the melanins.
"""

from __future__ import annotations

import numpy as np

EUMELANIN = (0.506, 0.841, 1.653)  # absorption of a concentration of 1, per fibre radius
PHEOMELANIN = (0.343, 0.733, 1.924)
LEAST = 1e-6  # colours below this are black, and their absorption is finite; float16 holds it


def strand_attribute(name: str) -> str:
    """Name of the attribute of strands that holds an output of Blender's Curves Info node, such as "Random"."""
    return f"strand:{name}"


def roughness_scale(radial: np.ndarray | float) -> np.ndarray:
    """Denominator of equation 9 of Chiang et al. 2016: a polynomial in the radial roughness (...), float64."""
    x = np.asarray(radial, np.float64)
    return ((((0.245 * x + 5.574) * x - 10.73) * x + 2.532) * x - 0.215) * x + 5.969


def absorption_from_color(color: np.ndarray, radial: np.ndarray) -> np.ndarray:
    """Absorption (N, 3) float64 per fibre radius of hair that looks like color (N, 3); radial (N, 1) roughness."""
    return (np.log(np.clip(np.asarray(color, np.float64), LEAST, 1)) / roughness_scale(radial)) ** 2


def color_from_absorption(absorption: np.ndarray, radial: np.ndarray) -> np.ndarray:
    """The inverse of `absorption_from_color`: (N, 3) float64 in (0, 1]."""
    return np.exp(-np.sqrt(np.maximum(np.asarray(absorption, np.float64), 0)) * roughness_scale(radial))


def absorption_from_melanin(melanin: np.ndarray, redness: np.ndarray) -> np.ndarray:
    """Absorption (N, 3) float64 from Blender's melanin (N, 1), 0 white and 1 black, and the share of pheomelanin."""
    amount = -np.log(np.maximum(1 - np.asarray(melanin, np.float64), 1e-4))
    return amount * ((1 - redness) * np.array(EUMELANIN) + redness * np.array(PHEOMELANIN))


def random_of_strands(count: int, first: int = 0) -> np.ndarray:
    """(count,) float32 in [0, 1]: Cycles' random number of strands `first` and on (Jenkins' lookup3 of two words)."""
    with np.errstate(over="ignore"):
        words = [np.full(count, 0xDEADBEEF + (2 << 2) + 13, np.uint32) for _ in range(3)]
        words[0] += np.arange(first, first + count, dtype=np.uint32)
        for x, y, turn in ((2, 1, 14), (0, 2, 11), (1, 0, 25), (2, 1, 16), (0, 2, 4), (1, 0, 14), (2, 1, 24)):
            words[x] ^= words[y]
            words[x] -= words[y] << np.uint32(turn) | words[y] >> np.uint32(32 - turn)
    return words[2].astype(np.float32) / np.float32(0xFFFFFFFF)
