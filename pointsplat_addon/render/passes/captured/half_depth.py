"""The depth at which captured splats have hidden half of the light behind them, in each pixel, for the pass Depth.

What splats in front of a place in their order hide does not depend on their order, and grows from front to back: the
place is found by a search, each step of which draws all splats once and narrows it to a fifth.
"""

from __future__ import annotations

import numpy as np

from ....core.splat.captured import LEAST_ALPHA, MOST_ALPHA
from ....shading.interface import Interface
from ...device.protocol import Device, Texture
from ..translucent.lit_splats import CHUNK, LitSplats
from ..uniforms import SampleView, block

HIDES = block("Hides", (("vec2", "principal_point"), ("vec2", "origin"), ("ivec2", "size"), ("int", "first")))
HALVE = Interface(
    "halve", fragment="captured/halve.frag", samplers=(("FLOAT_2D", "ps_span"), ("FLOAT_2D", "ps_hidden")),
    outputs=(("vec4", "out_span"),),
)  # fmt: skip
PARTS = 5  # of the way between two places


def hides_program(nodes: bool) -> Interface:
    """Returns the program that sums what splats hide. `nodes`: some stand for many."""
    constants = {"PS_MOST_ALPHA": MOST_ALPHA, "PS_LEAST_ALPHA": LEAST_ALPHA}
    names = ("PS_CAPTURED", "PS_CAPTURED_ALONE", "PS_INDEXED", *(("PS_NODES",) if nodes else ()))
    return Interface(
        "hides", vertex="translucent/blend.vert", fragment="captured/hides.frag", block=HIDES,
        samplers=tuple(("FLOAT_2D", f"ps_{name}") for name in ("centre", "shape", "source", "span")),
        varyings=(("flat", "vec4", "v_conic"), ("flat", "vec4", "v_source"), ("flat", "vec2", "v_centre"),
                  ("flat", "float", "v_index")),
        outputs=(("vec4", "out_hidden"),),
        defines=(*((name, repr(value)) for name, value in constants.items()), *((name, "1") for name in names)),
    )  # fmt: skip


def half_depth(device: Device, lit: LitSplats, view: SampleView, nodes: bool) -> np.ndarray:
    """Returns (H, W) float32: depths in a view, of the splat with which half is hidden; infinite where it never is.

    `lit`: with the captured splats of the view, and their planes. `view`: of rays through pixels' centres.
    """
    owned: list = []

    def kept(made):
        owned.append(made)
        return made

    try:
        first, end = lit.count, lit.count + lit.captured
        spans = [kept(device.texture(view.size, "RGBA32F")) for _ in range(2)]
        targets = [kept(device.target([span])) for span in spans]
        hidden = kept(device.texture(view.size, "RGBA32F"))
        sums = kept(device.target([hidden]))
        device.clear(targets[0], (first - 1.0, float(end), 0.0, 0.0))
        length = end - first + 1
        while length > 1:
            device.clear(sums)
            _draw(device, lit, view, sums, spans[0], nodes)
            device.draw(HALVE, targets[1], textures={"ps_span": spans[0], "ps_hidden": hidden})
            spans, targets = spans[::-1], targets[::-1]
            length = -(-length // PARTS)
        found = device.read(spans[0])[..., 0].astype(np.int64)
        return _depths(device, lit, view, found, first)
    finally:
        for item in reversed(owned):
            item.release()


def _draw(device: Device, lit: LitSplats, view: SampleView, target, span: Texture, nodes: bool) -> None:
    program = hides_program(nodes)
    textures = {name: lit.textures[name] for name in ("ps_centre", "ps_shape", "ps_source")} | {"ps_span": span}
    for start in range(lit.count, lit.count + lit.captured, CHUNK):
        record = view.record(program.block, size=view.size, origin=(0.0, 0.0), first=start)  # pyright: ignore[reportArgumentType]
        vertices = 3 * min(CHUNK, lit.count + lit.captured - start)
        device.draw(program, target, uniforms=record, textures=textures, vertices=vertices, blend=True)


def _depths(device: Device, lit: LitSplats, view: SampleView, found: np.ndarray, first: int) -> np.ndarray:
    """Depths (H, W) of the planes of splats `found` (H, W) at pixels' centres; infinite before `first`."""
    centre, front = (device.read(lit.textures[name]).reshape(-1, 4) for name in ("ps_centre", "ps_front"))
    there = found >= first
    which = np.where(there, found, first)
    y, x = np.indices(found.shape) + 0.5
    cx, cy = view.principal_point
    depth = (
        centre[which, 2] + front[which, 1] * (x - cx - centre[which, 0]) + front[which, 2] * (y - cy - centre[which, 1])
    )
    return np.where(there, depth, np.inf).astype(np.float32)
