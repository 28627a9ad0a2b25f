"""Files of a cache that hold one item each: a frozen record of arrays, numbers and names, or a dictionary of such.

A file holds, little-endian: magic (8 bytes), version (uint32), length of the header (uint32), checksum of all that
follows (32 bytes), the header (JSON: the item, with numbers of arrays in it, and of each array its dtype and shape),
then the arrays; header and arrays are padded to ALIGNMENT. Nothing is allocated before the claimed sizes agree with the
file's. What is read is what was written, to the bit and to the type.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import struct
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.numeric.vectors import each_block
from .whole_file import write_whole

MAGIC = b"PSITEM\r\n"
VERSION = 1
SUFFIX = ".psitem"
FIXED = struct.Struct("<8sII32s")
HEADER_LIMIT = 1 << 24  # bytes
DTYPES = {np.dtype(name).str for name in ("u1", "bool", "f2", "i4", "u4", "f4", "i8", "f8")}
MOST_AXES = 4  # of an array
ALIGNMENT = 16  # bytes, of which FIXED has three times as many: arrays are views of the file's bytes
PIECE = 1 << 22  # bytes that are hashed at once
ARRAY, SCALAR, TUPLE, RECORD, NAMED = "array", "scalar", "tuple", "record", "named"  # first item of the header's lists


class RecordError(ValueError):
    """A file that cannot be used; the message names it and says what is wrong with it."""


def write(path: Path, item: Any) -> None:
    """Writes an item. TypeError: it holds something else than records, tuples, dictionaries, arrays, numbers and names.
    OSError: the file cannot be written; there is none then."""
    arrays: list[np.ndarray] = []
    tree = _flat(item, arrays)
    header = json.dumps({"item": tree, "arrays": [[a.dtype.str, list(a.shape)] for a in arrays]}).encode()
    header += b" " * _padding(len(header))
    body = []
    for array in arrays:
        body += [array.reshape(-1).view(np.uint8).data, memoryview(bytes(_padding(array.nbytes)))]
    checksum = _checksum(memoryview(header), body)
    write_whole(path, (FIXED.pack(MAGIC, VERSION, len(header), checksum), header, *body))


def read(path: Path, classes: Mapping[str, type]) -> Any:
    """The item in a file; returns None if there is none. classes: of records that it may hold, by name.

    Raises RecordError for a file that is damaged or of another kind, OSError where reading fails.
    """
    try:
        size = path.stat().st_size
        content = np.fromfile(path, np.uint8)
    except FileNotFoundError:
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # it was used: `trim` deletes what was not, also where the system keeps no times of reading
    try:
        if len(content) != size:
            raise ValueError("truncated")
        return _parse(content, classes)
    except (ValueError, KeyError, TypeError, IndexError, OverflowError, RecursionError) as error:
        raise RecordError(f"{path}: {error}") from error


def nbytes(item: Any) -> int:
    """Bytes of the arrays of an item that can be written."""
    arrays: list[np.ndarray] = []
    _flat(item, arrays)
    return sum(array.nbytes for array in arrays)


def _flat(item: Any, arrays: list[np.ndarray]) -> Any:
    """What stands for an item in the header; its arrays are added to a list."""
    if item is None or type(item) in (bool, int, float, str):
        return item
    if isinstance(item, np.ndarray | np.generic):
        if item.dtype.str not in DTYPES or item.ndim > MOST_AXES:
            raise TypeError(f"an array of {item.ndim} axes of {item.dtype} is not kept in files")
        arrays.append(np.asarray(item, order="C"))
        return [SCALAR if isinstance(item, np.generic) else ARRAY, len(arrays) - 1]
    if isinstance(item, tuple):
        return [TUPLE, *(_flat(part, arrays) for part in item)]
    if isinstance(item, dict):
        return [NAMED, {name: _flat(part, arrays) for name, part in item.items()}]
    if is_dataclass(item) and not isinstance(item, type):
        parts = {f.name: _flat(getattr(item, f.name), arrays) for f in fields(item)}
        return [RECORD, type(item).__name__, parts]
    raise TypeError(f"{type(item).__name__} is not kept in files")


def _parse(content: np.ndarray, classes: Mapping[str, type]) -> Any:
    """The item in a file's bytes. Raises errors of many kinds for anything that `write` would not have written."""
    if len(content) < FIXED.size:
        raise ValueError("truncated")
    magic, version, length, checksum = FIXED.unpack_from(content.data)
    if magic != MAGIC:
        raise ValueError("not a file of this cache")
    if version != VERSION:
        raise ValueError(f"version {version}, expected {VERSION}")
    body = content[FIXED.size :]
    if length > min(HEADER_LIMIT, len(body)):
        raise ValueError("truncated")
    if _checksum(body[:length].data, [body[length:].data]) != checksum:
        raise ValueError("damaged: its checksum differs")
    header = json.loads(bytes(body[:length]))
    arrays, start = [], length
    for name, shape in header["arrays"]:
        if name not in DTYPES or len(shape) > MOST_AXES or not all(type(n) is int and n >= 0 for n in shape):
            raise ValueError(f"impossible array of {name!r} {shape}")
        size = math.prod(shape) * np.dtype(name).itemsize
        if start + size > len(body):
            raise ValueError("truncated")
        arrays.append(body[start : start + size].view(name).reshape(shape))
        start += size + _padding(size)
    if start != len(body):
        raise ValueError(f"{len(body) - start} bytes too many")
    return _item(header["item"], arrays, classes)


def _item(tree: Any, arrays: list[np.ndarray], classes: Mapping[str, type]) -> Any:
    if not isinstance(tree, list):
        return tree
    kind, *rest = tree
    if kind == ARRAY:
        return arrays[rest[0]]
    if kind == SCALAR:
        return arrays[rest[0]][()]
    if kind == TUPLE:
        return tuple(_item(part, arrays, classes) for part in rest)
    if kind == NAMED:
        return {name: _item(part, arrays, classes) for name, part in rest[0].items()}
    if kind == RECORD:
        made = classes[rest[0]]
        return made(**{name: _item(part, arrays, classes) for name, part in rest[1].items()})
    raise ValueError(f"impossible item {kind!r}")


def _padding(size: int) -> int:
    return -size % ALIGNMENT


def _checksum(header: memoryview, arrays: list[memoryview]) -> bytes:
    """Of the header, and of pieces of all that follows it, which several threads compute. How that is divided into
    parts does not matter."""
    ends = np.cumsum([0, *map(len, arrays)]).tolist()
    found: dict[int, bytes] = {}

    def add(piece: slice) -> None:
        state = hashlib.sha1(usedforsecurity=False)  # computed by processors' own instructions
        for start, part in zip(ends, arrays, strict=False):
            if start < piece.stop and start + len(part) > piece.start:
                state.update(part[max(piece.start - start, 0) : piece.stop - start])
        found[piece.start] = state.digest()

    each_block(ends[-1], add, PIECE)
    whole = hashlib.blake2b(header, digest_size=32)
    for start in sorted(found):
        whole.update(found[start])
    return whole.digest()
