"""Translucent splats: lit for a view, then drawn back to front over the opaque picture of every sample.

A page holds the splats of all translucent point sets, one texel a splat:
  place           xyz relative to the set's origin; packed normal (-1: a ball)
  extent          half-axes (major, minor), packed major axis, material row
  optics          media: extinction per object unit, half-axis along the normal, 1 (voxels: 2); shells: optical depth of
                  the splat's own area, half-axis along the normal, 0; opaque splats: the same, -1; row of
                  core.kernel.PROFILES
  color           base colour of shells, albedo of media          \\
  surface         roughness, metallic                              |
  emission        shells: radiance; media: radiance per unit       | where any set has them
  tint            extinction by channel over `optics`' first       |
  shading_normal  packed normal, -1: none                         /
The draw list, sorted, holds two floats a splat: column + 4096 (row % 4096), and 4 instance + row / 4096.

What lighting leaves of each splat of the list, one texel each:
  place   centre in pixels from the principal point, depth, optical depth at the centre
  shape   covariance in pixels^2 (xx, xy, yy)
  source  radiance of what is opaque in it (rgb): the splat's is this times 1 - T; the kernel's row k, -1 - k where
          the splat only cuts a hole
  front   standard deviation of depth along a ray, change of depth per pixel (x, y); where something opaque is drawn
  tint    as above
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ...core.scene.cloud import PointCloud
from ...core.scene.materials import MaterialTable
from ...core.splat import painter
from ...core.splat.kernel import PEAK, PROFILES, SUPPORT
from ...shading.interface import Interface
from ..cache.keys import Key
from ..device.packing import PAGE_WIDTH
from ..device.protocol import Device, Target, Texture, undone, whole
from ..prepare.point_sets import PointSet
from .common import FRAME
from .pages import SplatPage, extent, filled, place, shading_normal
from .shade import MOST_LAMP_POINTS, lighting_defines, lighting_samplers

OPAQUE = 100.0  # optical depth of what is opaque
CHUNK = 1 << 17  # splats of one draw: Blender wants a vertex buffer, if an empty one, of six vertices for each
COARSE = 2  # pixels of the picture along a side of the coarse one's
MOST_REACHED = 4  # lights whose shares are kept
MOST_KEPT = 7  # points of wide lamps whose shares are kept
CHANNELS = ("R", "GA", "B")  # drawn one after the other where extinction is coloured


@dataclass(frozen=True)
class TranslucentOptions:
    """What translucent splats have beyond geometry and optical depth."""

    media: bool = False  # some fill a volume
    color: bool = False
    surface: bool = False
    emission: bool = False
    tint: bool = False  # some extinction differs between the channels
    shading_normal: bool = False
    kernels: bool = False  # some have another kernel than the default
    holdout: bool = False  # some cut holes
    opaque: bool = False  # something opaque may hide them
    fuzzy: bool = False  # some are opaque: core/splat/painter.py
    cull: bool = False  # and some of these are not drawn where they show their backs
    apart: bool = False  # and some of these stand apart: core/lod/foliage.py
    defocus: bool = False  # for the pass of what is out of focus: passes/defocus.py
    strands: bool = False  # some of these splats are pieces of strands: core/lens/strand_splats.py

    @property
    def attributes(self) -> tuple[tuple[str, bool], ...]:
        names = ("color", "surface", "emission", "tint", "shading_normal")
        return tuple((name, getattr(self, name)) for name in names)


def options(
    clouds: list[PointCloud], table: MaterialTable, opaque: bool, holdout: bool = False, defocus: bool = False
) -> TranslucentOptions:
    """What these clouds need. `opaque`: something opaque is drawn, too. `holdout`: an instance of them cuts a hole.
    `defocus`: for what is out of focus."""
    fuzzy = any(is_fuzzy(c) for c in clouds)
    return TranslucentOptions(
        media=any(c.extinction is not None for c in clouds),
        color=any(c.color is not None for c in clouds),
        surface=any(c.surface is not None for c in clouds),
        emission=any(c.emission is not None for c in clouds)
        or (any(c.extinction is None for c in clouds) and bool((table.emission > 0).any())),
        tint=any(c.extinction is not None and c.extinction.ndim == 2 for c in clouds),
        shading_normal=any(c.shading_normal is not None for c in clouds),
        kernels=not defocus and any(c.kernel is not None for c in clouds),
        holdout=holdout,
        opaque=opaque,
        fuzzy=fuzzy,
        cull=fuzzy and bool(table.cull.any()),
        apart=not defocus and any(is_fuzzy(c) and c.apart is not None for c in clouds),
        defocus=defocus,
        strands=defocus and any(is_fuzzy(c) and c.kernel is not None for c in clouds),
    )


def is_fuzzy(cloud: PointCloud) -> bool:
    """Whether the splats of a cloud are opaque, but for their rims."""
    return cloud.extinction is None and cloud.opacity is None


class TranslucentPage(SplatPage):
    """Translucent splats on the device."""

    def __init__(
        self,
        device: Device,
        sets: list[PointSet],
        options: TranslucentOptions,
        table: MaterialTable,
        shares: Mapping[Key, np.ndarray | float] | None = None,
    ) -> None:
        """`shares`: by key, what of its ellipse each opaque splat covers; with `options.defocus`."""
        super().__init__(device, sets)
        clouds = self.clouds
        if not options.defocus:
            clouds = [_reaching(c, len(points.cloud)) for c, points in zip(clouds, sets, strict=True)]
        self.clouds = clouds
        if options.defocus and options.fuzzy:
            held = [(shares or {}).get(points.key, 1.0) for points in sets]
            self.upload("share", "R32F", 1, [
                np.broadcast_to(np.float32(share), len(cloud)) for share, cloud in zip(held, clouds, strict=True)
            ])  # fmt: skip
        self.upload("place", "RGBA32F", 4, [place(c) for c in clouds])
        self.upload("extent", "RGBA32F", 4, [extent(c, always_axis=True) for c in clouds])
        self.upload("optics", "RGBA32F", 4, [
            _optics(c, points.is_lattice) for c, points in zip(clouds, sets, strict=True)
        ])  # fmt: skip
        if options.color:
            self.upload("color", "RGBA16F", 4, [filled(c, "color", table.base_color) for c in clouds])
        if options.surface:
            constants = np.stack([table.roughness, table.metallic], axis=1)
            self.upload("surface", "RG32F", 2, [filled(c, "surface", constants) for c in clouds])
        if options.emission:
            dark = np.zeros_like(table.emission)
            self.upload("emission", "RGBA32F", 4, [
                filled(c, "emission", table.emission if c.extinction is None else dark) for c in clouds
            ])  # fmt: skip
        if options.tint:
            self.upload("tint", "RGBA16F", 4, [_tint(c) for c in clouds])
        if options.shading_normal:
            self.upload("shading_normal", "R32F", 1, [shading_normal(c) for c in clouds])
        self.clouds = []


def _reaching(cloud: PointCloud, points: int) -> PointCloud:
    """A page's splats of one set. Nodes of opaque surfaces, which follow after the points, reach the corners of what
    they stand for, as points do."""
    if not is_fuzzy(cloud) or len(cloud) == points or cloud.radii is None:
        return cloud
    radii = cloud.radii.copy()
    closed = True if cloud.apart is None else ~cloud.apart[points:, None]
    np.multiply(radii[points:], np.float32(painter.NODE_REACH), out=radii[points:], where=closed)
    return replace(cloud, radii=radii)


def _optics(cloud: PointCloud, lattice: bool) -> np.ndarray:
    rows = np.zeros((len(cloud), 4), np.float32)
    if cloud.extinction is not None:
        rows[:, 0] = _strength(cloud.extinction)
        rows[:, 2] = 2.0 if lattice else 1.0
        if cloud.radii is not None:
            thick = cloud.normal is not None and cloud.radii.shape[1] == 3
            # A flat splat of a medium stands for a slab as thick as it is wide.
            rows[:, 1] = (
                cloud.radii[:, 2] if thick else np.sqrt(np.abs(cloud.radii[:, 0])) * np.sqrt(np.abs(cloud.radii[:, -1]))
            )
    elif cloud.opacity is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            depth = -np.log1p(-np.clip(cloud.opacity.astype(np.float64), 0, 1))
        rows[:, 0] = np.minimum(depth, OPAQUE)
    else:
        # The peak of a kernel is twice what its splat has over its own area.
        rows[:, 0], rows[:, 2] = painter.DEPTH / (2 * PEAK), -1.0
    if cloud.extinction is None and cloud.radii is not None and cloud.radii.shape[1] == 3:
        # Coarse nodes of surfaces that do not lie in a plane, as of a tree's leaves.
        rows[:, 1] = cloud.radii[:, 2]
    if cloud.kernel is not None:
        rows[:, 3] = np.where(cloud.kernel < len(PROFILES), cloud.kernel, 0)
    return rows


def _strength(extinction: np.ndarray) -> np.ndarray:
    """(N,) what the channels are relative to."""
    return extinction if extinction.ndim == 1 else extinction.max(axis=1)


def _tint(cloud: PointCloud) -> np.ndarray:
    if cloud.extinction is None or cloud.extinction.ndim == 1:
        return np.ones((len(cloud), 3), np.float32)
    positive = np.maximum(cloud.extinction, 0)
    return positive / np.maximum(_strength(positive), np.finfo(np.float32).tiny)[:, None]


def draw_list(texel: np.ndarray, instance: np.ndarray) -> np.ndarray:
    """(N, 2) float32 of splats' places in the page, counted texel by texel, and their instances."""
    rows = np.empty((len(texel), 2), np.float32)
    rows[:, 0] = texel & (PAGE_WIDTH * PAGE_WIDTH - 1)
    rows[:, 1] = 4 * instance.astype(np.int64) + (texel >> 24)
    return rows


