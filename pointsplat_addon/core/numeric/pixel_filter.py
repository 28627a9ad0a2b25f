"""The pixel filter: a Blackman-Harris window along each axis (Harris 1978), as Cycles and EEVEE have it.

A filter's size is what Blender calls so: the pixels from the filter's centre to its end. The window is twice as wide.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from .lattice import Lattice

FILTER_SIZE = 1.5  # Blender's default
EDGE_STEPS = 64  # across a pixel, where edges lie that `edge_share` is fitted to
FIT_STEPS = 32  # in half of a window, and of the frequencies that weights are fitted to
FIT_HIGHEST = 15.0  # of these frequencies, radians a pixel: the lattices' own begin there
OWN = 0.45, 0.67, 0.9  # over the lattice's spacing: deviations of splats that weights are fitted to
DEGREE = 4  # of the kernel of splats: lib/splat/kernel.glsl
MOVED = 0.25  # of `edge_share`: what is finer than pixels differs from one to the next, and is seen the more


def blackman_harris(x: np.ndarray, size: float) -> np.ndarray:
    """Returns the weights, not normalised, at distances of `x` pixels from the centre; 0 from `size` pixels on."""
    t = np.pi * (np.asarray(x, float) / size + 1)
    found = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    return np.where(np.abs(x) < size, found, 0.0)


def filter_reach(size: float) -> int:
    """Returns how many pixels lie between a pixel and the farthest neighbour whose sub-samples it takes in, at least 1.

    Sub-samples lie within half a pixel of their pixel's centre. Lattices that are moved within a cell have some that
    lie farther away; what the filter would take of those of the next neighbours is left out: 1e-4 in the mean.
    """
    return max(math.ceil(size - 0.5), 1)


def filter_weights(lattice: Lattice, offset: tuple[float, float], size: float) -> np.ndarray:
    """Returns the weights by which a pixel takes from itself and its neighbours, (N, S) float64, which add up to 1.

    With a reach of r, N = (2 r + 1)^2. Row (2 r + 1) (y + r) + x + r is the neighbour at (x, y); column s is its
    sub-sample s. offset: pixels by which the sub-samples are moved. The filter ends no nearer than the next sub-samples
    on the lattice, so that it holds one wherever they are moved to.
    """
    size, reach = max(size, lattice.spacing), filter_reach(size)
    y, x = (axis.reshape(-1) - reach for axis in np.indices(2 * (2 * reach + 1,)))
    at = lattice.positions[None] + np.stack([x, y], axis=1)[:, None] + np.asarray(offset)
    weights = blackman_harris(at[..., 0], size) * blackman_harris(at[..., 1], size)
    return weights / weights.sum()


@cache
def edge_share(size: float) -> float:
    """Returns the share of a neighbour's weight that is best left to the pixel, for edges, where both hold means over
    their pixels.

    Such a mean is a box as wide as a pixel: with the weights of sub-samples, values would be blurred by the filter and
    by that box. With this share moved, the response of a row of pixels to an edge, anywhere across it, is the nearest
    to the filter's own, by least squares.
    """
    reach = filter_reach(size)
    x = (np.arange(-(reach + 1) * EDGE_STEPS, (reach + 1) * EDGE_STEPS) + 0.5) / EDGE_STEPS
    window = blackman_harris(x, size)
    window /= window.sum()
    pixel = np.round(x).astype(int) + reach + 1
    weights = np.bincount(pixel, window)
    alone = np.arange(len(weights)) == reach + 1
    blurred, own = (np.cumsum(w[pixel]) / EDGE_STEPS for w in (weights, alone))
    change = own - blurred
    return float(np.clip((change * (np.cumsum(window) - blurred)).sum() / max((change**2).sum(), 1e-12), 0, 1))


@cache
def weights_of_blurred(lattice: Lattice, offset: tuple[float, float], size: float, deviation: float) -> np.ndarray:
    """Returns weights (N, S) float64 as those of `filter_weights`, of sub-samples that show small splats, widened:
    together they blur as much as the filter does. They add up to 1.

    What edges of sums of splats look like is the nearest to what the filter shows, by least squares over all
    frequencies, of splats of several widths. deviation: of the Gaussian by which they are widened, in pixels.
    """
    size, reach = max(size, lattice.spacing), filter_reach(size)
    y, x = (axis.reshape(-1) - reach for axis in np.indices(2 * (2 * reach + 1,)))
    at = (lattice.positions[None] + np.stack([x, y], axis=1)[:, None] + np.asarray(offset)).reshape(-1, 2)
    along = np.arange(-FIT_STEPS, FIT_STEPS + 1) * (FIT_HIGHEST / FIT_STEPS)
    steps = (np.arange(-FIT_STEPS, FIT_STEPS) + 0.5) * (size / FIT_STEPS)
    window = blackman_harris(steps, size)
    window = np.cos(along[:, None] * steps) @ (window / window.sum())
    k = np.stack(np.meshgrid(along, along[FIT_STEPS:]), axis=-1).reshape(-1, 2)  # half of a plane: all else is alike
    squared = np.square(k).sum(axis=1)
    wanted = (window * window[FIT_STEPS:, None]).reshape(-1)
    of_edges = np.maximum(squared, 0.05) ** -1.5
    of_edges[k[:, 1] == 0] /= 2
    # Sums over the splats' widths: of the squared transforms, and of their products with what is wanted.
    products, shares = np.zeros(len(k)), np.zeros(len(k))
    for own in lattice.spacing * np.array(OWN):
        shown = _transform(np.sqrt(squared * (own**2 + deviation**2)))
        products += of_edges * shown**2
        shares += of_edges * shown * wanted * np.exp(-0.5 * own**2 * squared)
    angle = k @ at.T
    cosine, sine = np.cos(angle), np.sin(angle)
    weighed = products[:, None]
    found = np.linalg.solve(cosine.T @ (weighed * cosine) + sine.T @ (weighed * sine), cosine.T @ shares)
    return (found / found.sum()).reshape(len(x), -1)


def _transform(k: np.ndarray) -> np.ndarray:
    """The Fourier transform of the round kernel of the degree DEGREE with a variance of 1, at frequencies `k`."""
    rim = math.sqrt(2 * (DEGREE + 2))
    x = (np.arange(FIT_STEPS) + 0.5) * (rim / FIT_STEPS)
    across = (1 - np.square(x / rim)) ** (DEGREE + 0.5)  # its sums along lines
    highest = float(k.max())
    table = np.linspace(0, highest, 4 * FIT_STEPS)
    return np.interp(k, table, np.cos(table[:, None] * x) @ (across / across.sum()))
