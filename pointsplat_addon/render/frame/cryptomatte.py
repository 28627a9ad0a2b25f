"""Computes Cryptomatte: the ranked coverage of identities among samples."""

from __future__ import annotations

import numpy as np


def cryptomatte(hashes: np.ndarray, levels: int) -> list[np.ndarray]:
    """Ranks the identities of each pixel by coverage (Cryptomatte specification 1.2).

    `hashes`: (S, H, W) uint32 identities of S samples; 0: none. Returns ceil(levels / 2) pictures (H, W, 4) float32
    with identity and coverage of two ranks each; the bits of an identity are stored as a float.
    """
    samples, height, width = hashes.shape
    pairs = (levels + 1) // 2
    ordered = np.sort(hashes.reshape(samples, -1), axis=0)
    begins = np.ones(ordered.shape, bool)
    begins[1:] = ordered[1:] != ordered[:-1]
    # Length of the run that starts at each row: distance to the next begin.
    row = np.arange(samples)[:, None]
    following = np.where(begins, row, samples)
    following = np.minimum.accumulate(following[::-1], axis=0)[::-1]
    end = np.vstack([following[1:], np.full((1, ordered.shape[1]), samples)])
    length = np.where(begins & (ordered != 0), end - row, 0)
    pictures = []
    for _ in range(pairs):
        picture = np.zeros((ordered.shape[1], 4), np.float32)
        for rank in range(2):
            best = length.argmax(axis=0)[None]
            count = np.take_along_axis(length, best, 0)[0]
            identity = np.where(count > 0, np.take_along_axis(ordered, best, 0)[0], 0).astype(np.uint32)
            picture[:, 2 * rank] = identity.view(np.float32)
            picture[:, 2 * rank + 1] = count / samples
            np.put_along_axis(length, best, 0, 0)
        pictures.append(picture.reshape(height, width, 4))
    return pictures
