"""Scans as LAS files, and builds of small pages, for tests of hierarchies on disk."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pointsplat_addon.core.lod.balls.tree import MOST_SATURATION
from pointsplat_addon.formats.hierarchies.building import build as building
from pointsplat_addon.formats.hierarchies.building import cells, inputs, nodes, steps, subtree
from pointsplat_addon.formats.hierarchies.psh import PshPages

FAR = (5_000_000.0, 6_000_000.0, 100.0)


def write_las(path: Path, position: np.ndarray, color: np.ndarray | None = None, crs: int = 0, **columns) -> None:
    """A LAS or LAZ file of positions (N, 3), of steps of a millimetre, with colours (N, 3) uint16; `crs`: a code of
    EPSG, 0: none."""
    import laspy

    header = laspy.LasHeader(point_format=7 if color is not None else 6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.floor(position.min(axis=0))
    if crs:
        keys = laspy.vlrs.known.GeoKeyDirectoryVlr()
        keys.geo_keys_header.number_of_keys = 1
        key = laspy.vlrs.known.GeoKeyEntryStruct()
        key.id, key.tiff_tag_location, key.count, key.value_offset = 3072, 0, 1, crs
        keys.geo_keys = [key]
        header.vlrs.append(keys)
    made = laspy.LasData(header)
    made.x, made.y, made.z = position.T
    if color is not None:
        made.red, made.green, made.blue = color.T
    for name, column in columns.items():
        made[name] = column
    made.write(str(path))


def small_pages(monkeypatch, page: int = 256, chunk: int = 3000, part: int = 2000) -> None:
    """Lets builds of this process make pages, chunks and parts of files of so many elements."""
    for module in (nodes, subtree):
        monkeypatch.setattr(module, "MOST", page)
    monkeypatch.setattr(cells, "CHUNK", chunk)
    for module in (inputs, steps):
        monkeypatch.setattr(module, "PARTS", part)


def built(files: list[Path], output: Path, **settings) -> building.Built:
    """Builds in this process."""
    given = {"memory": 1 << 30, "workers": 1, **settings}
    return building.build(files, output, building.Settings(**given), lambda stage, share: None)


def leaves(pages: PshPages) -> np.ndarray:
    """The numbers of the pages that hold points."""
    inner = np.zeros(len(pages.directory), bool)
    inner[pages.directory.parent[1:]] = True
    return np.flatnonzero(~inner)


def cut(pages: PshPages, level: int) -> list[int]:
    """The pages that stand for the whole scan: those of a level, and the leaves above it."""
    given = pages.directory.level
    above = [int(i) for i in leaves(pages) if given[i] < level]
    return [*above, *np.flatnonzero(given == level).tolist()]


def coverage(pages: PshPages, which: list[int], axis: int, samples: np.ndarray) -> float:
    """The expected share of samples (S, 2), 0 to 1 within the scan's bounds, that elements of pages cover, seen along a
    coordinate axis. Nodes are covered as the visibility buffer draws them (core/lod/balls)."""
    plane = [a for a in range(3) if a != axis]
    low, high = pages.directory.bounds[0][:, plane]
    at = low + samples * (high - low)
    clear = np.ones(len(samples))
    for page in which:
        found = pages.read(page)
        matrix, share = _silhouettes(pages, page, found, plane)
        position, half = found["position"][:, plane], np.sqrt(matrix[:, [0, 1], [0, 1]])
        near = (at >= (position - half).min(axis=0)) & (at <= (position + half).max(axis=0))
        near = np.flatnonzero(near.all(axis=1))
        x, y = np.moveaxis(at[near, None] - position, 2, 0)
        [[xx, xy], [_, yy]] = np.moveaxis(matrix, 0, 2)
        inside = x * x * yy - 2 * x * y * xy + y * y * xx <= xx * yy - xy * xy
        clear[near] *= np.where(inside, 1 - share, 1).prod(axis=1)
    return float(1 - clear.mean())


def _silhouettes(pages: PshPages, page: int, found: dict, plane: list[int]) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the silhouettes' half-axes (N, 2, 2) of a page's elements, and how much of each is covered (N,)."""
    count = len(found["position"])
    if "radii" not in found:
        return np.tile(np.eye(2) * (pages.directory.spacing[page] / 2) ** 2, (count, 1, 1)), np.ones(count)
    radii = found["radii"].astype(np.float64)
    frame = (
        np.stack([found["axis"], np.cross(found["normal"], found["axis"]), found["normal"]], axis=2) * radii[:, None]
    )
    matrix = (frame @ frame.transpose(0, 2, 1))[:, plane][:, :, plane]
    depth = -np.log(np.clip(1 - found["covered"], 1 / 512, 1))
    areas = (np.sqrt(1 + 4 * MOST_SATURATION * depth) - 1) / (2 * MOST_SATURATION)
    silhouette = np.sqrt(matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] ** 2)
    seen = areas * radii[:, 0] * radii[:, 1] / silhouette
    return matrix, 1 - np.exp(-seen * (1 + MOST_SATURATION * seen))
