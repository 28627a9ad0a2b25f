"""Light from an equirectangular image, prefiltered into an atlas that shaders/lib/light/environment.glsl reads.

The atlas is (H + 2 TILE[1], max(W, 4 TILE[0]), 4) float32, rows from the bottom; the fourth channel is 1, and W in the
first texel:

    rows 0 .. H             the image itself, (H, W): mirror reflection, and the background
    tiles of TILE above it  four to a row: radiance prefiltered for each of ROUGHNESS, the Lambert irradiance / pi, and
                            the mip level of GATHERED texels, of which gathers look at some directions each

Prefiltering assumes n = v = r (Karis 2013, "Real shading in Unreal Engine 4", split sum) and uses filtered
importance sampling (Křivánek and Colbert 2008, equation 11), which is free of noise.
"""

from __future__ import annotations

import numpy as np

from ..numeric.vectors import row_frames

WIDTHS = (512, 1024, 2048)  # of the image that is filtered
WIDEST = 4096  # texels along a side of the image itself, where a camera tells them apart
# Pixels: no narrower are texels. What is interpolated between such is as blurred as by the pixel filter.
NARROWEST = 0.6
TILE = (128, 64)
ROUGHNESS = (0.2, 0.4, 0.6, 0.8, 1.0)
SAMPLES = 64
# Texels around the horizon, of the level that gathers look at in 16 x 16 directions of a hemisphere. Interpolated, it
# is as blurred as these are apart, so that small suns lie between none of them, and less beyond that than a GGX lobe.
GATHERED = 32


def uv_from_direction(direction: np.ndarray) -> np.ndarray:
    """UVs (..., 2) in [0, 1] of directions (..., 3) in image axes: Blender's equirectangular layout, v up."""
    x, y, z = np.moveaxis(direction, -1, 0)
    u = 0.5 - np.arctan2(y, x) / (2 * np.pi)
    v = 0.5 + np.arctan2(z, np.hypot(x, y)) / np.pi
    return np.stack([u, v], -1)


def direction_from_uv(uv: np.ndarray) -> np.ndarray:
    """Unit vectors (..., 3) in image axes of equirectangular UVs (..., 2): the inverse of `uv_from_direction`."""
    azimuth = (0.5 - uv[..., 0]) * (2 * np.pi)
    elevation = (uv[..., 1] - 0.5) * np.pi
    c = np.cos(elevation)
    return np.stack([c * np.cos(azimuth), c * np.sin(azimuth), np.sin(elevation)], -1)


def texel_directions(width: int, height: int) -> np.ndarray:
    """(height, width, 3) unit vectors through the texel centres, row 0 at the bottom."""
    return direction_from_uv(texel_uv(width, height))


def texel_uv(width: int, height: int) -> np.ndarray:
    """(height, width, 2) UVs of the texel centres, row 0 at the bottom."""
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    return np.stack([u, v], -1)


