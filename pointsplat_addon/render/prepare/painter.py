"""Merges opaque or out-of-focus splats with the translucent layer, so that one draw order holds for all."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...core.lod.cut import Cut
from .point_sets import Layer
from .prepare import Prepared


def with_opaque_among_translucent(prepared: Prepared, keep: bool) -> Prepared:
    """Returns a prepared view whose opaque points are in the translucent layer.

    `keep`: the opaque points also stay in the opaque layer, for passes that read the G-buffer.
    """
    layers = Layer(prepared.point_sets, prepared.set_of_instance, prepared.cut), prepared.translucent
    both = _merged_layers(*layers) if len(layers[1].cut.count) else layers[0]
    if keep:
        return replace(prepared, translucent=both)
    nothing = np.full(len(prepared.set_of_instance), -1)
    return replace(prepared, translucent=both, point_sets={}, set_of_instance=nothing, cut=_merged_cuts([]))


def _merged_layers(a: Layer, b: Layer) -> Layer:
    """Returns two layers of different instances as one; the keys of the second layer's sets follow the first's."""
    shift = max(a.point_sets, default=-1) + 1
    sets = {**a.point_sets, **{key + shift: points for key, points in b.point_sets.items()}}
    other = np.where(b.set_of_instance >= 0, b.set_of_instance + shift, -1)
    set_of_instance = np.where(a.set_of_instance >= 0, a.set_of_instance, other)
    return Layer(sets, set_of_instance, _merged_cuts([a.cut, b.cut]))


def _merged_cuts(cuts: list[Cut]) -> Cut:
    """Returns cuts of different instances as one, sorted by instance."""
    empty = np.empty(0, np.int32), np.empty(0, np.int64), np.empty(0, np.int64)
    names = ("instance", "first", "count")
    instance, first, count = (
        np.concatenate([none, *(getattr(cut, name) for cut in cuts)]) for name, none in zip(names, empty, strict=True)
    )
    order = np.argsort(instance, kind="stable")
    nodes, points, culled = (sum(getattr(cut, name) for cut in cuts) for name in ("nodes", "points", "culled"))
    return Cut(instance[order], first[order], count[order], nodes, points, culled)


def with_defocus_among_translucent(prepared: Prepared) -> Prepared:
    """Returns a prepared view whose translucent layer also holds the splats that are out of focus."""
    out_of_focus_layer = prepared.out_of_focus
    assert out_of_focus_layer is not None
    both = (
        _merged_layers(out_of_focus_layer, prepared.translucent)
        if len(prepared.translucent.cut.count)
        else out_of_focus_layer
    )
    return replace(prepared, translucent=both, shares=out_of_focus_layer.shares)