def light_program(
    options: TranslucentOptions, lighting: tuple[str, ...], materials: tuple[str, ...], reached: int = 0
) -> Interface:
    """Every splat of the draw list, lit. `reached`: of so many lights the share that reaches each splat is known."""
    colored = "PS_SHADOW_COLORED" in lighting
    known: tuple[tuple[str, str], ...] = ()
    if reached:
        lighting = tuple(name for name in lighting if not name.startswith("PS_SHADOW"))
        known = ("PS_REACHED", str(reached)), *((("PS_REACHED_COLORED", "1"),) if colored else ())
    read = ("order", "instances", "place", "extent", "optics", "materials")
    read += tuple(name for name, on in options.attributes if on)
    read += ("share",) if options.defocus and options.fuzzy else ()
    read += tuple(f"reach_{i}" for i in range(_reach_textures(reached, colored)))
    named = {"PS_MEDIA": options.media, "PS_AMONG_OPAQUE": options.opaque and not options.defocus}
    named |= {"PS_KERNELS": options.kernels, "PS_HOLDOUT": options.holdout, "PS_CULL": options.cull}
    named |= {"PS_FUZZY_APART": options.apart, "PS_DEFOCUS": options.defocus, "PS_LINES": options.strands}
    named |= {f"PS_{name.upper()}": on for name, on in options.attributes}
    outputs = [
        "place",
        "shape",
        "source",
        *(["front"] if options.opaque and not options.defocus else []),
        *(["tint"] if options.tint else []),
    ]
    return Interface(
        "light", fragment="translucent/light.frag", block=FRAME,
        samplers=(*(("FLOAT_2D", f"ps_{name}") for name in read), *lighting_samplers(lighting)),
        outputs=tuple(("vec4", f"out_{name}") for name in outputs),
        defines=(*lighting_defines(lighting), *known, *_fuzzy_defines(options, lighting),
                 *((name, "1") for name in (*materials, *(name for name, on in named.items() if on)))),
    )  # fmt: skip


