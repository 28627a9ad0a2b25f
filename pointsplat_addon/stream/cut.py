"""What a view draws of the pages that are there: all of the finest ones, and of others what no finer one shows."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace

import numpy as np

from ..core.numeric.blocks import concatenated
from ..core.numeric.record import record
from ..core.scene.cloud import ATTRIBUTES, PointCloud
from ..core.scene.scene import PointSize
from .page import Page
from .tree import PageTree

Join = Callable[[Sequence[np.ndarray]], np.ndarray]


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


@record
class CutSplats:
    """The splats of a cut: points, and nodes with their shapes (N, 8) float32."""

    points: PointCloud | None
    nodes: PointCloud | None
    shape: np.ndarray | None
    whole: Mapping[int, slice] = field(default_factory=dict)  # rows of pages of which all splats are drawn

    @property
    def nbytes(self) -> int:
        return sum(part.nbytes for part in (self.points, self.nodes, self.shape) if part is not None)


def splats_of_cut(
    tree: PageTree, cut: PageCut, there: dict[int, Page], size: PointSize, lasting: bool = False
) -> CutSplats:
    """Returns the splats of a cut.

    Of additive scans all points of its pages are drawn, as wide as the points around them are apart. Of others pages
    stand in for the finer ones that are missing. `lasting`: they lie in memory that goes back to the system, which
    takes longer.
    """
    join: Join = concatenated if lasting else np.concatenate
    points: list[PointCloud] = []
    nodes: list[PointCloud] = []
    shapes: list[np.ndarray] = []
    whole: dict[int, slice] = {}
    ends = [0, 0]  # of points and of nodes
    for number in cut.pages:
        page = there[number]
        cloud, shape = page.cloud, page.shape
        if cloud is None:
            continue
        stands, count = cut.standing[page.deepest], page.count
        if not tree.directory.additive:
            mine = stands == number
            if not mine.any():
                continue
            if not mine.all():
                rows = np.flatnonzero(np.repeat(mine, count))
                cloud, shape = cloud.take(rows), None if shape is None else shape[rows]
                stands, count = stands[mine], count[mine]
        begin = ends[shape is not None]
        ends[shape is not None] = end = begin + len(cloud)
        if cloud is page.cloud:
            whole[number] = slice(begin, end)
        if shape is None:
            points.append(_sized(cloud, stands, count, there, size) if cloud.radii is None else cloud)
        else:
            nodes.append(cloud)
            shapes.append(shape)
    return CutSplats(
        joined(points, join) if points else None,
        joined(nodes, join) if nodes else None,
        join(shapes) if shapes else None,
        whole,
    )


def parts_of(splats: CutSplats, pages: dict[int, Page]) -> dict[int, Page]:
    """Returns those pages of which all splats are drawn with their part of what is joined in place of their own
    arrays."""
    found = {}
    for number, rows in splats.whole.items():
        page = pages[number]
        joint = splats.points if page.shape is None else splats.nodes
        if page.cloud is None or joint is None:
            continue
        arrays = {name: getattr(joint, name)[rows] for name in page.cloud.arrays()}
        shape = None if splats.shape is None or page.shape is None else splats.shape[rows]
        found[number] = replace(page, cloud=replace(page.cloud, **arrays), shape=shape)
    return found


def _sized(
    cloud: PointCloud, stands: np.ndarray, count: np.ndarray, there: dict[int, Page], size: PointSize
) -> PointCloud:
    """Points with radii. `stands`, `count`: (R,) the pages that stand for runs of them, and how many are in each."""
    pages, of_run = np.unique(stands, return_inverse=True)
    spacing = np.array([there[page].spacing for page in pages.tolist()], np.float32)
    return replace(cloud, radii=np.repeat(size.of(spacing)[of_run].astype(np.float32), count)[:, None])


def joined(clouds: list[PointCloud], join: Join = np.concatenate) -> PointCloud:
    """Returns clouds of one origin as one. Of attributes that some of them lack they have zeros."""
    if len(clouds) == 1:
        return clouds[0]
    found: dict[str, np.ndarray] = {}
    for name in ATTRIBUTES:
        given = [getattr(cloud, name) for cloud in clouds]
        some = next((array for array in given if array is not None), None)
        if some is not None:
            found[name] = join([
                np.zeros((len(cloud), *some.shape[1:]), some.dtype) if array is None else array
                for array, cloud in zip(given, clouds, strict=True)
            ])  # fmt: skip
    return replace(clouds[0], **found)
