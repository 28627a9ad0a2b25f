"""A page in memory: its splats, in runs of those that lie in the same deepest page below it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..core.numeric.blocks import copied_block
from ..core.numeric.record import record
from ..core.scene.cloud import PointCloud
from ..core.scene.scene import PageLook
from ..core.scene.valid.geometry import valid_points
from ..core.surface.nearest import median_spacing
from ..formats.points.reader import Columns
from .tree import PageTree

TEXEL, HALF_TEXEL = 16, 8  # bytes of four channels, and of four half floats or two floats
SHAPE = "shape"  # among the attributes of a cloud


@record
class Page:
    """The splats of one page, see core.scene.scene.PageSplats."""

    cloud: PointCloud | None  # None: nothing of it is drawn
    shape: np.ndarray | None  # (N, 8) float32 of nodes; None: they are points
    deepest: np.ndarray  # (R,) int32: the deepest page of the scan in which each run of splats lies
    count: np.ndarray  # (R,) int64: splats of the runs
    spacing: float  # typical distance between neighbours where no page below this one is drawn, object units

    @property
    def nbytes(self) -> int:
        own = (self.cloud, self.shape, self.deepest, self.count)
        return sum(part.nbytes for part in own if part is not None)

    @property
    def joined_nbytes(self) -> int:
        """Bytes that its splats take among those that are joined for a picture: points have radii there."""
        if self.cloud is None:
            return 0
        radii = self.cloud.position.itemsize * len(self.cloud) if self.cloud.radii is None else 0
        return self.cloud.nbytes + radii + (0 if self.shape is None else self.shape.nbytes)

    @property
    def device_nbytes(self) -> int:
        """Bytes that its splats take on the device, see render/passes/pages/point_page.py."""
        cloud, nodes = self.cloud, self.shape is not None
        if cloud is None:
            return 0
        balls = not nodes and cloud.normal is None and cloud.share is None and cloud.material is None
        balls &= cloud.radii is None or cloud.radii.shape[1] == 1
        texels = 1 + (not balls) + nodes  # position, extent, moments
        halves = sum(part is not None for part in (cloud.color, cloud.surface, cloud.emission))
        return len(cloud) * (TEXEL * texels + HALF_TEXEL * halves)

    def copied(self) -> Page:
        """The page with splats in memory of its own, which is given back with it."""
        cloud, shape = self.cloud, self.shape
        if cloud is None:
            return self
        arrays = copied_block(cloud.arrays() if shape is None else {**cloud.arrays(), SHAPE: shape})
        shape = arrays.pop(SHAPE, None)
        return replace(self, cloud=replace(cloud, **arrays), shape=shape)


def make_page(tree: PageTree, page: int, elements: Columns, look: PageLook) -> Page:
    """Returns a page of a scan's elements, in a look."""
    directory = tree.directory
    splats = look.splats(elements, directory.additive)
    cloud, shape = (None, None) if splats is None else splats
    if cloud is not None and shape is None:
        cloud = valid_points(cloud)[0]
    none = np.empty(0, np.int32)
    if cloud is None or len(cloud) == 0:
        return Page(None, None, none, none.astype(np.int64), float(directory.spacing[page]))
    deepest = tree.deepest(page, cloud.position)
    if (deepest[1:] < deepest[:-1]).any():
        order = np.argsort(deepest, kind="stable")
        cloud, deepest = cloud.take(order), deepest[order]
        shape = None if shape is None else shape[order]
    first = np.flatnonzero(np.r_[True, deepest[1:] != deepest[:-1]])
    count = np.diff(np.r_[first, len(deepest)])
    return Page(cloud, shape, deepest[first], count, _spacing(tree, page, elements["position"])).copied()


def _spacing(tree: PageTree, page: int, position: np.ndarray) -> float:
    """How far apart neighbours lie where a page is the deepest. Points of pages without any below them are as dense as
    the scan is there, which the level does not tell."""
    directory = tree.directory
    own = float(directory.spacing[page])
    if not (directory.additive and tree.is_leaf[page]) or page == 0:
        return own
    above = float(directory.spacing[directory.parent[page]])
    return float(np.clip(median_spacing(position) or above, own, above))
