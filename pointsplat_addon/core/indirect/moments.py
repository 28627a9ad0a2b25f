"""Moments of the light that arrives at a place from all sides, from which surfaces there take theirs, however they are
turned (Ramamoorthi and Hanrahan 2001).

A row holds 24 numbers, integrals over all directions (x, y, z):
  0 to 11: of radiance, three channels, times 1, x, y and z;
  12 to 16: of its mean over the channels times xy, yz, 3 z^2 - 1, xz and x^2 - y^2;
  17 to 19: of radiance of surfaces, without the sky's;
  20 to 23: of the share of the sky that is open, times 1, x, y and z.
"""

from __future__ import annotations

import numpy as np

MOMENTS = 24
# Squared norms of the real spherical harmonics whose polynomials these are.
ZEROTH, FIRST = 1 / (4 * np.pi), 3 / (4 * np.pi)
SECOND = np.array([15, 15, 1.25, 15, 3.75]) / (4 * np.pi)
COSINE = 1.0, 2 / 3, 1 / 4  # of each order, over pi: what the cosine lobe keeps


def irradiance(moments: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Returns irradiance over pi, (N, 3), of surfaces with unit normals (N, 3) where the moments are (N, 24)."""
    mean = COSINE[0] * ZEROTH * moments[:, :3]
    for axis in range(3):
        mean = mean + COSINE[1] * FIRST * normal[:, axis, None] * moments[:, 3 + 3 * axis : 6 + 3 * axis]
    second = COSINE[2] * (SECOND * _second(normal) * moments[:, 12:17]).sum(axis=1)
    return np.maximum(mean + second[:, None] * _tint(moments[:, :3]), 0.0)


def irradiance_of_relief(
    moments: np.ndarray, normal: np.ndarray, plane: np.ndarray, returned: np.ndarray
) -> np.ndarray:
    """Returns irradiance over pi, (N, 3), of surfaces with unit normals (N, 3) in relief on planes with unit normals
    (N, 3), as that of balls which lie over each other, where moments before it are (N, 24).

    `returned` (N, 3): irradiance over pi of the planes' backs there, of what the relief itself sends. The sum of area
    times normal of a relief is that of its plane: by vector irradiance of what comes from before the plane it receives
    on average what falls on the plane, whatever hides what from what. A surface that is turned by t from the plane sees
    1 - cos t of the relief on average, twice as much as if nothing else rose above it.
    """
    cosine = np.clip((normal * plane).sum(axis=1, keepdims=True), 0.0, 1.0)
    vector = np.einsum("na,nac->nc", normal, moments[:, 3:12].reshape(-1, 3, 3)) / np.pi
    return np.maximum(vector + cosine * returned, 0.0) + (1 - cosine) * returned


def of_planes(moments: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """Returns what `in_relief` reads beside moments (N, 24), (N, 7); it may be interpolated as these are.

    plane (N, 3): normals of planes, as long as much of what is there is relief on these.
    """
    part = np.linalg.norm(plane, axis=1, keepdims=True)
    return np.column_stack([part, plane, part * irradiance(moments, -plane / np.maximum(part, 1e-9))])


def in_relief(falls: np.ndarray, moments: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Returns irradiance over pi, (N, 3), where it is `falls` as far as there is no relief: moments (N, 31), the last
    seven by `of_planes`; unit normals (N, 3)."""
    found, rows = falls.copy(), np.flatnonzero(moments[:, MOMENTS] > 0)
    part, plane, returned = np.split(moments[rows, MOMENTS:], (1, 4), axis=1)
    plane = plane / np.maximum(np.linalg.norm(plane, axis=1, keepdims=True), 1e-9)
    of_relief = irradiance_of_relief(moments[rows], normal[rows], plane, returned / part)
    found[rows] += part * (of_relief - found[rows])
    return found


def lobes(moments: np.ndarray, direction: np.ndarray, sharpness: np.ndarray) -> np.ndarray:
    """Returns the mean radiance of surfaces over spherical Gaussians, so sharp (N,), around unit directions (N, 3), and
    the share of the sky that is open there, (N, 4)."""
    sharp = np.maximum(sharpness, 1e-3)
    first = 1 / np.tanh(sharp) - 1 / sharp
    second = 1 - 3 * first / sharp
    linear = FIRST * first[:, None] * np.einsum("na,nac->nc", direction, moments[:, 3:12].reshape(-1, 3, 3))
    more = second * (SECOND * _second(direction) * moments[:, 12:17]).sum(axis=1)
    seen = ZEROTH * moments[:, :3] + linear + more[:, None] * _tint(moments[:, :3])
    open_sky = ZEROTH * moments[:, 20] + FIRST * first * (direction * moments[:, 21:24]).sum(axis=1)
    open_sky = np.clip(open_sky, 0.0, 1.0)
    # The sky's mean radiance; of an even one all of it.
    sky = (moments[:, :3] - moments[:, 17:20]) / np.maximum(moments[:, 20, None], 1e-30)
    return np.column_stack([np.maximum(seen - open_sky[:, None] * sky, 0.0), open_sky])


def _second(direction: np.ndarray) -> np.ndarray:
    """(N, 5): the polynomials of second order."""
    x, y, z = direction.T
    return np.stack([x * y, y * z, 3 * z * z - 1, x * z, x * x - y * y], axis=1)


def _tint(light: np.ndarray) -> np.ndarray:
    """(N, 3) over its mean."""
    return light / np.maximum(light.mean(axis=1, keepdims=True), 1e-30)
