"""Columns of files in the types that hierarchies keep."""

from __future__ import annotations

import numpy as np

STRAY = 1e-3  # share of colours whose low bytes may differ where 16 bits hold 8


def color_bytes(values: np.ndarray) -> tuple[np.ndarray, bool]:
    """Colours (N, C) of a file as (N, 3) uint8, and whether wider fields hold no more than 8 bits.

    Fields of 16 bits often hold 8: as they are, times 256, or times 257.
    """
    values = values[:, :3]
    if values.dtype == np.uint8:
        return np.ascontiguousarray(values), False
    if values.dtype.kind == "f":
        scale = 1.0 if float(np.nanmax(values, initial=0.0)) > 1.0 else 255.0
        return np.clip(np.nan_to_num(values * scale) + 0.5, 0, 255).astype(np.uint8), False
    most = int(values.max(initial=0))
    if most <= 255:
        return np.clip(values, 0, 255).astype(np.uint8), True
    if most > 65535:
        return (values / (np.iinfo(values.dtype).max / 255.0) + 0.5).astype(np.uint8), False
    low, high = values & 255, values >> 8
    if np.count_nonzero((low != 0) & (low != high)) <= STRAY * low.size:
        return high.astype(np.uint8), False
    return (values.astype(np.uint32) * np.uint32(255) + np.uint32(32768) >> np.uint32(16)).astype(np.uint8), False


def attribute_codes(values: np.ndarray, kind: str) -> np.ndarray:
    """A column of a file in the type that hierarchies keep; floats from 0 to 1 fill it, what is beyond is clipped."""
    dtype = np.dtype(kind)
    if dtype.kind == "f":
        return values.astype(dtype)
    most = np.iinfo(dtype).max
    if values.dtype.kind == "f":
        values = np.nan_to_num(values)
        values = values * most if len(values) and values.min() >= 0 and values.max() <= 1 else values
        values = np.round(values)
    return np.clip(values, 0, most).astype(dtype)
