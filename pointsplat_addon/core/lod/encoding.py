"""Compact codes: octahedral normals, axes as angles about them, logarithmic lengths, colours with a shared exponent.

Normals take 2 x 16 bits (Meyer et al. 2010), axes 16, lengths 16, colours 32 (RGB9E5).
"""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import basis

OCTAVES = 40  # range of lengths below the longest one
STEPS = 65534 / OCTAVES  # code values per octave; 0 is length 0
LENGTH_ERROR = 2.2e-4  # relative: half a step
TILT = 1e-4  # radians by which quantised normals and axes are off at most


def encode_normal(normal: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) to octahedral coordinates (n, 2) uint16; zero vectors to (0, 0)."""
    n = normal.astype(np.float64)
    n /= np.maximum(np.abs(n).sum(axis=1, keepdims=True), 1e-30)
    folded = (1 - np.abs(n[:, 1::-1])) * np.copysign(1.0, n[:, :2])
    square = np.where(n[:, 2:] < 0, folded, n[:, :2])
    code = np.round(np.clip(square * 0.5 + 0.5, 0, 1) * 65535).astype(np.uint16)
    code[~code.any(axis=1)] = 65535  # all corners are -Z
    code[~normal.any(axis=1)] = 0
    return code


def decode_normal(code: np.ndarray) -> np.ndarray:
    """Octahedral coordinates (n, 2) uint16 to unit vectors (n, 3) float32; (0, 0) to zero vectors."""
    x, y = (code.astype(np.float64) * (2 / 65535) - 1).T
    z = 1 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0)
    n = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=1)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    n[~code.any(axis=1)] = 0
    return n.astype(np.float32)


def encode_axis(normal_code: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Axes (n, 3), up to their sign, as (n,) uint16 angles about the decoded normals, from the first vector of
    `basis`."""
    u, v = basis(decode_normal(normal_code).T.astype(np.float64))
    angle = np.arctan2((v * axis.T).sum(axis=0), (u * axis.T).sum(axis=0))
    return (np.round(angle * (65536 / np.pi)).astype(np.int64) & 65535).astype(np.uint16)


def decode_axis(normal_code: np.ndarray, code: np.ndarray) -> np.ndarray:
    """Axes (n, 3) float32, perpendicular to the decoded normals."""
    u, v = basis(decode_normal(normal_code).T.astype(np.float64))
    angle = code.astype(np.float64) * (np.pi / 65536)
    return np.ascontiguousarray((np.cos(angle) * u + np.sin(angle) * v).T, np.float32)


def encode_length(length: np.ndarray, longest: float, up: bool = False) -> np.ndarray:
    """Lengths in [0, longest] as uint16 logarithms, rounded to the nearest or `up`.

    Lengths below the range of OCTAVES become 0, or the shortest length when rounded up.
    """
    with np.errstate(divide="ignore"):
        code = 65535 + STEPS * np.log2(length.astype(np.float64) / longest)
    code = np.ceil(code) if up else np.round(code)
    code = np.where(length > 0, np.clip(code, 1 if up else 0, 65535), 0)
    return code.astype(np.uint16)


def decode_length(code: np.ndarray, longest: float) -> np.ndarray:
    """Lengths, float32, of codes of any shape (see `encode_length`)."""
    length = longest * np.exp2((code.astype(np.float64) - 65535) / STEPS)
    return np.where(code > 0, length * (1 + 1e-7), 0).astype(np.float32)


def encode_rgb(color: np.ndarray) -> np.ndarray:
    """Colours (n, 3) as (n,) uint32 RGB9E5 (GL_UNSIGNED_INT_5_9_9_9_REV), clipped to [0, 65408]."""
    c = np.clip(color.astype(np.float64), 0, 65408)
    exponent = np.maximum(np.frexp(c.max(axis=1))[1], -15)
    # Rounding may carry the largest mantissa to 512.
    exponent += np.round(np.ldexp(c.max(axis=1), 9 - exponent)) >= 512
    mantissa = np.round(np.ldexp(c, (9 - exponent)[:, None])).astype(np.uint32)
    shared = (exponent + 15).astype(np.uint32)
    return mantissa[:, 0] | mantissa[:, 1] << 9 | mantissa[:, 2] << 18 | shared << 27


def decode_rgb(code: np.ndarray) -> np.ndarray:
    """Colours (n, 3) float32 of RGB9E5 codes (n,) uint32."""
    mantissa = np.stack([code & 511, code >> 9 & 511, code >> 18 & 511], axis=1).astype(np.float32)
    return np.ldexp(mantissa, (code >> 27).astype(np.int32)[:, None] - 24)
