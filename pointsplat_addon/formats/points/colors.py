"""How files code colours: fields of 16 bits often hold 8, as they are, times 256, or times 257."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...core.material.color_models import linear_from_srgb

STRAY = (
    1e-3  # share of colours that may have other low bytes where fields of 16 bits hold 8: marks of what has no colour
)


class Coding(NamedTuple):
    """What the numbers of colours stand for."""

    shift: int = 0  # bits below the 8 that they hold; only where `scale` is 0
    scale: float = 0.0  # the number that is 1; 0: there are 8 bits


def coding_of(values: np.ndarray) -> Coding:
    """Returns the coding of colours (N, C) of any type of numbers, as many of them tell."""
    if values.dtype == np.uint8:
        return Coding()
    if values.dtype.kind not in "iu":
        return Coding(scale=255.0 if float(np.nanmax(values, initial=0.0)) > 1.0 else 1.0)
    most = int(values.max(initial=0))
    if most <= 255:
        return Coding()
    low = (values & 255).astype(np.uint8)
    high = (values >> 8).astype(np.uint8)
    if np.count_nonzero((low != 0) & (low != high)) <= STRAY * low.size:
        return Coding(shift=8)
    return Coding(scale=65535.0 if most <= 65535 else float(np.iinfo(values.dtype).max))


def coded(values: np.ndarray, coding: Coding) -> np.ndarray:
    """Returns colours (N, 4), opaque where they have no alpha: uint8 where 8 bits hold all of them, else float32 from 0
    to 1; sRGB, as files have them."""
    given = values.shape[1]
    if coding.scale == 0:
        rgba = np.full((len(values), 4), 255, np.uint8)
        if values.dtype == np.uint8:
            rgba[:, :given] = values
        elif coding.shift:
            rgba[:, :given] = (values >> coding.shift).astype(np.uint8)
        else:
            rgba[:, :given] = np.clip(values, 0, 255)
        return rgba
    found = np.ones((len(values), 4), np.float32)
    found[:, :given] = np.nan_to_num(values * np.float32(1 / coding.scale))
    return found


def scene_linear(values: np.ndarray, coding: Coding) -> np.ndarray:
    """Returns colours (N, C) of a file as (N, 3) float32, scene-linear."""
    found = coded(values[:, :3], coding)[:, :3]
    if found.dtype == np.uint8:
        codes = np.arange(256, dtype=np.float32) / np.float32(255)
        return linear_from_srgb(codes).astype(np.float32)[found]
    return linear_from_srgb(found).astype(np.float32)
