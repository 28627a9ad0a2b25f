"""Hashes of integers and floats as pseudo-random numbers, the ones that Blender's textures are made of.

Words are uint32 arrays that broadcast against each other; all arithmetic is modulo 2^32.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

SEED = 0xDEADBEEF  # Jenkins' arbitrary initial value
Words = Sequence[np.ndarray | np.uint32]


def _rotated(x: np.ndarray, bits: int) -> np.ndarray:
    """Words rotated to the left."""
    out = np.left_shift(x, np.uint32(bits))
    out |= np.right_shift(x, np.uint32(32 - bits))
    return out


def _mix(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Jenkins' reversible mixing of three words (lookup3, 2006)."""
    for bits in (4, 6, 8, 16, 19, 4):
        # Each round mixes the third word into the first and the second into the third, then their roles move on
        a, c = (a - c) ^ _rotated(c, bits), c + b
        a, b, c = b, c, a
    return a, b, c


def _final(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """The last word of Jenkins' final mixing (lookup3, 2006)."""
    for bits in (14, 11, 25, 16, 4, 14, 24):
        # c takes in b, then a takes in c, then b takes in a: the roles move on
        c = c ^ b
        c -= _rotated(b, bits)
        a, b, c = b, c, a
    return b


def lookup3(words: Words) -> np.ndarray:
    """Jenkins' lookup3 of one to four words as uint32, of the shape to which they broadcast.

    It costs least where the first word has the fewest values in common: what depends on the others alone is shared.
    """
    start = np.uint32((SEED + (len(words) << 2) + 13) & 0xFFFFFFFF)
    a, b, c = (
        np.add(w, start, dtype=np.uint32) for w in (*words[:3], *(np.zeros(1, np.uint32),) * (3 - len(words[:3])))
    )
    if len(words) == 4:
        a, b, c = _mix(a, b, c)
        a = a + words[3]
    return _final(a, b, c)


def unit_float(words: np.ndarray) -> np.ndarray:
    """Words as float32 in [0, 1]."""
    return words.astype(np.float32) / np.float32(0xFFFFFFFF)


def name_number(name: str) -> float:
    """The pseudo-random number in [0, 1] that Cycles gives to an object of this name, if no instancer made it."""
    word = 0
    for byte in name.encode():
        word = (37 * word + byte) % 2**32
    return float(unit_float(lookup3([np.array([word], np.uint32), np.zeros(1, np.uint32)]))[0])


def point_numbers(count: int) -> np.ndarray:
    """The pseudo-random numbers (N,) float32 in [0, 1] that Cycles gives to the points of an object, by their index."""
    return unit_float(lookup3([np.arange(count, dtype=np.uint32), np.zeros(1, np.uint32)]))


def float_words(*values: np.ndarray | float) -> list[np.ndarray]:
    """The bits of float32 values, of -0 those of 0."""
    return [(np.asarray(v, np.float32) + np.float32(0)).view(np.uint32) for v in values]


def hash_floats(*values: np.ndarray | float) -> np.ndarray:
    """A pseudo-random float32 in [0, 1] for one to four float32 values, by their bits."""
    return unit_float(lookup3(float_words(*values)))
