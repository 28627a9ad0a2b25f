"""Whether an image file is whole: Blender takes for saved what a full disk has cut off."""

import struct
from pathlib import Path

PNG, EXR = b"\x89PNG\r\n\x1a\n", b"\x76\x2f\x31\x01"
PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"
LINES = 1, 1, 1, 16, 32, 16, 32, 32, 32, 256  # of a chunk, by an EXR file's compression
MULTIPART, TILED = 0x1000, 0x200


def is_whole(path: Path) -> bool:
    """Whether a PNG has its end, and an EXR of scan lines all the chunks that its table promises.

    Other files are not whole."""
    data = path.read_bytes()
    if data.startswith(PNG):
        return data.endswith(PNG_END)
    try:
        return data.startswith(EXR) and _has_all_chunks(data)
    except (struct.error, ValueError, KeyError, IndexError):
        return False


def _has_all_chunks(data: bytes) -> bool:
    if struct.unpack_from("<I", data, 4)[0] & (MULTIPART | TILED):
        return False
    attributes, at = {}, 8
    while data[at]:
        name_end = data.index(b"\0", at)
        kind_end = data.index(b"\0", name_end + 1)
        size = struct.unpack_from("<i", data, kind_end + 1)[0]
        attributes[data[at:name_end]] = data[kind_end + 5 : kind_end + 5 + size]
        at = kind_end + 5 + size
    _, low, _, high = struct.unpack("<4i", attributes[b"dataWindow"])
    count = -(-(high - low + 1) // LINES[attributes[b"compression"][0]])
    offsets = struct.unpack_from(f"<{count}Q", data, at + 1)
    ends = [offset + 8 + struct.unpack_from("<i", data, offset + 4)[0] for offset in offsets]
    return min(offsets) > at and max(ends) <= len(data)
