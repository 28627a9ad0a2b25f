"""Expressions over samples: the nodes of a material's inputs as a frozen DAG, evaluated with NumPy.

A value is a float32 array (N, C): C = 1 for scalars, 3 for vectors and colours, 4 where an attribute or an image
carries alpha. An expression that does not vary yields (1, C), so that constant branches cost nothing. The formulas of
the nodes are those of Blender's shader nodes as Cycles evaluates them, division by zero included.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import field, fields, replace
from functools import cached_property

import numpy as np

from ..numeric.record import record
from ..scene.camera import Camera
from .image import Image

CHUNK = 1 << 16  # samples evaluated at once: temporaries stay in the processor's cache
Part = slice | np.ndarray  # some of the samples: a slice of step 1, or (K,) indices


@record
class SampleInputs:
    """What is known at N samples of one mesh. Whatever is None or missing reads as Blender's default (zero)."""

    uv: dict[str, np.ndarray] = field(default_factory=dict)  # map name to (N, 2)
    active_uv: str | None = None  # the map that expressions without a name read
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # attribute name to (N, 4), scene-linear
    active_color: str | None = None  # the attribute that expressions without a name read; None: the first
    position: np.ndarray | None = None  # (N, 3), object space
    generated: np.ndarray | None = None  # (N, 3), position in the mesh's texture space, [0, 1] over its bounds
    normal: np.ndarray | None = None  # (N, 3), unit, object space
    tangent: np.ndarray | None = None  # (N, 3), unit, object space, along growing u of the map that is asked for
    bitangent_sign: np.ndarray | None = None  # (N,), bitangent = sign * normal x tangent; None: 1
    # Values of the objects that the samples lie on, by name, (N, C), or (1, C) where one object holds all of them
    objects: dict[str, np.ndarray] = field(default_factory=dict)
    # (N,) bool: the side is seen where the triangle's normal does not point; None: nowhere
    backfacing: np.ndarray | None = None
    eye: Camera | None = None  # by which samples are seen; None: from anywhere
    count: int | None = None  # N; None: the length of any array given
    # The inputs at the ends of two conjugate half-diameters of each sample's splat: images are filtered that wide
    displaced: tuple[SampleInputs, SampleInputs] | None = None
    rough: bool = False  # by one sample of a level of about that size: enough where nobody sees the splats themselves
    # The inputs a little way along two directions in the surface, and these ways, (2, N, 3) in object space: heights
    # change along them
    moved: tuple[SampleInputs, SampleInputs] | None = None
    steps: np.ndarray | None = None
    unit: np.ndarray | None = None  # (N, 1): how long of these ways a unit of object space is; None: 1
    # (width, height) of an image whose texel centres every UV map holds, row by row, from the texel `first` on:
    # images of that size are then read and not interpolated
    grid: tuple[int, int] | None = None
    first: int = 0

    ARRAYS = ("position", "generated", "normal", "tangent", "bitangent_sign", "backfacing")

    def __len__(self) -> int:
        """N. Raises ValueError when neither `count` nor any array is given."""
        if self.count is not None:
            return self.count
        for array in (*self.uv.values(), *self.colors.values(), *(getattr(self, name) for name in self.ARRAYS)):
            if array is not None:
                return len(array)
        raise ValueError("SampleInputs needs `count` where it holds no array")

    def take(self, part: Part) -> SampleInputs:
        """Some of the samples: a slice of step 1, whose arrays are views, or indices, which forget the `grid`."""
        single = {n: getattr(self, n)[part] for n in self.ARRAYS if getattr(self, n) is not None}
        if isinstance(part, slice):
            start, stop, _ = part.indices(len(self))
            grid, first, count = self.grid, self.first + start, max(stop - start, 0)
        else:
            grid, first, count = None, 0, len(part)
        return replace(
            self,
            uv={name: array[part] for name, array in self.uv.items()},
            colors={name: array[part] for name, array in self.colors.items()},
            objects={name: array if len(array) == 1 else array[part] for name, array in self.objects.items()},
            count=count,
            displaced=_take(self.displaced, part),
            moved=_take(self.moved, part),
            steps=None if self.steps is None else self.steps[:, part],
            unit=None if self.unit is None else self.unit[part],
            grid=grid,
            first=first,
            **single,
        )

    def color(self, name: str | None) -> np.ndarray | None:
        """A colour attribute (N, 4) by name, None for the active one. Returns None if there is none."""
        if name is None:
            name = self.active_color or next(iter(self.colors), None)
        return None if name is None else self.colors.get(name)


