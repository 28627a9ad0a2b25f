"""The published formula of captured Gaussian splats in float64: projection (Kerbl et al. 2023; Zwicker et al. 2001),
Mip-Splatting's opacity (Yu et al. 2024), spherical harmonics to degree 4, and blending front to back at the centres of
pixels.

The early stop of the published rasteriser, where less than 1e-4 passes, is left out, and so are its tiles.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.captured import CapturedSplats


@dataclass
class Projected:
    """N splats in a view, in no order."""

    centre: np.ndarray  # (N, 2) pixels
    depth: np.ndarray  # (N,)
    covariance: np.ndarray  # (N, 2, 2) pixels^2, after the low-pass
    conic: np.ndarray  # (N, 2, 2) its inverse
    opacity: np.ndarray  # (N,)
    color: np.ndarray  # (N, 3) linear, or display values
    slope: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))  # (N, 2) change of depth per pixel
    spread: np.ndarray = field(default_factory=lambda: np.zeros(0))  # (N,) standard deviation of depth along a ray

    def __add__(self, other: Projected) -> Projected:
        names = self.__dataclass_fields__
        return Projected(*(np.concatenate([getattr(self, name), getattr(other, name)]) for name in names))


def harmonics(d: np.ndarray) -> np.ndarray:
    """(N, 25): the functions along unit directions (N, 3), with the order and signs of Kerbl et al."""
    x, y, z = d.T
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    return np.stack([
        np.full_like(x, 0.5 * np.sqrt(1 / np.pi)),
        *(np.sqrt(3 / (4 * np.pi)) * np.stack([-y, z, -x])),
        *(0.5 * np.sqrt(15 / np.pi) * np.stack([xy, -yz])),
        0.25 * np.sqrt(5 / np.pi) * (3 * zz - 1),
        -0.5 * np.sqrt(15 / np.pi) * xz,
        0.25 * np.sqrt(15 / np.pi) * (xx - yy),
        -0.25 * np.sqrt(35 / (2 * np.pi)) * y * (3 * xx - yy),
        0.5 * np.sqrt(105 / np.pi) * xy * z,
        -0.25 * np.sqrt(21 / (2 * np.pi)) * y * (5 * zz - 1),
        0.25 * np.sqrt(7 / np.pi) * z * (5 * zz - 3),
        -0.25 * np.sqrt(21 / (2 * np.pi)) * x * (5 * zz - 1),
        0.25 * np.sqrt(105 / np.pi) * z * (xx - yy),
        -0.25 * np.sqrt(35 / (2 * np.pi)) * x * (xx - 3 * yy),
        0.75 * np.sqrt(35 / np.pi) * xy * (xx - yy),
        -0.75 * np.sqrt(35 / (2 * np.pi)) * yz * (3 * xx - yy),
        0.75 * np.sqrt(5 / np.pi) * xy * (7 * zz - 1),
        -0.75 * np.sqrt(5 / (2 * np.pi)) * yz * (7 * zz - 3),
        3 / 16 * np.sqrt(1 / np.pi) * (35 * zz * zz - 30 * zz + 3),
        -0.75 * np.sqrt(5 / (2 * np.pi)) * xz * (7 * zz - 3),
        3 / 8 * np.sqrt(5 / np.pi) * (xx - yy) * (7 * zz - 1),
        -0.75 * np.sqrt(35 / (2 * np.pi)) * xz * (xx - 3 * yy),
        3 / 16 * np.sqrt(35 / np.pi) * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
    ], axis=1)  # fmt: skip


def rotations(quaternion: np.ndarray) -> np.ndarray:
    """(N, 3, 3) of quaternions w, x, y, z (N, 4)."""
    w, x, y, z = (quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def linear_from_display(c: np.ndarray) -> np.ndarray:
    return np.where(c > 0.04045, ((np.maximum(c, 0.04045) + 0.055) / 1.055) ** 2.4, c / 12.92)


def display_from_linear(c: np.ndarray) -> np.ndarray:
    return np.where(c > 0.0031308, 1.055 * np.maximum(c, 0.0031308) ** (1 / 2.4) - 0.055, c * 12.92)


def project(splats: CapturedSplats, world_from_object: np.ndarray, camera: Camera, trained: bool = False) -> Projected:
    """What a camera sees of the splats of one instance, (4, 4). `trained`: in display values."""
    view = camera.view_from_world @ world_from_object
    linear = view[:3, :3]
    position = splats.position.astype(float) + splats.origin
    p = position @ linear.T + view[:3, 3]
    depth = -p[:, 2]
    there = (depth > camera.nearest) & (depth < camera.far)
    position, p, depth = position[there], p[there], depth[there]
    axes = rotations(splats.rotation[there].astype(float)) * splats.scale[there].astype(float)[:, None, :]
    covariance = linear @ axes @ axes.swapaxes(1, 2) @ linear.T

    fx, fy, cx, cy = camera.pixel_from_view()
    jacobian = np.zeros((len(p), 2, 3))
    if camera.perspective:
        x0, y0, _, _ = camera.window
        middle, half = np.array(camera.resolution) / 2, np.abs(np.array(camera.resolution) / 2 / (fx, fy))
        middle = (middle - (cx + x0, cy + y0)) / (fx, fy)
        slope = np.clip(p[:, :2] / depth[:, None], middle - 1.3 * half, middle + 1.3 * half)
        jacobian[:, 0, 0], jacobian[:, 1, 1] = fx / depth, fy / depth
        jacobian[:, :, 2] = slope * (fx, fy) / depth[:, None]
        centre = p[:, :2] / depth[:, None] * (fx, fy) + (cx, cy)
        eye = np.linalg.solve(view, [0, 0, 0, 1])[:3]
        direction = position - eye
    else:
        jacobian[:, 0, 0], jacobian[:, 1, 1] = fx, fy
        centre = p[:, :2] * (fx, fy) + (cx, cy)
        direction = np.broadcast_to(np.linalg.solve(linear, [0, 0, -1]), p.shape)
    half_axes = jacobian @ linear @ axes
    own = half_axes @ half_axes.swapaxes(1, 2)
    wide = own + 0.3 * np.eye(2)
    # The determinant of a sum of squares is one, which does not cancel (Cauchy and Binet).
    before = (np.cross(half_axes[:, 0], half_axes[:, 1]) ** 2).sum(axis=1)
    after = before + 0.3 * (np.einsum("nii->n", own) + 0.3)
    conic = wide[:, ::-1, ::-1].swapaxes(1, 2) * [[1, -1], [-1, 1]] / after[:, None, None]
    opacity = splats.opacity[there].astype(float)
    if splats.antialiased:
        opacity = opacity * np.sqrt(before / after)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    coefficients = splats.base[there, None].astype(float)
    if splats.sh is not None:
        coefficients = np.concatenate([coefficients, splats.sh[there].astype(float)], axis=1)
    display = np.einsum("nk,nkc->nc", harmonics(direction)[:, : coefficients.shape[1]], coefficients) + 0.5
    # Depth grows along -z: its covariance with the position in the picture.
    together = -(jacobian @ covariance)[:, :, 2]
    gradient = (conic @ together[..., None])[..., 0]
    variance = np.maximum(covariance[:, 2, 2] - (gradient * together).sum(axis=1), 1e-10 * depth**2)
    color = np.maximum(display, 0) if trained else linear_from_display(np.maximum(display, 0))
    return Projected(centre, depth, wide, conic, opacity, color, gradient, np.sqrt(variance))


def below(x: np.ndarray) -> np.ndarray:
    """The share of a Gaussian below x standard deviations, as shaders/lib/splat/kernel.glsl has it."""
    x = np.clip(x, -6, 6)
    return 1 / (1 + np.exp(-1.5957691 * (x + 0.044715 * x**3)))


def blend(seen: Projected, size: tuple[int, int], opaque: np.ndarray | float = np.inf) -> np.ndarray:
    """(H, W, 4): premultiplied light and 1 - transmittance before depths `opaque`, (H, W) or one for all."""
    width, height = size
    order = np.argsort(seen.depth, kind="stable")
    y, x = np.mgrid[:height, :width].reshape(2, -1) + 0.5
    behind = np.broadcast_to(np.asarray(opaque, float), (height, width)).reshape(-1)
    found, through = np.zeros((len(x), seen.color.shape[1])), np.ones(len(x))
    reach = np.sqrt(2 * np.log(np.maximum(255 * seen.opacity, 1)))
    half = reach[:, None] * np.sqrt(np.einsum("nii->ni", seen.covariance))
    low = np.clip(np.floor(seen.centre - half), 0, (width, height)).astype(int)
    high = np.clip(np.ceil(seen.centre + half), 0, (width, height)).astype(int)
    for k in order:
        (x0, y0), (x1, y1) = low[k], high[k]
        if x1 <= x0 or y1 <= y0:
            continue
        rows = (np.arange(y0, y1)[:, None] * width + np.arange(x0, x1)).reshape(-1)
        v = np.stack([x[rows], y[rows]]) - seen.centre[k][:, None]
        alpha = seen.opacity[k] * np.exp(-0.5 * np.einsum("in,ij,jn->n", v, seen.conic[k], v))
        alpha = np.where(alpha >= 1 / 255, np.minimum(alpha, 0.99), 0)
        if np.isfinite(behind[rows]).any():
            there = np.where(np.isfinite(behind[rows]), behind[rows], 1e300)
            share = below((there - seen.depth[k] - seen.slope[k] @ v) / seen.spread[k])
            alpha = 1 - (1 - alpha) ** share
        weight = through[rows] * alpha
        found[rows] += weight[:, None] * seen.color[k]
        through[rows] -= weight
    return np.column_stack([found, 1 - through]).reshape(height, width, -1)


def picture(
    things: list[tuple[CapturedSplats, np.ndarray]], camera: Camera, trained: bool = False, **more
) -> np.ndarray:
    """(H, W, 4): what a camera sees of instances of splats, each with its transform (4, 4). `trained`: in display
    values."""
    first, *others = (project(splats, matrix, camera, trained) for splats, matrix in things)
    seen = first
    for other in others:
        seen = seen + other
    return blend(seen, camera.window[2:], **more)


def linear_over(shown: np.ndarray, world: np.ndarray | None = None) -> np.ndarray:
    """(H, W, 4): scene-linear light, premultiplied, of a picture in display values (H, W, 4) over a linear world."""
    alpha = shown[..., 3:]
    if world is not None:
        shown = shown[..., :3] + (1 - alpha) * display_from_linear(world)
        return np.concatenate([linear_from_display(shown), np.ones_like(alpha)], axis=-1)
    color = linear_from_display(shown[..., :3] / np.where(alpha > 0, alpha, 1)) * alpha
    return np.concatenate([color, alpha], axis=-1)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    """In decibels, of pictures whose white is 1."""
    return float(-10 * np.log10(np.maximum(np.mean((a - b) ** 2), 1e-30)))
