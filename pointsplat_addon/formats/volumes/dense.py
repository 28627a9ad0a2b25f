"""Reads dense arrays of voxels: NumPy's `.npy`, and NIfTI-1's `.nii` and `.nii.gz` as medical scanners write them.

No memory is allocated for what a header claims before that is compared with the bytes in the file.
"""

from __future__ import annotations

import gzip
import os
import struct
import tokenize
import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ...core.numeric.record import record

SUFFIXES = (".npy", ".nii", ".nii.gz")
HEADER = 348  # bytes
MAGIC = b"\x93NUMPY"
LONGEST_HEADER = 10_000  # bytes of NumPy's; it reads no longer ones
DEFLATE = 1032  # the most bytes that one byte of a compressed file stands for (RFC 1951: 258 bytes of 2 bits)
DATATYPES = {2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8"}
METRES = {1: 1.0, 2: 1e-3, 3: 1e-6}  # by NIfTI's code of the unit of length

# The fields of NIfTI-1's header that are read
FIELDS = np.dtype({
    "names": [
        "sizeof_hdr", "dim", "datatype", "pixdim", "vox_offset", "slope", "inter", "units", "qform", "sform",
        "quatern", "qoffset", "srow", "magic",
    ],
    "formats": ["i4", "8i2", "i2", "8f4", "f4", "f4", "f4", "u1", "i2", "i2", "3f4", "3f4", "(3,4)f4", "S4"],
    "offsets": [0, 40, 70, 76, 108, 112, 116, 123, 252, 254, 256, 268, 280, 344],
    "itemsize": HEADER,
})  # fmt: skip


@record
class Dense:
    """Values on a lattice. An integer index is a voxel's centre."""

    value: np.ndarray  # (X, Y, Z) float32
    object_from_index: np.ndarray  # (4, 4) float64; in metres where the file tells its unit


def read(path: Path) -> Dense:
    """The array in a file, of any type of real numbers; of several volumes in one file, the first.

    Raises OSError where the file cannot be read and ValueError where it holds something else.
    """
    name = path.name.lower()
    if name.endswith(".npy"):
        return Dense(_real(_npy(path), path.name), np.eye(4))
    if name.endswith(".nii"):
        with path.open("rb") as file:
            return _nifti(file, _size(file), path.name)
    if name.endswith(".nii.gz"):
        try:
            with path.open("rb") as file, gzip.open(file) as unpacked:
                return _nifti(unpacked, DEFLATE * _size(file), path.name)  # pyright: ignore[reportArgumentType]
        except (EOFError, zlib.error) as error:
            raise OSError(f"{path.name} is damaged: {error}") from error
    raise ValueError(f"{path.name} is none of {', '.join(SUFFIXES)}")


def _size(file: BinaryIO) -> int:
    return os.fstat(file.fileno()).st_size


def _npy(path: Path) -> np.ndarray:
    """The array of NumPy's format, mapped: only what is in the file can be. Raises ValueError for anything else."""
    with path.open("rb") as file:
        start, size = file.read(12), _size(file)
    wide = start[6:7] != b"\x01"
    if len(start) < 12 or not start.startswith(MAGIC):
        raise ValueError(f"{path.name} is no NumPy array")
    length = struct.unpack_from("<I" if wide else "<H", start, 8)[0]
    if length > min(size, LONGEST_HEADER):
        raise ValueError(f"{path.name} ends before its header, or that is too long")
    try:
        with np.errstate(over="ignore"):
            return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))
    # What Python's parser raises for a header that is no dictionary, and NumPy for shapes that are none.
    except (ValueError, TypeError, EOFError, SyntaxError, tokenize.TokenError, ArithmeticError, RecursionError,
            MemoryError) as error:  # fmt: skip
        raise ValueError(f"{path.name} is no array of numbers, or ends before its last one: {error}") from error