def reach_program(options: TranslucentOptions, lighting: tuple[str, ...], lights: int) -> Interface:
    """The share of each light that reaches every splat of a page, by a list of all of them in their own order."""
    colored = "PS_SHADOW_COLORED" in lighting
    read = ("order", "instances", "place", "extent", "optics", "materials")
    read += ("shading_normal",) if options.shading_normal else ()
    defines = (*_fuzzy_defines(options, lighting), *((("PS_SHADING_NORMAL", "1"),) if options.shading_normal else ()))
    return Interface(
        "reach", fragment="translucent/light.frag", block=FRAME,
        samplers=(*(("FLOAT_2D", f"ps_{name}") for name in read), *lighting_samplers(lighting)),
        outputs=tuple(("vec4", f"out_reach_{i}") for i in range(_reach_textures(lights, colored))),
        defines=(*lighting_defines(lighting), ("PS_REACH", str(lights)), *defines),
    )  # fmt: skip


def _fuzzy_defines(options: TranslucentOptions, lighting: tuple[str, ...]) -> tuple[tuple[str, str], ...]:
    """One point of each wide lamp a sample is enough for splats that overlap, and blur what they receive; opaque ones
    do not."""
    points = MOST_LAMP_POINTS if options.fuzzy else 1
    taps = (("PS_SHADOW_TAPS", str(points)),) if "PS_SHADOWS" in lighting else ()
    narrow = float(np.sqrt(4 * painter.SUPPORT / SUPPORT))
    return (*taps, *((("PS_FUZZY", repr(narrow)),) if options.fuzzy else ()))


