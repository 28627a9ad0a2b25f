"""Strands as casters of shadows: cut into short segments, which are balls of the area that they show to a light."""

from __future__ import annotations

import numpy as np

from ..numeric.record import record
from ..numeric.segments import owners, ranks
from ..scene.lights import Light
from ..strand.levels import StrandLevels
from ..strand.projection import tube_radius_scale
from .casters import Casters

MOST_ACROSS = 64  # balls across a strand


@record
class StrandSegments:
    """N segments of strands in world space, no longer than shadows resolve."""

    origin: np.ndarray  # (3,) float64
    position: np.ndarray  # (N, 3) float32, relative to origin
    along: np.ndarray  # (N, 3) float32, unit
    side: np.ndarray | None  # (N, 3) float32, half the width of ribbons; None: tubes
    radius: np.ndarray  # (N,) float32
    length: np.ndarray  # (N,) float32
    step: float  # greatest length of a segment: wide strands are divided across by it, too

    def casters_toward(self, light: Light) -> Casters:
        """Disconnected opaque balls, each of the area that its segment of a strand shows to the light: 2 r L times the
        sine of the angle between them. Balls of segments as wide as long join to a closed surface."""
        to_light = np.broadcast_to(-np.asarray(light.direction, np.float32), self.position.shape)
        if light.kind != "SUN":
            to_light = (light.position - self.origin).astype(np.float32) - self.position
            to_light = to_light / np.maximum(np.linalg.norm(to_light, axis=1, keepdims=True), np.float32(1e-30))
        if self.side is None:
            side = np.cross(self.along, to_light)
            shown = np.linalg.norm(side, axis=1)
            side *= (self.radius / np.maximum(shown, np.float32(1e-6)))[:, None]
        else:
            side = self.side
            shown = np.abs(np.einsum("nc,nc->n", np.cross(self.along, side), to_light))
            shown /= np.maximum(self.radius, np.float32(1e-30))
        area = 2 * self.radius * self.length * shown
        across = np.clip(np.ceil(2 * self.radius / np.float32(self.step)), 1, MOST_ACROSS).astype(np.int64)
        which, number = owners(across), ranks(across)
        off = (2 * number + 1) / across[which] - 1
        position = self.position[which] + off[:, None].astype(np.float32) * side[which]
        # Wide strands are closed surfaces: their balls cover the whole area of their segments.
        wide = np.clip(self.radius / np.float32(self.step) - 0.5, 0, 1)
        tile = (2 * self.radius / across) ** 2 + self.length**2
        squared = (area / (np.pi * across)) * (1 - wide) + np.where(shown > 0, 0.25 * tile, 0) * wide
        radius = np.sqrt(squared[which]).astype(np.float32)
        return Casters("OPAQUE", self.origin, position, radius).take(np.flatnonzero(radius > 0))


def cut_strands(strands: StrandLevels, world_from_object: np.ndarray, step: float) -> StrandSegments:
    """The strands of an instance, cut into segments of at most `step` object units; world_from_object: (4, 4)
    float64."""
    last = np.ones(len(strands), bool)
    last[strands.start[1:] - 1] = False
    a = np.flatnonzero(last)
    b = a + 1
    linear = np.asarray(world_from_object[:3, :3], float)
    axis = strands.position[b] - strands.position[a]
    count = np.maximum(np.ceil(np.linalg.norm(axis, axis=1) / np.float32(step)), 1).astype(np.int64)
    which, number = owners(count), ranks(count)
    part = ((number + 0.5) / count[which]).astype(np.float32)
    first, second = a[which], b[which]
    turn = linear.T.astype(np.float32)
    scale = np.float32(tube_radius_scale(world_from_object[None])[0])
    along = axis[which] @ turn
    length = np.linalg.norm(along, axis=1)
    along /= np.maximum(length, np.float32(1e-30))[:, None]
    radius = strands.radius[first] * (1 - part) + strands.radius[second] * part
    side = None
    if strands.side is not None:
        mixed = strands.side[first] * (1 - part)[:, None] + strands.side[second] * part[:, None]
        side = (mixed * radius[:, None]) @ turn
        radius = np.linalg.norm(side, axis=1)
    else:
        radius = radius * scale
    position = (strands.position[first] + part[:, None] * axis[which]) @ turn
    origin = linear @ strands.origin + world_from_object[:3, 3]
    length /= count[which].astype(np.float32)
    return StrandSegments(origin, position, along, side, radius, length, max(step * float(scale), 1e-30))