def bilinear(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Bilinear samples (..., C) of an image (H, W, C) at UVs (..., 2); it repeats in u and is clamped in v."""
    h, w = image.shape[:2]
    x, y = uv[..., 0] * w - 0.5, np.clip(uv[..., 1] * h - 0.5, 0, h - 1)
    x0, y0 = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    fx, fy = (x - x0)[..., None].astype(image.dtype), (y - y0)[..., None].astype(image.dtype)
    y1, x1, x0 = np.minimum(y0 + 1, h - 1), (x0 + 1) % w, x0 % w
    low = image[y0, x0] * (1 - fx) + image[y0, x1] * fx
    high = image[y1, x0] * (1 - fx) + image[y1, x1] * fx
    return low * (1 - fy) + high * fy


def widest_image(radians: float) -> int:
    """How many texels an atlas' image may have along a side, so that those of a camera, some `radians` wide, miss none
    of them."""
    return WIDEST if 2 * np.pi >= NARROWEST * WIDEST * radians else WIDTHS[-1]


def build_atlas(image: np.ndarray, mirrored: np.ndarray | None = None, widest: int = WIDTHS[-1]) -> np.ndarray:
    """Builds the atlas of an equirectangular radiance image (H, W, 3 or more).

    mirrored: another one, of which all is but the irradiance. widest: texels along a side of the image itself; larger
    ones are averaged.

    NaN and negative infinity count as 0; other values are clamped to +-1e18, about the root of float32's limit, so that
    sums stay finite.
    """
    sharp = _finite(image if mirrored is None else mirrored)
    mips = _levels_of(sharp)
    (height, width), most = sharp.shape[:2], max(sharp.shape[:2])
    if most > widest:
        sharp = _resample(sharp, *(max(1, round(side * widest / most)) for side in (width, height)))
        height, width = sharp.shape[:2]

    tiles = [_resample(_prefilter(mips, roughness), *TILE) for roughness in ROUGHNESS]
    lights = mips if mirrored is None else _levels_of(_finite(image))
    tiles += [_resample(_irradiance(lights), *TILE), _resample(lights[-1], *TILE)]

    atlas = np.ones((height + 2 * TILE[1], max(width, 4 * TILE[0]), 4), np.float32)
    atlas[:height, :width, :3] = sharp
    atlas[0, 0, 3] = width
    for i, tile in enumerate(tiles):
        x, y = i % 4 * TILE[0], height + i // 4 * TILE[1]
        atlas[y : y + TILE[1], x : x + TILE[0], :3] = tile
    return atlas


def _finite(image: np.ndarray) -> np.ndarray:
    """An image (H, W, 3) float32 without what is not finite."""
    image = np.nan_to_num(np.asarray(image[..., :3], np.float32), nan=0.0, posinf=1e18, neginf=0.0)
    return np.clip(image, -1e18, 1e18, out=image)


def _levels_of(image: np.ndarray) -> list[np.ndarray]:
    """The mip levels of a finite image (H, W, 3), from one of WIDTHS on."""
    width = next((w for w in WIDTHS if w >= image.shape[1]), WIDTHS[-1])
    return _mips(_resample(image, width, width // 2))


def atlas_level(atlas: np.ndarray, index: int) -> np.ndarray:
    """View (h, w, 3) of a level: 0 the image, 1 .. len(ROUGHNESS) prefiltered, the next ones the irradiance / pi and
    the one of GATHERED."""
    height = len(atlas) - 2 * TILE[1]
    if index == 0:
        return atlas[:height, : int(atlas[0, 0, 3]), :3]
    x, y = (index - 1) % 4 * TILE[0], height + (index - 1) // 4 * TILE[1]
    return atlas[y : y + TILE[1], x : x + TILE[0], :3]


def pyramid(atlas: np.ndarray) -> list[np.ndarray]:
    """An atlas' image, and levels each half as wide as that before, from half of one of WIDTHS down to 32, (h, w, 3)
    each; all of these keep the sphere's total light."""
    image = atlas_level(atlas, 0)
    return [image, *_levels_of(image)[1:]]


def stack_levels(levels: list[np.ndarray]) -> np.ndarray:
    """Stacks all levels of a pyramid but the first in one image (H, W, 3) float32, left-aligned, the widest first."""
    width = levels[1].shape[1]
    return np.concatenate([np.pad(part, ((0, 0), (0, width - part.shape[1]), (0, 0))) for part in levels[1:]])


def _resample(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resizes an image: bilinear where it grows, the exact area average where it shrinks."""
    h, w = image.shape[:2]
    if width >= w and height >= h:
        if (width, height) == (w, h):
            return image
        return bilinear(image, texel_uv(width, height))
    return _box(_box(image, height).swapaxes(0, 1), width).swapaxes(0, 1)


def _box(image: np.ndarray, count: int) -> np.ndarray:
    """Mean over `count` equal intervals of the first axis, by differences of its running sum."""
    total = np.concatenate([np.zeros_like(image[:1], np.float64), np.cumsum(image, 0, dtype=np.float64)])
    edge = np.linspace(0, len(image), count + 1)
    below = np.minimum(edge.astype(np.int64), len(image) - 1)
    part = (edge - below).reshape(-1, *[1] * (image.ndim - 1))
    at_edge = total[below] * (1 - part) + total[below + 1] * part
    return (np.diff(at_edge, axis=0) * (count / len(image))).astype(np.float32)


def _mips(image: np.ndarray) -> list[np.ndarray]:
    """Mip levels of an image down to a width of GATHERED; rows weigh with their solid angle, which keeps all light."""
    levels = [image]
    while levels[-1].shape[1] > GATHERED:
        last = levels[-1]
        h = len(last)
        weight = np.cos((np.arange(h) + 0.5) / h * np.pi - np.pi / 2).astype(np.float32)[:, None, None]
        pairs = (last * weight).reshape(h // 2, 2, -1, 2, 3).sum((1, 3))
        levels.append(pairs / (2 * weight.reshape(h // 2, 2, 1, 1).sum(1)))
    return levels


def _prefilter(mips: list[np.ndarray], roughness: float) -> np.ndarray:
    """(h, w, 3) radiance averaged over the GGX lobe about each texel's direction, weighted with n.l."""
    size = TILE if roughness < 0.5 else (TILE[0] // 2, TILE[1] // 2)
    normal = texel_directions(*size)
    tangent, bitangent = row_frames(normal)
    alpha2 = roughness**4
    texel = 2 * np.pi**2 / mips[0].shape[1] / mips[0].shape[0]

    # Half vectors from the density D(h) n.h, on a golden-angle spiral.
    u = (np.arange(SAMPLES) + 0.5) / SAMPLES
    cos_h = np.sqrt((1 - u) / (1 + (alpha2 - 1) * u))
    density = alpha2 / (np.pi * ((alpha2 - 1) * cos_h**2 + 1) ** 2) / 4
    cos_l = 2 * cos_h**2 - 1
    phi = np.arange(SAMPLES) * (np.pi * (3 - np.sqrt(5)))
    lod = np.clip(0.5 * np.log2(1 / (SAMPLES * density * texel)) + 0.5, 0, len(mips) - 1.001)

    total, weight = np.zeros((*normal.shape[:2], 3)), 0.0
    for i in np.flatnonzero(cos_l > 0):
        sin_l = np.sqrt(1 - cos_l[i] ** 2)
        direction = cos_l[i] * normal + sin_l * (np.cos(phi[i]) * tangent + np.sin(phi[i]) * bitangent)
        uv, k = uv_from_direction(direction), int(lod[i])
        t = lod[i] - k
        total += cos_l[i] * ((1 - t) * bilinear(mips[k], uv) + t * bilinear(mips[k + 1], uv))
        weight += cos_l[i]
    return (total / weight).astype(np.float32)


def _irradiance(mips: list[np.ndarray]) -> np.ndarray:
    """(32, 64, 3) Lambert irradiance / pi: the whole sphere summed for each normal."""
    source = next(m for m in mips if m.shape[1] <= 64)
    h, w = source.shape[:2]
    direction = texel_directions(w, h).reshape(-1, 3)
    solid_angle = np.cos((np.arange(h) + 0.5) / h * np.pi - np.pi / 2).repeat(w)
    normal = texel_directions(64, 32).reshape(-1, 3)
    weight = np.maximum(normal @ direction.T, 0) * solid_angle
    # Normalised by the discrete sum, so that a constant image stays constant.
    weight /= weight.sum(1, keepdims=True)
    return (weight @ source.reshape(-1, 3).astype(np.float64)).reshape(32, 64, 3).astype(np.float32)
