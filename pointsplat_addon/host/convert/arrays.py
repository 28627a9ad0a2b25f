"""Arrays and attributes of Blender as numpy arrays, and content keys of arrays."""

from __future__ import annotations

import ctypes
import hashlib
import math
from typing import Any

import numpy as np

from ...core.material.color_models import linear_from_srgb
from ...core.numeric.vectors import each_block

PIECE = 1 << 22  # bytes of an array that are digested at once


def view(collection: Any, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Blender's own memory of a collection whose items are contiguous, as an array of this shape; no copy.

    Valid until the dependency graph changes. An empty collection gives an empty array.
    """
    if len(collection) == 0:
        return np.zeros((0, *shape[1:]), dtype)
    count = math.prod(shape)
    # Several times as fast as by a pointer, which files of many small objects tell.
    memory: Any = (ctypes.c_char * (count * np.dtype(dtype).itemsize)).from_address(collection[0].as_pointer())
    return np.frombuffer(memory, dtype, count).reshape(shape)


def read(collection: Any, name: str, width: int, dtype: type) -> np.ndarray:
    """A property of all items of a collection: (N, width) array, or (N,) for a width of 1."""
    array = np.empty(len(collection) * width, dtype)
    collection.foreach_get(name, array)
    return array.reshape(-1, width) if width > 1 else array


def values(attribute: Any, width: int, dtype: type) -> np.ndarray:
    """The values of an attribute, (N, width), or (N,) for a width of 1; no copy, see `view`.

    Where one value stands for all, as since Blender 5.0, access to the first makes Blender write them out.
    """
    data = attribute.data
    return view(data, (len(data), width) if width > 1 else (len(data),), dtype)


def digest(*parts: object) -> str:
    """Content key of arrays and of objects whose repr tells their value; equal in every process.

    SHA-1, because processors compute it in hardware: 2 GB/s against 0.9 for BLAKE2b. Of large arrays it is that of
    pieces, which several threads compute.
    """
    state = hashlib.sha1(usedforsecurity=False)
    for part in parts:
        if isinstance(part, np.ndarray):
            state.update(f"{part.dtype.str}{part.shape}".encode())
            _add_content(state, np.ascontiguousarray(part).data.cast("B") if part.size else memoryview(b""))
        else:
            state.update(repr(part).encode())
    return state.hexdigest()


def _add_content(state: Any, content: memoryview) -> None:
    if len(content) <= PIECE:
        state.update(content)
        return
    found: dict[int, bytes] = {}

    def add(piece: slice) -> None:
        found[piece.start] = hashlib.sha1(content[piece], usedforsecurity=False).digest()

    each_block(len(content), add, PIECE)
    for start in sorted(found):
        state.update(found[start])


def stored_colors(attribute: Any) -> np.ndarray:
    """A colour attribute as stored: FLOAT_COLOR (N, 4) float32 scene-linear, BYTE_COLOR (N, 4) uint8 sRGB.

    No copy, see `view`.
    """
    return values(attribute, 4, np.uint8 if attribute.data_type == "BYTE_COLOR" else np.float32)


def scene_linear(stored: np.ndarray) -> np.ndarray:
    """Stored colours (N, 4) as scene-linear float32; the alpha of 8-bit colours is linear already."""
    if stored.dtype != np.uint8:
        return stored
    codes = np.arange(256, dtype=np.float32) / np.float32(255)
    result = linear_from_srgb(codes).astype(np.float32)[stored]
    result[..., 3] = stored[..., 3] / np.float32(255)
    return result


COLOR_TYPES = ("FLOAT_COLOR", "BYTE_COLOR")
NUMBER_TYPES: dict[str, type] = {"FLOAT": np.float32, "INT": np.int32, "INT8": np.int8, "BOOLEAN": np.bool_}
READABLE_TYPES = (*COLOR_TYPES, *NUMBER_TYPES, "FLOAT_VECTOR")  # what an Attribute node reads


def attribute_as_color(attribute: Any) -> np.ndarray:
    """An attribute as the Color output of an Attribute node: (N, 4), colours as stored.

    A number fills all three channels, a vector is taken as it is.
    """
    if attribute.data_type in COLOR_TYPES:
        return stored_colors(attribute)
    if attribute.data_type in NUMBER_TYPES:
        number = values(attribute, 1, NUMBER_TYPES[attribute.data_type]).astype(np.float32)
        value = np.repeat(number[:, None], 3, axis=1)
    else:
        value = values(attribute, 3, np.float32)
    return np.concatenate([value, np.ones((len(value), 1), np.float32)], axis=1)


def unit_or_up(vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) normalised, float32; a zero vector becomes +Z."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 0, vectors / np.where(length > 0, length, 1), [0, 0, 1]).astype(np.float32)
