"""Computes Cryptomatte: the ranked coverage of identities among samples (Cryptomatte specification 1.2)."""

from __future__ import annotations

import math

import numpy as np

MOST_ENTRIES = 1 << 24  # identities that are ranked at once
LEAST_SHARE = 1e-12  # less is rounding; the least weight of one sub-sample is 1e-10


def cryptomatte(hashes: np.ndarray, levels: int) -> list[np.ndarray]:
    """Ranks the identities of each pixel by coverage.

    `hashes`: (S, H, W) uint32 identities of S samples; 0: none. Returns ceil(levels / 2) pictures (H, W, 4) float32
    with identity and coverage of two ranks each; the bits of an identity are stored as a float.
    """
    samples, height, width = hashes.shape
    entries = hashes.reshape(samples, -1)
    return [page.reshape(height, width, 4) for page in _ranked(entries, np.full((samples, 1), 1 / samples), levels)]


def filtered_cryptomatte(lattices: list[tuple[np.ndarray, np.ndarray]], levels: int) -> list[np.ndarray]:
    """Ranks the identities of each pixel by what the pixel filter makes of their coverage; returns as `cryptomatte`.

    `lattices`: of each, the identities of all sub-samples, (S, H, W) uint32, and the filter's weights of those of a
    pixel's neighbours and its own, (N, S) as `filter_weights` has them.
    """
    first, weight = lattices[0]
    height, width = first.shape[1:]
    reach = math.isqrt(len(weight)) // 2
    neighbours = [(x, y) for y in range(-reach, reach + 1) for x in range(-reach, reach + 1)]
    alike = np.ones((height, width), bool)
    for hashes, _ in lattices:
        alike &= (hashes == first[0]).all(axis=0)
    padded, around = np.pad(first[0], reach, mode="edge"), np.pad(alike, reach, mode="edge")
    whole = alike.copy()
    for x, y in neighbours:
        seen = slice(reach + y, reach + y + height), slice(reach + x, reach + x + width)
        whole &= around[seen] & (padded[seen] == first[0])
    found = [np.zeros((height, width, 4), np.float32) for _ in range((levels + 1) // 2)]
    found[0][..., 0], found[0][..., 1] = np.ascontiguousarray(first[0]).view(np.float32), first[0] != 0
    row, column = np.nonzero(~whole)
    weights = np.concatenate([weight.reshape(-1, 1) for _, weight in lattices]) / len(lattices)
    runs = -(-len(row) * len(weights) // MOST_ENTRIES)
    for some in np.array_split(np.arange(len(row)), max(runs, 1)):
        entries = []
        for hashes, _ in lattices:
            for x, y in neighbours:
                at = np.clip(row[some] + y, 0, height - 1), np.clip(column[some] + x, 0, width - 1)
                entries.append(hashes[:, at[0], at[1]])
        for picture, of_mixed in zip(found, _ranked(np.concatenate(entries), weights, levels), strict=True):
            picture[row[some], column[some]] = of_mixed
    return found


def _ranked(entries: np.ndarray, weights: np.ndarray, levels: int) -> list[np.ndarray]:
    """The pictures (P, 4) of P pixels. entries: (N, P) uint32. weights: (N, 1), which add up to 1."""
    order = np.argsort(entries, axis=0, kind="stable")
    ordered = np.take_along_axis(entries, order, 0)
    sums = np.cumsum(weights[:, 0][order], axis=0)
    begins = np.ones(ordered.shape, bool)
    begins[1:] = ordered[1:] != ordered[:-1]
    # Where each run of one identity ends: before the next begin.
    count = len(entries)
    following = np.where(begins, np.arange(count)[:, None], count)
    following = np.minimum.accumulate(following[::-1], axis=0)[::-1]
    end = np.vstack([following[1:], np.full((1, ordered.shape[1]), count)]) - 1
    before = np.vstack([np.zeros((1, ordered.shape[1])), sums[:-1]])
    covered = np.where(begins & (ordered != 0), np.take_along_axis(sums, end, 0) - before, 0)
    pictures = []
    for _ in range((levels + 1) // 2):
        picture = np.zeros((ordered.shape[1], 4), np.float32)
        for rank in range(2):
            best = covered.argmax(axis=0)[None]
            share = np.take_along_axis(covered, best, 0)[0]
            identity = np.where(share > LEAST_SHARE, np.take_along_axis(ordered, best, 0)[0], 0).astype(np.uint32)
            picture[:, 2 * rank] = identity.view(np.float32)
            picture[:, 2 * rank + 1] = np.where(share > LEAST_SHARE, share, 0)
            np.put_along_axis(covered, best, 0, 0)
        pictures.append(picture)
    return pictures
