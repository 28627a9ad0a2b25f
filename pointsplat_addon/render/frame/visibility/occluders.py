"""Leaves polygons out of a view that others hide.

What hides most is drawn into the visibility buffer, which is cleared after that. All that is not hidden is then drawn
in the order in which it would be drawn among all: the picture is the same to the bit.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...device.protocol import Device, Texture
from ...passes.uniforms import SampleView
from ...passes.visibility.buffer import VisibilityBuffer
from ...passes.visibility.farthest import FarthestDepths
from ...passes.visibility.polygon_ids import PolygonCover
from .occlusion import Candidates, hidden_of
from .polygon_draws import PolygonsInView, PolygonSource, draws_of, polygons_in_view


class Occluders:
    """Draws what may hide others into a visibility buffer."""

    def __init__(
        self,
        device: Device,
        buffer: VisibilityBuffer,
        normal: bool,
        view: SampleView,
        shared: dict[str, Texture],
        run: Callable[[str, Callable[[], None]], None],
    ) -> None:
        """`normal`: normals tell surfaces apart. `run`: times a pass under its name."""
        self._device, self._buffer, self._normal = device, buffer, normal
        self._view, self._shared, self._run = view, shared, run
        self._depths: FarthestDepths | None = None

    def without_hidden(self, shown: list[PolygonsInView]) -> list[PolygonsInView]:
        """Returns what a view shows without what is hidden, as far as it pays to know. What is in the buffer is
        lost."""
        if not shown:
            return shown
        ends = np.cumsum([len(some.instance) for some in shown])[:-1]

        def those(which: np.ndarray) -> list[PolygonsInView]:
            return [some.those(part) for some, part in zip(shown, np.split(which, ends), strict=True)]

        size = self._view.size
        try:
            hidden = hidden_of(candidates(shown, size), size, lambda which: self._draw(those(which)))
        finally:
            self.release()
        return those(~hidden) if hidden.any() else shown

    def draw_some(self, source: PolygonSource) -> np.ndarray:
        """Draws more polygons into the buffer, and returns the farthest depth of each block of pixels."""
        return self._draw(polygons_in_view(self._device, source, self._view, self._buffer.cells))

    def release(self) -> None:
        if self._depths is not None:
            self._depths.release()
        self._depths = None

    def _draw(self, more: list[PolygonsInView]) -> np.ndarray:
        """Draws more into the buffer, and returns the farthest depth of each block of pixels."""
        if self._depths is None:
            self._depths = FarthestDepths(self._device, self._buffer)
            self._buffer.clear()
        depths, view = self._depths, self._view
        cover = PolygonCover(self._device, draws_of(self._device, more, 0), self._buffer, self._normal)

        def draw() -> None:
            cover.rasterise(view, self._shared)
            cover.cover(view, self._shared)

        try:
            self._run("occlusion", draw)
        finally:
            cover.release()
        found = []
        self._run("occlusion", lambda: found.append(depths.read(view)))
        return found[0]


def candidates(shown: list[PolygonsInView], size: tuple[int, int]) -> Candidates:
    """Returns the boxes of all instances, mesh by mesh. `size`: (width, height) of the picture in pixels."""
    rectangle = np.concatenate([some.rectangle for some in shown])
    nearest, farthest = np.concatenate([some.depth for some in shown]).T
    work = np.concatenate([some.triangles for some in shown]).astype(np.float64)
    return Candidates(rectangle[:, :2] * size, rectangle[:, 2:] * size, nearest, farthest, work)
