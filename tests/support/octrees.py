"""Points sorted into an octree as Entwine does: each node keeps some of its points and hands the others down."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.scene import PageSplats
from pointsplat_addon.formats.hierarchies.octree import Octree
from pointsplat_addon.formats.points.reader import Columns, FileReader, Header, PointFileError
from pointsplat_addon.stream.scan import PagedScan
from tests.support.scan_files import write_ept

SIDE = 20_000  # hundredths, of the root's cube, whose low corner is 0
PATIENCE = 20.0  # seconds
OFFSET = 10_000  # of the records that `write_ept` writes


def octree_nodes(position: np.ndarray, most: int) -> dict[str, np.ndarray]:
    """Nodes of at most `most` points, by name, of whole-numbered positions (N, 3) in [0, SIDE); further columns stay
    with them."""
    random = np.random.default_rng(len(position))
    found: dict[str, np.ndarray] = {}
    waiting = [((0, 0, 0, 0), position)]
    while waiting:
        (level, *place), points = waiting.pop()
        points = points[random.permutation(len(points))]
        found["-".join(map(str, (level, *place)))], points = points[:most], points[most:]
        octant = points[:, :3] * 2 ** (level + 1) // SIDE
        for child in np.unique(octant, axis=0) if len(points) else ():
            waiting.append(((level + 1, *child.tolist()), points[(octant == child).all(axis=1)]))
    return found


def write_octree(folder: Path, position: np.ndarray, most: int, kind: str = "binary") -> dict[str, np.ndarray]:
    """Writes positions (N, 3), hundredths in [0, SIDE), as an Entwine folder; returns its nodes."""
    nodes = octree_nodes(position, most)
    shift = OFFSET if kind != "laszip" else 0  # the tiles of LAZ have no offset
    write_ept(folder, {name: points - shift for name, points in nodes.items()}, kind)
    return nodes


def until(true: Callable[[], bool]) -> None:
    """Waits until something is true."""
    end = time.monotonic() + PATIENCE
    while not true():
        assert time.monotonic() < end
        time.sleep(0.002)


class MemoryPages(FileReader):
    """An additive octree in memory that counts which of its pages are read, and in which order."""

    def __init__(self, position: np.ndarray, most: int, spacing: float, side: float = 1.0) -> None:
        """`position`: (N, 3) within a cube of `side`, whose low corner is 0; `spacing`: of the root's points."""
        whole = np.clip((position / side * SIDE).astype(np.int64), 0, SIDE - 1)
        numbers = np.arange(len(position))
        nodes = octree_nodes(np.concatenate([whole, numbers[:, None]], axis=1), most)
        names = sorted(nodes, key=lambda name: [int(n) for n in name.split("-")])
        self.rows = [nodes[name][:, 3] for name in names]  # of the points of each page
        keys = np.array([[int(n) for n in name.split("-")] for name in names])
        count = np.array([len(rows) for rows in self.rows])
        header = Header(Path("memory"), "memory", len(position), ())
        octree = Octree(keys, count, 10 * count, np.zeros(3), side, spacing)
        self.directory = octree.directory(header)
        self.columns: Columns = {"position": position.astype(np.float32)}
        self.read_pages: list[int] = []
        self.damaged: set[int] = set()
        self.seconds = 0.0  # that a page takes

    def read(self, page: int) -> Columns:
        time.sleep(self.seconds)
        self.read_pages.append(page)
        if page in self.damaged:
            raise PointFileError(Path("memory"), f"has a wrong checksum in page {page}")
        return {name: values[self.rows[page]] for name, values in self.columns.items()}


class PlainLook:
    """Points as they are, with their colours."""

    key = "plain"

    def splats(self, elements: Mapping[str, np.ndarray], additive: bool) -> PageSplats:
        return PageSplats(PointCloud(elements["position"], color=elements.get("color")))


def scan_in_memory(source: MemoryPages, path: Path) -> PagedScan:
    """A scan of pages in memory; `path`: of a file that stands for it."""
    path.write_bytes(b"")
    return PagedScan(path, lambda _: source)