def _real(array: np.ndarray, name: str) -> np.ndarray:
    if array.dtype.kind not in "buif":
        raise ValueError(f"{name} holds {array.dtype}, not real numbers")
    if array.ndim != 3 or array.size == 0:
        raise ValueError(f"{name} has the shape {array.shape}, expected three dimensions")
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def _nifti(file: BinaryIO, most: int, name: str) -> Dense:
    """NIfTI-1 (Cox et al. 2004, nifti1.h): a header of 348 bytes in either byte order, then voxels, x fastest.

    `most`: more bytes cannot be in the file.
    """
    data = file.read(HEADER)
    if len(data) < HEADER:
        raise ValueError(f"{name} is too short for NIfTI")
    order = "<" if data[:4] == b"\x5c\x01\0\0" else ">"
    header = np.frombuffer(data, FIELDS.newbyteorder(order), 1)[0]
    if header["sizeof_hdr"] != HEADER or header["magic"] != b"n+1":
        raise ValueError(f"{name} is no NIfTI-1 file with its voxels in it")
    if int(header["datatype"]) not in DATATYPES:
        raise ValueError(f"{name} holds NIfTI's data type {int(header['datatype'])}, not real numbers")
    shape = tuple(int(n) for n in header["dim"][1:4])
    if not 3 <= header["dim"][0] <= 7 or min(shape) < 1:
        raise ValueError(f"{name} has the shape {shape}, expected three dimensions")
    dtype = np.dtype(order + DATATYPES[int(header["datatype"])])
    start, count = float(header["vox_offset"]), int(np.prod(shape, dtype=np.int64))
    if not HEADER <= start <= most or most < start + count * dtype.itemsize:
        raise ValueError(f"{name} ends before its last voxel")
    file.read(int(start) - HEADER)
    data = file.read(count * dtype.itemsize)
    file.read(1)  # where an archive ends here, its checksum is looked at
    if len(data) < count * dtype.itemsize:
        raise ValueError(f"{name} ends before its last voxel")
    value = np.frombuffer(data, dtype, count).reshape(shape, order="F")
    slope, inter = float(header["slope"]), float(header["inter"])
    if slope != 0 and np.isfinite([slope, inter]).all():
        with np.errstate(over="ignore", invalid="ignore"):
            value = value * slope + inter
    matrix = _affine(header)
    matrix[:3] *= METRES.get(int(header["units"]) & 7, 1e-3)
    return Dense(_real(value, name), matrix)


def _affine(header: np.void) -> np.ndarray:
    """(4, 4) float64 from indices to the header's unit: method 3 (sform), else 2 (qform), else 1 (pixdim)."""
    matrix, size = np.eye(4), np.abs(header["pixdim"][1:4].astype(np.float64))
    size[~((size > 0) & np.isfinite(size))] = 1
    if header["sform"] > 0:
        matrix[:3] = header["srow"]
        if np.isfinite(matrix).all() and np.linalg.matrix_rank(matrix) == 4:
            return matrix
        matrix = np.eye(4)
    b, c, d = header["quatern"].astype(np.float64)
    if header["qform"] > 0 and np.isfinite([b, c, d, *header["qoffset"]]).all():
        a = np.sqrt(max(0.0, 1 - b * b - c * c - d * d))
        # The quaternion's matrix is 1 - 2 |v|^2 + 2 v v^T + 2 a [v]x.
        v = np.array([b, c, d])
        cross = np.array([[0, -d, c], [d, 0, -b], [-c, b, 0]])
        matrix[:3, :3] = (1 - 2 * v @ v) * np.eye(3) + 2 * np.outer(v, v) + 2 * a * cross
        size[2] *= -1 if header["pixdim"][0] < 0 else 1
        matrix[:3, 3] = header["qoffset"]
    matrix[:3, :3] *= size
    return matrix


def centred(dense: Dense, longest: float) -> np.ndarray:
    """object_from_index (4, 4) with the lattice's centre at the origin and its longest side `longest` units long."""
    matrix, shape = dense.object_from_index.copy(), np.array(dense.value.shape)
    side = float((np.linalg.norm(matrix[:3, :3], axis=0) * shape).max())
    matrix[:3, :3] *= longest / side
    matrix[:3, 3] = -matrix[:3, :3] @ ((shape - 1) / 2)
    return matrix


def without_background(value: np.ndarray, share: float) -> tuple[np.ndarray, float, float]:
    """The values without their background, and the lowest and the highest finite value.

    Values in the lowest `share` (0 to 1) of the range, and those that are not finite, become the lowest value. Raises
    ValueError if all voxels have the same value: nothing would be left.
    """
    good = np.isfinite(value)
    low, high = (float(f(value, where=good, initial=i)) for f, i in ((np.min, np.inf), (np.max, -np.inf)))
    if not low < high:
        raise ValueError("all voxels have the same value")
    return np.where(good & (value > low + share * (high - low)), value, np.float32(low)), low, high
