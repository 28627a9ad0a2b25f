"""Cryptomatte identifiers (Friedman and Jones 2015, specification 1.2)."""

from __future__ import annotations

MASK = 0xFFFFFFFF


def _rotate_left(x: int, bits: int) -> int:
    return ((x << bits) | (x >> (32 - bits))) & MASK


def _scramble(k: int) -> int:
    return _rotate_left(k * 0xCC9E2D51 & MASK, 15) * 0x1B873593 & MASK


def murmur3(data: bytes, seed: int = 0) -> int:
    """MurmurHash3_x86_32 (Appleby 2011) of a short byte string, an unsigned 32-bit integer."""
    h, whole = seed, len(data) // 4 * 4
    for i in range(0, whole, 4):
        h ^= _scramble(int.from_bytes(data[i : i + 4], "little"))
        h = (_rotate_left(h, 13) * 5 + 0xE6546B64) & MASK
    h ^= _scramble(int.from_bytes(data[whole:], "little")) ^ len(data)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35)):
        h = ((h ^ (h >> shift)) * factor) & MASK
    return h ^ (h >> 16)


def cryptomatte_hash(name: str) -> int:
    """The identifier of a name as uint32: the bits of a float that is neither denormal, infinite nor NaN."""
    h = murmur3(name.encode("utf-8"))
    exponent = h >> 23 & 255
    return h ^ 1 << 23 if exponent in (0, 255) else h
