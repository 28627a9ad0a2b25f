"""Which splats a view by EWA needs, found once for all its samples, before most of them are drawn.

Some of them are drawn for visibility first: those that face the eye, and of these only as many as cover the picture
LAYERS times. `needed` compares every splat with what was seen then. Those of which all lies behind the farthest of what
is nearest within their reach (`open`, maxima over windows as wide as kernels) are neither drawn nor blended; those that
are covered by a surface that they belong to or lie behind are blended alone. Neither is said of splats that have
anything open around them: edges are those of all splats. Where they are thinned this holds of those that face the eye:
so many overlap there that what shows of a back is looked at by some of them.
"""

from __future__ import annotations

import numpy as np

from ....core.numeric.record import value_record
from ....shading.interface import Interface
from ...device.protocol import Device, Target, Texture, releases_on_failure
from ..tiles import TILE
from ..uniforms import SampleView, block

LEAST_SPLATS = 1 << 15  # with fewer there is little to save
CLOSED = (
    1.2091996  # times that disks cover a plane at least, where they leave no holes: 2 pi / sqrt(27) (Kershner 1939)
)
LEAST_TURNED = 1 / 8  # of them that show their backs, or few are hidden
LAYERS = 12.0  # how many times those that are drawn first cover the picture: exp(-12) of it stays open
THIN = 0.5  # share of them below which they are thinned
TOLERANCE = 0.25  # of the depth within which splats are one surface: what is nearer by more is not covered
PROBES = 128  # squared: splats that are measured
FULL = 6.0  # pixels from their middles that kernels reach whose windows are of pixels, not of halves of the picture
WIDER = 0.9  # quantile of the kernels' widths that windows are made for
LOOKED_AT = 2048  # of them, for what is open around them
ENOUGH = 0.5  # share with nothing open around them, below which too few are hidden
HIDDEN, COVERED = 0.0, 1.0  # what shaders/ewa/needed.frag says of a splat

SIZES_BLOCK = block("Sizes", (
    ("vec2", "principal_point"), ("float", "low_pass"),
    ("int", "count"),  # of the listed splats
    ("int", "probes"),  # of them that are measured
))  # fmt: skip
WINDOW_BLOCK = block("Open", (("int", "step"),))  # from one of four texels to the next
NEEDED_BLOCK = block("Needed", (
    ("vec2", "principal_point"), ("ivec2", "size"), ("float", "near"), ("float", "low_pass"),
    ("float", "margin"),  # pixels that samples may move the picture by
    ("float", "tolerance"),  # of the depth within which splats are one surface
    ("int", "window"),  # side of a window in texels of `ps_open`
    ("int", "shift"),  # log2 of the pixels along a side of such a texel
))  # fmt: skip
SIZES = Interface(
    "sizes", fragment="ewa/sizes.frag", block=SIZES_BLOCK, outputs=(("vec4", "out_size"),),
    samplers=(("FLOAT_2D", "ps_list"), ("FLOAT_2D", "ps_splat_centre"), ("FLOAT_2D", "ps_splat_shape")),
)  # fmt: skip
WINDOW = Interface(
    "open",
    fragment="ewa/open.frag",
    block=WINDOW_BLOCK,
    samplers=(("FLOAT_2D", "ps_open"),),
    outputs=(("float", "out_open"),),
)
FIRST = WINDOW.with_defines("PS_FIRST")
NEEDED = Interface(
    "needed", fragment="ewa/needed.frag", block=NEEDED_BLOCK, outputs=(("float", "out_needed"),),
    samplers=tuple(("FLOAT_2D", f"ps_{name}") for name in
                   ("splat_centre", "splat_shape", "splat_front", "nearest", "open")),
)  # fmt: skip
THINNED = NEEDED.with_defines("PS_THIN")


@value_record
class Sizes:
    """Sizes of the splats that face the eye."""

    kernel: float  # half the width in pixels of the wider kernels
    layers: float  # how many times their ellipses cover what they cover of the picture
    middles: np.ndarray  # (N, 2) pixels: of some of them

    @property
    def share(self) -> float:
        """How many of them are drawn first."""
        share = LAYERS / self.layers
        return share if share < THIN else 1.0

    @property
    def thin(self) -> bool:
        return self.share < 1.0

    def pays(self, facing: int, turned: int) -> bool:
        """Whether so many splats that face the eye hide, or cover, enough of all."""
        return self.layers >= CLOSED and (self.thin or turned >= LEAST_TURNED * (facing + turned))


