"""Cameras of small scenes: where they look, and their lenses."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pointsplat_addon.core.scene.camera import Camera

RESOLUTION = (48, 40)
Vector = Sequence[float] | np.ndarray


def look_at(eye: Vector, target: Vector, up: Vector = (0, 0, 1)) -> np.ndarray:
    """view_from_world (4, 4)."""
    origin, back = np.asarray(eye, float), np.subtract(eye, target).astype(float)
    back /= np.linalg.norm(back)
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(back, right), back
    matrix[:3, 3] = -matrix[:3, :3] @ origin
    return matrix


def camera(
    eye: Vector = (0, -4, 0),
    target: Vector = (0, 0, 0),
    resolution: tuple[int, int] = RESOLUTION,
    field_of_view: float = 40.0,
    near: float = 0.1,
    far: float = 100.0,
    region: tuple[int, int, int, int] | None = None,
    parallel: float | None = None,
    shift: tuple[float, float] = (0.0, 0.0),
) -> Camera:
    """`field_of_view` in degrees, or the width `parallel` in world units, spans the larger side; so does `shift`."""
    width, height = resolution
    largest = max(resolution)
    scale = 2 / parallel if parallel else 1 / np.tan(np.radians(field_of_view) / 2)
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1] = scale * largest / width, scale * largest / height
    column = 3 if parallel else 2
    sense = -1 if parallel else 1
    clip[:2, column] = sense * 2 * shift[0] * largest / width, sense * 2 * shift[1] * largest / height
    if parallel:
        clip[2, 2:] = -2 / (far - near), -(far + near) / (far - near)
        clip[3, 3] = 1
    else:
        clip[2, 2:] = -(far + near) / (far - near), -2 * far * near / (far - near)
        clip[3, 2] = -1
    return Camera(look_at(eye, target), clip, resolution, region, near, far)
