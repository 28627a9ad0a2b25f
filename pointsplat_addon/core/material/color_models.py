"""Colour models: sRGB, HSV, HSL and luminance, as Blender and Cycles define them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec. 709, Blender's default scene-linear primaries


def rgb_to_hsv(rgb: np.ndarray) -> np.ndarray:
    """Hue, saturation and value (N, 3) of RGB (N, 3); hue in [0, 1), 0 for grey."""
    high, low = rgb.max(axis=1), rgb.min(axis=1)
    saturation = np.where(high != 0, (high - low) / np.where(high != 0, high, 1), 0)
    return np.stack([_hue(rgb, high, low), saturation, high], axis=1)


def rgb_to_hsl(rgb: np.ndarray) -> np.ndarray:
    """Hue, saturation and lightness (N, 3) of RGB (N, 3); hue in [0, 1), 0 for grey."""
    high, low = rgb.max(axis=1), rgb.min(axis=1)
    lightness = np.minimum(1, (high + low) / 2)
    spread = np.where(lightness > 0.5, 2 - high - low, high + low)
    saturation = np.where(high == low, 0, (high - low) / np.where(spread != 0, spread, 1))
    return np.stack([_hue(rgb, high, low), saturation, lightness], axis=1)


def _hue(rgb: np.ndarray, high: np.ndarray, low: np.ndarray) -> np.ndarray:
    r, g, b = rgb.T
    delta = np.where(high != low, high - low, 1)
    sector = np.where(r == high, (g - b) / delta, np.where(g == high, 2 + (b - r) / delta, 4 + (r - g) / delta))
    return np.where(high != low, (sector / 6) % 1, 0)


def _pure_hue(hue: np.ndarray) -> np.ndarray:
    """The saturated colour of a hue in [0, 1], (N, 3)."""
    h = hue * 6
    return np.clip(np.stack([np.abs(h - 3) - 1, 2 - np.abs(h - 2), 2 - np.abs(h - 4)], axis=1), 0, 1)


def hsv_to_rgb(hsv: np.ndarray) -> np.ndarray:
    """RGB (N, 3) of hue, saturation and value (N, 3); a hue outside [0, 1] stays in the last sextant, as in Cycles."""
    h, s, v = hsv.T
    h = np.where(h == 1, 0, h) * 6
    sextant = np.floor(h)
    p, q, t = v * (1 - s), v * (1 - s * (h - sextant)), v * (1 - s * (1 - (h - sextant)))
    which = np.where((sextant >= 0) & (sextant < 5), np.nan_to_num(sextant), 5).astype(np.intp)
    r, g, b = (np.choose(which, order) for order in ((v, q, p, p, t, v), (t, v, v, q, p, p), (p, p, t, v, v, q)))
    return np.where(s[:, None] != 0, np.stack([r, g, b], axis=1), v[:, None])


def hsl_to_rgb(hsl: np.ndarray) -> np.ndarray:
    """RGB (N, 3) of hue, saturation and lightness (N, 3)."""
    h, s, lightness = hsl[:, 0], hsl[:, 1:2], hsl[:, 2:]
    return (_pure_hue(h) - 0.5) * (1 - np.abs(2 * lightness - 1)) * s + lightness


COLOR_MODELS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "HSV_FROM_RGB": rgb_to_hsv,
    "HSL_FROM_RGB": rgb_to_hsl,
    "RGB_FROM_HSV": hsv_to_rgb,
    "RGB_FROM_HSL": hsl_to_rgb,
}


def linear_from_srgb(encoded: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 decoding; values below 0 stay linear."""
    high = ((np.maximum(encoded, 0) + 0.055) / 1.055) ** 2.4
    return np.where(encoded < 0.04045, encoded / 12.92, high).astype(encoded.dtype)


def srgb_from_linear(linear: np.ndarray) -> np.ndarray:
    """IEC 61966-2-1 encoding; values below 0 stay linear."""
    high = 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055
    return np.where(linear < 0.04045 / 12.92, linear * 12.92, high).astype(linear.dtype)