def measure_sizes(
    device: Device, lists: list[tuple[dict[str, Texture], int]], view: SampleView, low_pass: float
) -> Sizes:
    """Measures the splats of a view that face the eye. `lists`: of each page with splats, its textures with the list of
    them, and how many they are."""
    target = device.texture((PROBES, PROBES), "RGBA32F")
    drawn = device.target([target])
    found, weights = [], []
    for textures, total in lists:
        record = view.record(SIZES_BLOCK, count=total, probes=PROBES * PROBES, low_pass=low_pass)
        device.draw(SIZES, drawn, uniforms=record, textures=textures)
        found.append(device.read(target).reshape(-1, 4).copy())
        weights.append(total)
    drawn.release()
    target.release()
    width, height = np.array(view.size, np.int32)
    area = sum(w * f[:, 1].mean(dtype=np.float64) for w, f in zip(weights, found, strict=True))
    columns = int(width) // TILE + 1
    middles = np.concatenate(found)[:, 2:]
    inside = ((middles >= 0) & (middles < (width, height))).all(axis=1)
    column, row = (middles[inside] / TILE).astype(np.int32).T
    tiles = len(np.unique(row * columns + column))
    within = middles[inside]
    kernel = float(np.quantile(np.concatenate([f[:, 0] for f in found]), WIDER))
    return Sizes(kernel, max(area / max(tiles * TILE * TILE, 1), 1e-9), within[:: max(len(within) // LOOKED_AT, 1)])


def closed_share(device: Device, nearest: Texture, sizes: Sizes) -> float:
    """Returns the share of some kernels in which visibility, which left `nearest`, found nothing open."""
    there = device.read(nearest)[..., 0] > 0
    aside = np.linspace(-sizes.kernel, sizes.kernel, int(np.clip(2 * sizes.kernel + 1, 2, 8)))
    height, width = there.shape
    column, row = (
        np.clip(middle[:, None] + aside, 0, last - 1).astype(np.int32)
        for middle, last in zip(sizes.middles.T, (width, height), strict=True)
    )
    found = there[row[:, :, None], column[:, None]].all(axis=(1, 2))
    return float(found.mean()) if len(found) else 0.0


def hashed_share(index: np.ndarray, share: float) -> np.ndarray:
    """Returns a share of the elements (N,), the same in each frame: by a hash, since what is regular in their numbers,
    as rows and spirals are, may be so in their positions."""
    if share >= 1:
        return index
    mixed = index.astype(np.uint32)
    for factor, shift in ((0x7FEB352D, 16), (0x846CA68B, 15)):
        mixed ^= mixed >> np.uint32(shift)
        mixed *= np.uint32(factor)
    return index[mixed < np.uint32(share * 2**32)]


class Cover:
    """What visibility found of the splats that are drawn first."""

    @releases_on_failure
    def __init__(self, device: Device, nearest: Texture, sizes: Sizes, margin: float) -> None:
        """`nearest`: of passes/ewa/ewa.py; `margin`: pixels that samples may move the picture by."""
        self._device, self._nearest, self._margin, self._thin = device, nearest, margin, sizes.thin
        # Narrow kernels look at pixels, wider ones at halves of the picture, which cost a quarter.
        kernel = sizes.kernel + margin
        self._shift = 0 if kernel < FULL else 1
        step = 1 << self._shift
        width, height = nearest.size
        size = -(-width // step), -(-height // step)
        self._textures: list[Texture] = [device.texture(size, "R32F") for _ in range(2)]
        self._targets: list[Target] = [device.target([texture]) for texture in self._textures]
        record = WINDOW_BLOCK.record(step=step)
        device.draw(FIRST, self._targets[0], uniforms=record, textures={"ps_open": nearest})
        self._window = 2 // step
        # Two, side by side, are to hold a kernel.
        while 2 * self._window * step < 2 * kernel + 1 + step:
            record = WINDOW_BLOCK.record(step=self._window)
            device.draw(WINDOW, self._targets[1], uniforms=record, textures={"ps_open": self._textures[0]})
            self._textures.reverse()
            self._targets.reverse()
            self._window *= 2

    def needed(self, splats: dict[str, Texture], view: SampleView, low_pass: float) -> np.ndarray:
        """Returns (elements,) float32, one for each projected splat: HIDDEN, COVERED, or more."""
        device, size = self._device, splats["ps_splat_centre"].size
        out = device.texture(size, "R32F")
        target = device.target([out])
        record = view.record(
            NEEDED_BLOCK,
            window=self._window,
            shift=self._shift,
            margin=self._margin,
            tolerance=TOLERANCE,
            low_pass=low_pass,
        )
        textures = {**splats, "ps_nearest": self._nearest, "ps_open": self._textures[0]}
        device.draw(THINNED if self._thin else NEEDED, target, uniforms=record, textures=textures)
        found = device.read(out).reshape(-1)
        target.release()
        out.release()
        return found

    def release(self) -> None:
        for thing in (*self._targets, *self._textures):
            thing.release()
