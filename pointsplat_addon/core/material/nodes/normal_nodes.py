"""The normal map node, normals in tangent or object space from a colour, and the bump node, normals from heights."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs, compute_node
from .input_nodes import UV, three_columns
from .math_functions import normalize_rows, row_dot


@record
class NormalMap(Expression):
    """Unit normal (N, 3) in object space from a normal map's colour.

    In tangent space, n = normalize(x T + y B + z N) with (x, y, z) = 2 c - 1, and strength s turns it into
    (s x, s y, mix(1, z, s)); in object space the map's normal is blended with the surface's by s.
    """

    strength: Expression
    color: Expression
    uv: UV | None = None  # the map of the tangent; None: the map holds normals in object space
    flip: tuple[float, float, float] = (1.0, 1.0, 1.0)  # signs of the axes

    @property
    def varies(self) -> bool:
        return True

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        strength, color = values[:2]
        n = (2 * color - 1) * np.array(self.flip, np.float32)
        strength = np.maximum(strength, 0)
        normal = three_columns(inputs.normal, len(inputs))
        if self.uv is None:
            return normalize_rows(normal + (normalize_rows(n) - normal) * strength)
        if inputs.tangent is None:
            return normal
        tangent, bitangent = _tangent_frame(normal, inputs)
        depth = 1 + (n[:, 2:] - 1) * np.minimum(strength, 1)
        bent = normalize_rows(n[:, :1] * strength * tangent + n[:, 1:2] * strength * bitangent + depth * normal)
        return np.where(row_dot(bent, bent) > 0, bent, normal)


def _tangent_frame(normal: np.ndarray, inputs: SampleInputs) -> tuple[np.ndarray, np.ndarray]:
    """Tangent and bitangent (N, 3); the tangent as given, Cycles does not make it orthogonal again."""
    tangent = three_columns(inputs.tangent, len(inputs))
    sign = 1 if inputs.bitangent_sign is None else inputs.bitangent_sign[:, None]
    return tangent, np.cross(normal, tangent) * sign


@record
class Tangent(Expression):
    """The direction (N, 3) in object space along which a surface is the rougher, as long as `stretch`.

    Around an axis: across it, from how far the generated coordinates are from their middle, as in Cycles; else along
    growing u of a UV map. It is turned around the normal by `turns`.
    """

    stretch: Expression  # in [0, 1): 1 - 1 / ratio of the roughness along it to the mean one
    turns: Expression
    axis: int = 2
    uv: UV | None = None  # None: around the axis

    @property
    def varies(self) -> bool:
        return True

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        stretch, turns = values[:2]
        normal = three_columns(inputs.normal, len(inputs))
        if self.uv is None:
            away = three_columns(inputs.generated, len(inputs)) - np.float32(0.5)
            along = np.zeros_like(away)
            first, second = ((1, 2), (0, 2), (0, 1))[self.axis]
            along[:, first], along[:, second] = -away[:, second], away[:, first]
        else:
            along = three_columns(inputs.tangent, len(inputs))
        along = normalize_rows(along - row_dot(along, normal) * normal)
        angle = np.float32(2 * np.pi) * turns
        return stretch * (np.cos(angle) * along + np.sin(angle) * np.cross(normal, along))


@record
class Bump(Expression):
    """Unit normal (N, 3) in object space of a surface that is raised by a height (Mikkelsen 2010), as in Cycles.

    With p and q two ways in the surface, along which the height changes by a and b, and d = p . (q x n):
    n' = |d| n - sign(d) distance (a q x n + b n x p), made unit and blended with n by the strength. Where nothing is
    known of how heights change, the normal stays.
    """

    height: Expression
    strength: Expression
    distance: Expression  # object units of a height of 1; negative: heights lead inwards
    normal: Expression  # what is raised
    of_object: bool = False  # distances grow with the object; else they are of world space where that is known

    @property
    def varies(self) -> bool:
        return True

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        height, strength, distance, normal = values
        if inputs.moved is None or inputs.steps is None:
            return normal
        a, b = (compute_node(self.height, moved, {}) - height for moved in inputs.moved)
        if self.of_object and inputs.unit is not None:
            distance = distance * inputs.unit
        return bumped(normal, inputs.steps[0], inputs.steps[1], distance * a, distance * b, strength)


def bumped(
    normal: np.ndarray, p: np.ndarray, q: np.ndarray, a: np.ndarray, b: np.ndarray, strength: np.ndarray
) -> np.ndarray:
    """Normals (N, 3), made unit, of surfaces that rise by a and b (N, 1) along p and q (N, 3): see Bump."""
    across, along = np.cross(q, normal), np.cross(normal, p)
    d = row_dot(p, across)
    # Steps of small splats: products of four of their lengths would vanish in float32.
    scale = np.float32(1) / np.maximum(np.abs(d), np.finfo(np.float32).tiny)
    raised = normalize_rows(normal - np.sign(d) * scale * (a * across + b * along))
    raised = np.where(row_dot(raised, raised) > 0, raised, normal)
    return normalize_rows(normal + np.maximum(strength, 0) * (raised - normal))
