"""The costs of drawing on a device, and which parts of a mesh are drawn as points or as triangles because of them.

Coconu and Hege (2002), section 5.1, switch from points to triangles where a block comes nearer than a threshold, and
leave it to future work to derive that threshold and the sampling resolution from the hardware. Here both follow from
seven measured figures (`Costs`, render/budget/calibrate.py): each part of a mesh takes what costs less in this view, at
the octave of spacing at which all parts together cost least.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from ..numeric.record import record, value_record

OVERLAP = 0.1  # share of the spacing that is needed within which a part is drawn as points and as triangles
# Points leave an error that more samples do not remove, triangles leave none: with up to this many times fewer samples,
# but at least one, triangles still leave less, at a tolerance of a pixel (docs/notes/techniques.md, measured 1.1 to 1.8
# times).
MAX_SAMPLES_RATIO = 4


@value_record
class Costs:
    """Nanoseconds that drawing takes for one sample of an image, and once for all its samples.

    The defaults are processor time of a software renderer.
    """

    point: float = 65.0  # each splat that is projected
    pixel: float = 105.0  # each pixel of an image with any points: resolving, filling holes
    triangle: float = 240.0  # each triangle
    fragment: float = 11.0  # each pixel that a triangle covers
    draw: float = 40_000.0  # each draw call
    prepared: float = 540.0  # once: sampling, packing and uploading a splat
    uploaded: float = 750.0  # once: each triangle of a mesh that any triangle is drawn of

    def valid(self) -> bool:
        """Whether all are positive and finite."""
        values = np.array([getattr(self, f.name) for f in fields(self)], float)
        return bool(np.isfinite(values).all() and (values > 0).all())

    def again_and_again(self) -> Costs:
        """The costs of views that are drawn so often that what is done once does not count."""
        return replace(self, prepared=0.0, uploaded=0.0)

    def of_picture(self, samples: int, instances: int = 1) -> Costs:
        """The costs, for one sample of triangles, of an image that is drawn once with so many `samples` of points.

        All samples of points are set against up to MAX_SAMPLES_RATIO times fewer of triangles. `instances` share what
        is done once.
        """
        dearer = min(max(samples, 1), MAX_SAMPLES_RATIO)
        share = dearer / (max(samples, 1) * max(instances, 1))
        return replace(
            self,
            point=self.point * dearer,
            pixel=self.pixel * dearer,
            prepared=self.prepared * share,
            uploaded=self.uploaded * share,
        )


DEFAULT = Costs()


@record
class PrimitiveChoice:
    """How one instance of a mesh of B parts is drawn."""

    octave: int  # index of the spacing of its points among those that were offered, finest first
    points: np.ndarray  # (B,) bool
    polygons: np.ndarray  # (B,) bool; parts out of view are neither, where points and polygons meet they are both
    cost: float  # nanoseconds for one sample, without those of all pixels
    triangles_cost: float  # nanoseconds for one sample with everything in view drawn as triangles


def choose_primitives(
    costs: Costs, needed: np.ndarray, spacing: np.ndarray, samples: np.ndarray, triangles: np.ndarray, area: np.ndarray
) -> PrimitiveChoice:
    """The cheapest way to draw one instance of a mesh of B parts.

    needed (B,): the spacing that each part needs in this view, inf where it is out of view. spacing (K,): octaves of
    spacing to choose from, finest first; samples (K, B): how many splats each part then has, inf where it cannot be
    points. triangles (B,): how many each part has. area (B,): of the parts, in the units of `needed` squared.

    A part is drawn as points only where its samples are as dense as it needs; those that need a spacing finer by up to
    OVERLAP are drawn as both, since a pixel between the last one of a polygon and the first one of a splat may be in
    neither. The pixels that triangles cover are estimated as half their area (the mean over all directions) at the
    part's nearest position. Samples are prepared of all parts that may be points, in view or not, and a mesh is
    uploaded as a whole if any of its triangles is drawn.
    """
    visible = np.isfinite(needed)
    with np.errstate(divide="ignore", invalid="ignore"):
        covered = np.where(visible, 0.5 * area / needed**2, 0.0)
    as_triangles = np.where(visible, triangles * costs.triangle + covered * costs.fragment, 0.0)
    as_points = np.where(visible, samples * costs.point, np.inf)
    prepare = np.where(np.isfinite(samples), samples, 0.0) * costs.prepared
    dense = needed >= spacing[:, None]
    better = dense & (as_points + prepare < as_triangles)
    meet = ~dense & (needed >= (1 - OVERLAP) * spacing[:, None]) & np.isfinite(as_points)
    meet &= better.any(axis=1, keepdims=True)
    total = np.where(better, as_points, as_triangles).sum(axis=1) + np.where(meet, as_points, 0.0).sum(axis=1)
    upload = float(triangles.sum()) * costs.uploaded
    total += np.where(better.any(axis=1), prepare.sum(axis=1), 0.0)
    total += np.where((visible & ~better).any(axis=1), upload, 0.0)
    every = float(as_triangles.sum()) + upload
    best = int(total.argmin())
    if every <= total[best] + costs.draw:
        return PrimitiveChoice(best, np.zeros_like(visible), visible, every, every)
    return PrimitiveChoice(best, better[best] | meet[best], visible & ~better[best], float(total[best]), every)


def mask_runs(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The first index and the length, (R,) int64 each, of every run of true values in a mask (B,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return edges[::2], edges[1::2] - edges[::2]