def _reach_textures(lights: int, colored: bool) -> int:
    """Shares without a colour of all lights lie in one."""
    return lights if colored else min(lights, 1)


class Reach:
    """How much of each light reaches the splats of a page: the same for all cameras."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._key: tuple = ()
        self._kept: dict[int, tuple[Target, dict[str, Texture]]] = {}  # all points from MOST_KEPT on share one
        self._taps: dict[int, int] = {}  # which point of wide lamps each is of

    def textures(
        self, key: tuple, tap: int, program: Interface, size: tuple[int, int], light: Callable[[Target], None]
    ) -> dict[str, Texture]:
        """By sampler name. `light` draws them where they are not known for `key`."""
        if key != self._key:
            self.release()
            self._key = key
        slot = min(tap, MOST_KEPT)
        if slot not in self._kept:
            with undone(self.device):
                textures = {
                    name.replace("out_", "ps_"): self.device.texture(size, "RGBA16F") for _, name in program.outputs
                }
                self._kept[slot] = self.device.target(list(textures.values())), textures
        target, textures = self._kept[slot]
        if self._taps.get(slot) != tap:
            light(target)
            self._taps[slot] = tap
        return textures

    def release(self) -> None:
        for target, textures in self._kept.values():
            target.release()
            for texture in textures.values():
                texture.release()
        self._kept.clear()
        self._taps.clear()


def draw_program(options: TranslucentOptions, channel: str) -> Interface:
    """Splats over the picture. `channel`: one of CHANNELS, or "" where all are alike."""
    read = ["place", "shape", "source", *(["front", "depth"] if options.opaque else [])]
    varyings = [("flat", "vec4", "v_conic"), ("flat", "vec4", "v_source"), ("flat", "vec2", "v_centre")]
    defines = []
    if options.opaque:
        varyings.append(("flat", "vec4", "v_front"))
        defines.append(("PS_AMONG_OPAQUE", "1"))
    if options.kernels:
        read.append("profiles")
        defines += [("PS_KERNELS", "1"), ("PS_PROFILE_STEPS", str(PROFILES.shape[1]))]
    outputs = [("vec4", "out_color")]
    if options.holdout:
        outputs.append(("vec4", "out_cut"))
        defines.append(("PS_HOLDOUT", "1"))
    if channel:
        read.append("tint")
        defines.append(("PS_CHANNEL", str("RGB".index(channel[0]))))
    return Interface(
        "translucent", vertex="translucent/blend.vert", fragment="translucent/blend.frag", block=FRAME,
        samplers=tuple(("FLOAT_2D", f"ps_{name}") for name in read),
        varyings=tuple(varyings), outputs=tuple(outputs), defines=tuple(defines),
    )  # fmt: skip


def depth_program(samplers: tuple[tuple[str, str], ...], normal: bool) -> Interface:
    """Depth of the opaque surface under each pixel's centre."""
    return Interface(
        "opaque depth", fragment="translucent/depth.frag", block=FRAME, samplers=samplers,
        outputs=(("float", "out_depth"),), defines=(("PS_NORMAL", "1"),) if normal else (),
    )  # fmt: skip


