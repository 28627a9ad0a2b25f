"""Nodes that read the samples (UV maps, attributes, coordinates), and constants."""

from __future__ import annotations

import numpy as np

from ...numeric.record import record
from ..expression import Expression, SampleInputs
from ..object_values import components


@record
class Constant(Expression):
    """A scalar, vector or colour that is the same at all samples."""

    value: tuple[float, ...]

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return np.array([self.value], np.float32)


@record
class Source(Expression):
    """Base of the nodes that read the samples, so that their values vary."""

    @property
    def varies(self) -> bool:
        return True


@record
class UV(Source):
    """A UV map as (u, v, 0); None is the active map."""

    name: str | None = None

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        name = inputs.active_uv if self.name is None else self.name
        return three_columns(None if name is None else inputs.uv.get(name), len(inputs))


@record
class ColorAttribute(Source):
    """A colour attribute with its alpha, (N, 4); None is the active one."""

    name: str | None = None

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color = inputs.color(self.name)
        return np.zeros((len(inputs), 4), np.float32) if color is None else color


@record
class Attribute(Source):
    """A named attribute, (N, 5): colour, alpha, and the mean that Blender's Fac output gives.

    Colour attributes come before UV maps of the same name. Without alpha (a UV map, a missing name) alpha is 1.
    """

    name: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        color = inputs.colors.get(self.name)
        if color is not None:
            found = np.empty((len(color), 5), np.float32)
            found[:, :4] = color
            # Column by column, which is many times as fast as a mean along rows.
            found[:, 4] = (color[:, 0] + color[:, 1] + color[:, 2]) / np.float32(3)
            return found
        uv = three_columns(inputs.uv.get(self.name), len(inputs))
        return np.column_stack([uv, np.ones(len(uv), np.float32), uv[:, 0]])


@record
class Coordinates(Source):
    """`position`, `generated` or `normal` of SampleInputs."""

    kind: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        return three_columns(getattr(inputs, self.kind), len(inputs))


@record
class Backfacing(Source):
    """1 where the back of a triangle is seen, else 0: the one value that depends on who looks."""

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        if inputs.backfacing is None:
            return np.zeros((1, 1), np.float32)
        return inputs.backfacing[:, None].astype(np.float32)


@record
class ObjectValue(Source):
    """A value of the object that a sample lies on, (N, C), zeros if it is unknown. Its name: see object_values.py."""

    name: str

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        found = inputs.objects.get(self.name)
        return np.zeros((1, components(self.name)), np.float32) if found is None else found


def three_columns(array: np.ndarray | None, count: int) -> np.ndarray:
    """An array (N, 2 | 3) padded with zeros to (N, 3) float32; None gives zeros."""
    out = np.zeros((count, 3), np.float32)
    if array is not None:
        out[:, : array.shape[1]] = array
    return out
