"""How far apart surfels are: some pixels where a camera looks, and more elsewhere."""

from __future__ import annotations

import numpy as np

from ...core.scene.camera import Camera

PIXELS = 6.0  # between surfels that the camera sees
UNSEEN = 3.0  # times farther apart, where it does not look


class Density:
    """The spacing of surfels around a camera, in world space from `origin`."""

    def __init__(self, camera: Camera, origin: np.ndarray) -> None:
        """origin (3,) float64: what places are relative to."""
        self._camera = camera
        self._view = (
            camera.view_from_world[:3, :3],
            camera.view_from_world[:3, 3] + camera.view_from_world[:3, :3] @ origin,
        )
        fx, fy, cx, cy = camera.pixel_from_view()
        self._focal, self._middle = np.array([fx, fy]), np.array([cx, cy])

    def spacing(self, place: np.ndarray, margin: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
        """Returns for places (3, n) how far apart surfels are there, and how far away the camera is, (n,) each.

        `margin`: how far around each place what lies there reaches.
        """
        rotation, shift = self._view
        x, y, z = rotation @ place + shift[:, None]
        depth = -z
        width, height = self._camera.window[2:]
        if not self._camera.perspective:
            away = np.full(len(depth), np.inf)
            size = np.full(len(depth), 1.0 / self._focal[0])
            px, py = self._middle[0] + self._focal[0] * x, self._middle[1] + self._focal[1] * y
            wide = margin * self._focal[0]
            seen = np.ones(len(depth), bool)
        else:
            away = np.maximum(np.sqrt(x * x + y * y + z * z) - margin, 1e-30)
            size = away / self._focal[0]
            forward = np.maximum(depth, 1e-30)
            px, py = self._middle[0] + self._focal[0] * x / forward, self._middle[1] + self._focal[1] * y / forward
            wide = margin * self._focal[0] / forward
            seen = depth > -margin
        border = 0.1 * max(width, height) + wide
        seen &= (px > -border) & (px < width + border) & (py > -border) & (py < height + border)
        return PIXELS * size * np.where(seen, 1.0, UNSEEN), away