# The coarse picture of a view that moves, over the fine one.
ENLARGE = Interface(
    "enlarge", fragment="translucent/enlarge.frag", block=FRAME, samplers=(("FLOAT_2D", "ps_coarse"),),
    outputs=(("vec4", "out_color"),),
)  # fmt: skip


def add_program(options: TranslucentOptions) -> Interface:
    """One sample's picture to the sums."""
    return Interface(
        "add", fragment="translucent/add.frag", block=FRAME,
        samplers=(("FLOAT_2D", "ps_layer"), *((("FLOAT_2D", "ps_cut"),) if options.holdout else ())),
        outputs=(("vec4", "out_combined"),), defines=(("PS_HOLDOUT", "1"),) if options.holdout else (),
    )  # fmt: skip


class LitSplats:
    """The draw list of one view after lighting, and the draws that read it."""

    @whole
    def __init__(
        self, device: Device, options: TranslucentOptions, program: Interface, count: int, samples: int = 1
    ) -> None:
        """`samples`: of the picture. DeviceError: more splats than a texture holds."""
        self.device, self.count, self.program, self.samples = device, count, program, samples
        size = (PAGE_WIDTH, max(1, -(-count // PAGE_WIDTH)))
        self.textures: dict[str, Texture] = {}
        for _, name in program.outputs:
            format = "RGBA16F" if name == "out_tint" else "RGBA32F"
            self.textures[name.replace("out_", "ps_")] = device.texture(size, format)
        self.target: Target = device.target(list(self.textures.values()))
        self._profiles: dict[str, Texture] = {}
        if options.kernels:
            kernels, steps = PROFILES.shape
            self._profiles["ps_profiles"] = device.texture((steps, kernels), "R32F", PROFILES.reshape(-1))
        channels = () if options.defocus else CHANNELS if options.tint else ("",)
        self.draws = [(draw_program(options, channel), channel or "RGBA") for channel in channels]

    def light(self, record: np.ndarray, textures: Mapping[str, Texture]) -> None:
        """Light all of them, seen from the middle of the pixel."""
        record["page"][0, 1] = self.count
        record["mist"][0, 3] = 1 / self.samples**2
        self.device.draw(self.program, self.target, uniforms=record, textures=dict(textures))

    def draw(self, target: Target, record: np.ndarray, depth: Texture | None, pixels: int = 1) -> None:
        """Over what `target` holds, of which a pixel spans `pixels` of the picture; `depth` is that of what is opaque,
        in pixels of the picture."""
        record["lens"][0, 3] = 1 / pixels
        record["size"][0, :2] = target.colors[0].size
        textures = {**self.textures, **self._profiles, **({} if depth is None else {"ps_depth": depth})}
        for program, mask in self.draws:
            for first in range(0, self.count, CHUNK):
                record["page"][0, 0] = first
                vertices = 6 * min(CHUNK, self.count - first)
                self.device.draw(
                    program, target, uniforms=record, textures=textures, vertices=vertices, over=True, mask=mask
                )

    def release(self) -> None:
        self.target.release()
        for texture in (*self.textures.values(), *self._profiles.values()):
            texture.release()
