"""Blender's arrays as numpy arrays, and content keys for them."""

from __future__ import annotations

import ctypes
import hashlib
from typing import Any

import numpy as np

from ...core.material.color_models import linear_from_srgb

CTYPES = {np.float32: ctypes.c_float, np.int32: ctypes.c_int32, np.uint8: ctypes.c_uint8}


def view(collection: Any, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Blender's own memory behind a collection whose items lie side by side: (shape) array, no copy.

    Valid until the dependency graph changes. An empty collection gives an empty array.
    """
    if len(collection) == 0:
        return np.zeros((0, *shape[1:]), dtype)
    pointer = ctypes.cast(collection[0].as_pointer(), ctypes.POINTER(CTYPES[dtype]))
    return np.ctypeslib.as_array(pointer, shape)


def read(collection: Any, name: str, width: int, dtype: type) -> np.ndarray:
    """Property `name` of all items: (N, width) array, or (N,) where width is 1."""
    array = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, array)
    return array.reshape(-1, width) if width > 1 else array


def digest(*parts: object) -> str:
    """Content key of arrays and of anything with a faithful repr; the same in every process.

    SHA-1, because processors compute it in hardware: 2 GB/s against 0.9 for BLAKE2b.
    """
    state = hashlib.sha1(usedforsecurity=False)
    for part in parts:
        if isinstance(part, np.ndarray):
            state.update(f"{part.dtype.str}{part.shape}".encode())
            state.update(np.ascontiguousarray(part).data.cast("B") if part.size else b"")
        else:
            state.update(repr(part).encode())
    return state.hexdigest()


def colors(attribute: Any) -> np.ndarray:
    """A FLOAT_COLOR or BYTE_COLOR attribute as stored: (N, 4) float32 scene-linear, or (N, 4) uint8 sRGB."""
    if attribute.data_type == "BYTE_COLOR":
        return view(attribute.data, (len(attribute.data), 4), np.uint8)
    return read(attribute.data, "color", 4, np.float32)


def scene_linear(stored: np.ndarray) -> np.ndarray:
    """Stored colours (N, 4) as float32 scene-linear; the alpha of 8-bit colours is linear already."""
    if stored.dtype != np.uint8:
        return stored
    codes = np.arange(256, dtype=np.float32) / np.float32(255)
    result = linear_from_srgb(codes).astype(np.float32)[stored]
    result[..., 3] = stored[..., 3] / np.float32(255)
    return result
