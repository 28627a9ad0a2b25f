"""What a view draws of the pages that are there: all of the finest ones, and of others what no finer one shows."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np

from ..core.numeric.record import record
from ..core.scene.cloud import ATTRIBUTES, PointCloud
from ..core.scene.streamed import PointSize
from .page import Page
from .tree import PageTree


@record
class PageCut:
    """Pages that are drawn, and of each page of the scan the one that stands for it."""

    pages: tuple[int, ...]
    standing: np.ndarray  # (P,) int32; -1: none
    digest: str

    def __len__(self) -> int:
        return len(self.pages)


def cut_pages(tree: PageTree, there: dict[int, Page]) -> PageCut:
    """Returns the cut through a scan of the pages that are there."""
    drawn = np.zeros(len(tree), bool)
    drawn[list(there)] = True
    standing = tree.standing_for(drawn)
    pages = np.flatnonzero(standing == np.arange(len(tree)))
    digest = hashlib.blake2b(pages.astype(np.int64).tobytes(), digest_size=16).hexdigest()
    return PageCut(tuple(pages.tolist()), standing, digest)


def cloud_of_cut(tree: PageTree, cut: PageCut, there: dict[int, Page], size: PointSize) -> PointCloud | None:
    """Returns the splats of a cut; None without any.

    Of additive scans all points of its pages are drawn, as wide as the points around them are apart. Of others pages
    stand in for the finer ones that are missing.
    """
    parts: list[PointCloud] = []
    for number in cut.pages:
        page = there[number]
        if page.cloud is None:
            continue
        stands = cut.standing[page.deepest]
        cloud = page.cloud
        if not tree.directory.additive:
            mine = stands == number
            if not mine.any():
                continue
            if not mine.all():
                cloud = cloud.take(np.flatnonzero(np.repeat(mine, page.count)))
        if cloud.radii is None:
            spacing = np.array([there[int(one)].spacing for one in np.unique(stands)])
            each = spacing[np.searchsorted(np.unique(stands), stands)] if tree.directory.additive else page.spacing
            radius = size.of(np.broadcast_to(each, stands.shape).astype(np.float32))
            count = page.count
            if not tree.directory.additive:
                radius, count = radius[stands == number], page.count[stands == number]
            cloud = replace(cloud, radii=np.repeat(radius.astype(np.float32), count)[:, None])
        parts.append(cloud)
    return joined(parts) if parts else None


def joined(parts: list[PointCloud]) -> PointCloud:
    """Returns clouds of one origin as one. Attributes that some of them lack are zero there."""
    if len(parts) == 1:
        return parts[0]
    found: dict[str, np.ndarray] = {}
    for name in ATTRIBUTES:
        given = [getattr(part, name) for part in parts]
        some = [array for array in given if array is not None]
        if not some:
            continue
        width = max(array.shape[1:] for array in some)
        found[name] = np.concatenate([
            _widened(array, len(part), width, some[0].dtype) for array, part in zip(given, parts, strict=True)
        ])  # fmt: skip
    return replace(parts[0], **found)


def _widened(array: np.ndarray | None, count: int, width: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """An attribute with as many numbers a splat as `width` says; missing ones repeat the last."""
    if array is None:
        return np.zeros((count, *width), dtype)
    if array.shape[1:] == width:
        return array
    return array[:, np.minimum(np.arange(width[0]), array.shape[1] - 1)]
