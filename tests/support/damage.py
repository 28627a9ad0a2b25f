"""Damage to files, for tests of what reads them."""

from __future__ import annotations

import numpy as np

KINDS = 4


def damaged(data: bytes, kind: int, random: np.random.Generator) -> bytes:
    """A file that was cut off (`kind` 0), has other bits (1), other numbers in its header (2), or bytes put into it
    (3)."""
    found = bytearray(data)
    if kind == 0:
        return bytes(found[: random.integers(len(found) + 1)])
    if kind == 1:
        for at in random.integers(len(found), size=random.integers(1, 9)):
            found[at] ^= 1 << int(random.integers(8))
    elif kind == 2:
        at = int(random.integers(min(len(found), 400)))
        found[at : at + 4] = random.choice([b"\xff\xff\xff\xff", b"\0\0\0\0", b"\x7f\xff\xff\xff", b"9999"])
    else:
        at = int(random.integers(len(found)))
        found[at:at] = bytes(random.integers(256, size=random.integers(1, 50), dtype=np.uint8))
    return bytes(found)