def _take(pair: tuple[SampleInputs, SampleInputs] | None, part: Part) -> tuple[SampleInputs, SampleInputs] | None:
    return None if pair is None else (pair[0].take(part), pair[1].take(part))


@record
class Expression:
    """A node of a material's DAG. Fields that are expressions are its arguments, all others are parameters."""

    @cached_property
    def arguments(self) -> tuple[Expression, ...]:
        values = (getattr(self, f.name) for f in fields(self))
        return tuple(v for v in values if isinstance(v, Expression))

    @cached_property
    def digest(self) -> str:
        """Content key: equal digests mean equal values for equal samples."""
        parts = [type(self).__name__]
        for f in fields(self):
            value = getattr(self, f.name)
            if isinstance(value, np.ndarray):
                value = (value.shape, value.dtype.str, value.tobytes())
            parts.append(value.digest if isinstance(value, Expression | Image) else repr(value))
        return hashlib.blake2b("\0".join(parts).encode(), digest_size=16).hexdigest()

    @cached_property
    def varies(self) -> bool:
        """Whether the value may differ from sample to sample."""
        return any(a.varies for a in self.arguments)

    def read(self, inputs: SampleInputs) -> tuple[Expression, ...]:
        """The arguments whose values `compute` takes at these samples, in order."""
        return self.arguments

    def compute(self, inputs: SampleInputs, *values: np.ndarray) -> np.ndarray:
        """The value (N | 1, C) from the samples and the values of what it reads."""
        raise NotImplementedError


def walk(*roots: Expression | None) -> Iterator[Expression]:
    """Yields every expression that the roots depend on, themselves included, each once."""
    seen: set[int] = set()
    stack = [r for r in roots if r is not None]
    while stack:
        node = stack.pop()
        if id(node) not in seen:
            seen.add(id(node))
            stack.extend(node.arguments)
            yield node


def evaluate(output: Expression, inputs: SampleInputs) -> np.ndarray:
    """The value of an expression at every sample, (N, C) float32."""
    count = len(inputs)
    if not output.varies:
        value = compute_node(output, replace(inputs, count=1), {})
        return np.broadcast_to(value, (count, value.shape[1])).copy()
    parts = [compute_node(output, inputs.take(slice(i, i + CHUNK)), {}) for i in range(0, count, CHUNK)]
    sizes = [min(CHUNK, count - i) for i in range(0, count, CHUNK)]
    whole = [np.broadcast_to(p, (n, p.shape[1])) for p, n in zip(parts, sizes, strict=True)]
    if not whole:
        whole = [compute_node(output, inputs, {})]
    return np.concatenate(whole).astype(np.float32, copy=False)


def constant(output: Expression) -> np.ndarray | None:
    """The value (C,) float32 of an expression. Returns None if it varies."""
    return None if output.varies else compute_node(output, SampleInputs(count=1), {})[0]


def compute_node(node: Expression, inputs: SampleInputs, known: dict[int, np.ndarray]) -> np.ndarray:
    """Evaluates one expression at all samples at once: (N | 1, C) float32.

    known: values that were computed already, by id; shared branches are computed once.
    """
    value = known.get(id(node))
    if value is None:
        values = [compute_node(a, inputs, known) for a in node.read(inputs)]
        with np.errstate(all="ignore"):
            value = node.compute(inputs, *values).astype(np.float32, copy=False)
        known[id(node)] = value
    return value
