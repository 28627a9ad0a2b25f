"""Blender's images as core images, cached by content."""

from __future__ import annotations

import hashlib
import os

import bpy
import numpy as np

from ....core.material.image import Image
from ....render.cache.cache import Cache
from ....render.cache.keys import Key, Kind

CACHE_BYTES = 1 << 30  # texels kept for images that no material holds at the moment
MISSING_COLOR = (1.0, 0.0, 1.0, 1.0)  # what Blender shows for a missing picture
SUPPORTED_ENCODINGS = {"sRGB": True, "Linear Rec.709": False, "scene_linear": False}  # of bytes: sRGB curve or none


_cache = Cache(CACHE_BYTES)  # final renders and viewports read it from their threads


def clear() -> None:
    """Forget every picture, for instance when a file is loaded or the extension is disabled."""
    _cache.clear()


def missing_image() -> Image:
    """One magenta texel."""
    return Image(np.array([[MISSING_COLOR]], np.float32), key="missing", name="missing")


def convert_image(image: bpy.types.Image | None) -> tuple[Image, str | None]:
    """The texels of a picture as Cycles interpolates them, and what is wrong with it, if anything.

    Bytes stay bytes (H, W, 4) uint8 with their encoding; float pictures are scene-linear float32, which is how
    Blender holds them. Colour is multiplied by alpha unless the picture is data or its alpha is a channel of its
    own. A missing file gives one magenta texel.
    """
    if image is None:
        return missing_image(), "has no image"
    width, height = image.size
    if width == 0 or height == 0:
        return missing_image(), f'reads the image "{image.name}", whose file is missing: {image.filepath}'
    problem = _unsupported(image)
    key = content_id(image)
    return _cache.lookup(Key(Kind.IMAGE, key), lambda: _read(image, key)), problem


def _unsupported(image: bpy.types.Image) -> str | None:
    """What is not read as Blender would show it."""
    if image.source == "TILED" and len(image.tiles) > 1:
        return f'reads the image "{image.name}" with UDIM tiles; only tile {image.tiles[0].number} is used'
    if image.source in ("SEQUENCE", "MOVIE"):
        return f'reads the image "{image.name}", a {image.source.lower()}; the frame that Blender holds is used'
    space = image.colorspace_settings
    if not image.is_float and not space.is_data and space.name not in SUPPORTED_ENCODINGS:
        return f'reads the image "{image.name}" in the colour space {space.name}; it is taken for sRGB'
    return None


def content_id(image: bpy.types.Image) -> str:
    """A key that changes with the texels or their meaning.

    Files are told by path, size and time; whatever lives in memory only (painted, generated, sequences) by its
    texels.
    """
    space = image.colorspace_settings
    meaning = f"{space.name} {space.is_data} {image.alpha_mode} {image.is_float} {tuple(image.size)}"
    return hashlib.blake2b(f"{meaning} {_texel_id(image)}".encode(), digest_size=16).hexdigest()


def _texel_id(image: bpy.types.Image) -> str:
    if not image.is_dirty and image.source in ("FILE", "TILED"):
        if image.packed_file is not None:
            return hashlib.blake2b(image.packed_file.data, digest_size=16).hexdigest()
        path = bpy.path.abspath(image.filepath, library=image.library)
        if os.path.exists(path):
            status = os.stat(path)
            return f"{path} {status.st_size} {status.st_mtime_ns}"
    return hashlib.blake2b(_pixels(image).data, digest_size=16).hexdigest()


def _pixels(image: bpy.types.Image) -> np.ndarray:
    """(H * W * channels,) float32 as Blender hands them out: bytes divided by 255, still encoded."""
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels


def _read(image: bpy.types.Image, key: str) -> Image:
    width, height = image.size
    texels = _four_channels(_pixels(image).reshape(height, width, -1))
    if image.alpha_mode == "NONE":
        texels[..., 3] = 1
    data = image.colorspace_settings.is_data
    associated = not data and image.alpha_mode not in ("CHANNEL_PACKED", "NONE")
    if image.is_float:
        return Image(texels, associated=associated, key=key, name=image.name)
    texels *= 255
    texels = np.rint(texels, out=texels).astype(np.uint8)
    if associated and texels[..., 3].min() < 255:
        # Blender holds bytes with straight alpha; Cycles multiplies them while encoded, rounding down
        texels[..., :3] = texels[..., :3].astype(np.uint16) * texels[..., 3:] // 255
    srgb = not data and SUPPORTED_ENCODINGS.get(image.colorspace_settings.name, True)
    return Image(texels, srgb, associated, key, image.name)


def _four_channels(pixels: np.ndarray) -> np.ndarray:
    """(H, W, 1 | 2 | 3 | 4) as RGBA: one and two channels are grey, a missing alpha is 1."""
    height, width, channels = pixels.shape
    if channels == 4:
        return pixels
    out = np.ones((height, width, 4), np.float32)
    out[..., :3] = pixels if channels == 3 else pixels[..., :1]
    if channels == 2:
        out[..., 3] = pixels[..., 1]
    return out
