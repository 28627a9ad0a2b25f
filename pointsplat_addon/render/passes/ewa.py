"""EWA splatting: splats as elliptical Gaussians that are blended and normalised (Zwicker et al. 2001, Ren et al. 2002).

Four passes. `splats` projects every splat once for all samples of a view; then, sample by sample, `visibility` finds
the nearest surface under each pixel's centre, `blend` adds up the attributes of all splats of that surface, weighted by
their kernels, and `normalise` divides by the sum of the weights, into the G-buffer that polygons and spheres share.

What `splats` leaves of each drawn element, one texel each:
  place     centre in pixels from the principal point; depth; 1 + 2 instance (small), 2 + 2 instance (large), 0: not
            drawn; negative where the splat shows its back
  shape     covariance in pixels^2 (xx, xy, yy) without low-pass, its rim at 2 sigma; material (-1 - m: a holdout)
  front     change of depth per pixel (x, y); share of the ellipse that the splat stands for; depth within which it is
            one surface with others
  normal    in view space, (0, 0, 0) for a ball; roughness   \\
  color     base colour, metallic                            | where the G-buffer has them
  emission                                                   /
What `visibility` leaves of each pixel: depth beyond the near plane (0: nothing), depth up to which splats belong to it,
material, 2 instance (and 1 where it shows its back).
What `blend` sums, times weights: depth, material, 1 for front faces, 1; normal; color; emission.

Small splats are squares around points, projected affinely. Large ones are rectangles, whose fragments meet the splat's
plane exactly; only views that may have any draw them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core.scene.camera import Camera
from ...core.splat.ewa import centres_decide, low_pass
from ...shading.interface import Interface
from ..device.packing import PAGE_WIDTH, paged
from ..device.protocol import Device, Target, Texture, whole
from . import ewa_cover
from .common import FRAME, GBuffer, Variant
from .points import PageDraw, PointOptions, attributes
from .tiles import TILE, Region

WIDEST_POINT = 32.0  # pixels of radius up to which shaders/ewa/project.frag calls splats small
AFFINE_ERROR = 0.1  # pixels, as there
NODE_RIM = 6.0  # squared Mahalanobis distance, beyond CUTOFF: shaders/lib/splat/ewa.glsl
JITTER = 1.0  # pixels that samples shift the picture by at most
CHUNK = 1 << 20  # splats of one draw; Blender wants a vertex buffer, if an empty one, for all its vertices
ATTRIBUTES = ("normal", "color", "emission")  # of the G-buffer, that are blended


@dataclass(frozen=True)
class EwaOptions:
    """What a view's splats need beyond PointOptions."""

    low_pass: float  # pixels^2: core.ewa.low_pass
    hard: bool  # core.ewa.centres_decide
    balls: bool = False  # some have no normal
    large: bool = False  # some may be wide, or near

    def reach(self, largest: float) -> float:
        """Pixels from the centre to the end of the kernel of splats that are drawn as points, of at most the radius
        `largest`; wider ones are drawn wherever their centres are."""
        return math.sqrt(NODE_RIM * (min(largest, WIDEST_POINT) ** 2 / 4 + self.low_pass))


def options(camera: Camera, largest: float, balls: bool, samples: int) -> EwaOptions:
    """`largest`: bound of the splats' radii in pixels. A rim's projection errs by its radius times the share of the
    depth that it extends over, at most the radius squared over the focal length in pixels."""
    focal = min(abs(f) for f in camera.pixel_from_view()[:2])
    affine = math.sqrt(AFFINE_ERROR * focal) if camera.perspective else math.inf
    wide = not largest <= min(WIDEST_POINT, affine)
    return EwaOptions(low_pass(samples), centres_decide(samples), balls, wide)


@dataclass(frozen=True)
class EwaPrograms:
    """Interfaces of one variant."""

    splats: Interface
    visibility: tuple[Interface, ...]  # of small splats, and of large ones
    blend: tuple[Interface, ...]
    normalise: Interface


def programs(variant: Variant, points: PointOptions, ewa: EwaOptions) -> EwaPrograms:
    """The programs of one variant."""
    named = tuple((name, "1") for name in variant.defines if name != "PS_OWNER")
    flags = {"PS_CULL": points.cull, "PS_ELLIPSES": points.ellipses}
    flagged = tuple((name, "1") for name, on in flags.items() if on)
    samplers, defines = attributes(variant, points)
    cull = (("FLOAT_2D", "ps_materials"),) if points.cull else ()
    blended = _blended(variant)
    splats = Interface(
        "splats", fragment="ewa/project.frag", block=FRAME, samplers=(*samplers, *cull),
        outputs=tuple(("vec4", f"out_{name}") for name in ("place", "shape", "front", *blended)),
        defines=(*named, *flagged, *defines),
    )  # fmt: skip
    hard = (("PS_HARD", "1"),) if ewa.hard else ()
    normalise = Interface(
        "normalise", fragment="ewa/normalise.frag", block=FRAME,
        samplers=tuple(("FLOAT_2D", name) for name in ("ps_nearest", *(f"ps_sum_{n}" for n in ("place", *blended)))),
        outputs=variant.front_outputs, depth=points.depth,
        defines=(*variant.front_defines, *((("PS_DEPTH", "1"),) if points.depth else ()), *hard),
    )  # fmt: skip
    kinds = (False, True) if ewa.large else (False,)
    return EwaPrograms(
        splats,
        tuple(_drawn(variant, points, ewa, False, large) for large in kinds),
        tuple(_drawn(variant, points, ewa, True, large) for large in kinds),
        normalise,
    )


def _blended(variant: Variant) -> tuple[str, ...]:
    return tuple(name for name, _, _ in variant.channels if name in ATTRIBUTES)


def _drawn(variant: Variant, points: PointOptions, ewa: EwaOptions, blend: bool, large: bool) -> Interface:
    """Splats on the screen: `blend` their kernels, else their ellipses."""
    blended = _blended(variant) if blend else ()
    samplers = [
        ("FLOAT_2D", name) for name in ("ps_list", *(f"ps_splat_{n}" for n in ("place", "shape", "front", *blended)))
    ]
    names = ["v_place", "v_conic", "v_front", "v_material", *(f"v_{name}" for name in blended)]
    defines: list[tuple[str, str]] = []
    if blend:
        samplers.append(("FLOAT_2D", "ps_nearest"))
        defines += [("PS_BLEND", "1"), *((name, "1") for name in variant.defines if name != "PS_OWNER")]
        defines += [("PS_BALLS", "1")] if ewa.balls and variant.normal else []
        defines += [("PS_HARD", "1")] if ewa.hard else []
        outputs = tuple(("vec4", f"out_{name}") for name in ("place", *blended))
    else:
        outputs = (("vec4", "out_nearest"),)
    if large:
        pages = ("ps_blocks", "ps_place", "ps_extent", *(() if points.one_instance else ("ps_instances",)))
        samplers += [("FLOAT_2D", name) for name in pages]
        names += ["v_u", "v_v", "v_plane"]
        flags = {"PS_LARGE": True, "PS_ELLIPSES": points.ellipses, "PS_ONE_INSTANCE": points.one_instance}
        defines += [(name, "1") for name, on in flags.items() if on]
    return Interface(
        "blend" if blend else "visibility",
        vertex="ewa/large.vert" if large else "ewa/blend.vert",
        fragment="ewa/blend.frag", block=FRAME, samplers=tuple(samplers),
        varyings=tuple(("flat", "vec4", name) for name in names),
        outputs=outputs, defines=tuple(defines), depth=not blend,
    )  # fmt: skip


class Splats:
    """The projected splats of one page of one view."""

    @whole
    def __init__(self, device: Device, program: Interface, draw: PageDraw) -> None:
        """DeviceError: more splats than a texture holds."""
        self.draw = draw
        size = (PAGE_WIDTH, max(1, -(-draw.elements // PAGE_WIDTH)))
        exact = ("out_place", "out_shape", "out_front")
        self.textures: dict[str, Texture] = {
            name.replace("out_", "ps_splat_"): device.texture(size, "RGBA32F" if name in exact else "RGBA16F")
            for _, name in program.outputs
        }
        self.target: Target = device.target(list(self.textures.values()))
        # Elements, by list: small splats that visibility draws "first" and "then"; those that are "blended", where that
        # is not all of them; "large" ones for both.
        self.found: dict[str, np.ndarray] = {}
        self.lists: dict[str, tuple[Texture, int]] = {}  # their texels, and how many
        self._corner = np.zeros(2, np.float32)  # of the picture from the principal point, in pixels

    def find(self, device: Device, record: np.ndarray, margin: float) -> None:
        """Find the splats that are drawn: not the small ones that lie `margin` pixels outside the picture, since
        vertices cost more than looking once which of them are needed. Those that show their backs come second."""
        x, y, _, kind = device.read(self.textures["ps_splat_place"]).reshape(-1, 4).T
        self._corner = -record["focal"][0, 2:]
        odd = np.abs(kind).astype(np.int32) & 1 == 1
        small, turned = odd.copy(), kind < 0
        for at, low, size in zip((x, y), self._corner, record["size"][0, :2], strict=True):
            small &= (at > low - margin) & (at < low + size + margin)
        first, then = np.flatnonzero(small & ~turned), np.flatnonzero(small & turned)
        self.found = {"first": first, "then": then, "large": np.flatnonzero(~odd & (kind != 0))}

    def keep(self, first: np.ndarray, needed: np.ndarray) -> None:
        """Of what was found, visibility drew `first`; `needed`, of each element: what shaders/ewa/needed.frag says."""
        small = np.concatenate([self.found["first"], self.found["then"]])
        drawn = np.zeros(len(needed), bool)
        drawn[first] = True
        then = small[(needed[small] > ewa_cover.COVERED) & ~drawn[small]]
        first = first[needed[first] > ewa_cover.HIDDEN]
        self.found |= {"first": first, "then": then, "blended": small[needed[small] > ewa_cover.HIDDEN]}

    def list_first(self, device: Device, index: np.ndarray) -> None:
        """List these elements as those that visibility draws first."""
        if "first" in self.lists:
            self.lists.pop("first")[0].release()
        self.lists["first"] = listed(device, index)

    def list_found(self, device: Device, tiles: np.ndarray | None = None) -> None:
        """List what was found; of small splats only those whose middles lie in the tiles (rows, columns) bool."""
        self._release_lists()
        within = None if tiles is None else self._within(device, tiles)
        for name, index in self.found.items():
            shown = index if within is None or name == "large" else index[within[index]]
            self.lists[name] = listed(device, shown)

    def _within(self, device: Device, tiles: np.ndarray) -> np.ndarray:
        middle = device.read(self.textures["ps_splat_place"]).reshape(-1, 4)[:, :2] - self._corner
        rows, columns = tiles.shape
        column, row = np.clip(middle / TILE, 0, (columns - 1, rows - 1)).astype(np.int32).T
        return tiles[row, column]

    def _release_lists(self) -> None:
        for texture, _ in self.lists.values():
            texture.release()
        self.lists.clear()

    def release(self) -> None:
        self._release_lists()
        self.target.release()
        for texture in self.textures.values():
            texture.release()


def listed(device: Device, index: np.ndarray) -> tuple[Texture, int]:
    """The texels of elements (N,), and how many they are."""
    size, data = paged(np.stack([index % PAGE_WIDTH, index // PAGE_WIDTH], axis=1), 2)
    return device.texture(size, "RG32F", data), len(index)


class Ewa:
    """From the splats of a view to a G-buffer: the textures between them."""

    def __init__(
        self, device: Device, variant: Variant, points: PointOptions, ewa: EwaOptions, size: tuple[int, int]
    ) -> None:
        self.device, self.options, self.size = device, ewa, size
        self.programs = programs(variant, points, ewa)
        self.nearest = device.texture(size, "RGBA32F")
        self.nearest_target: Target = device.target([self.nearest], depth=True)
        self.sums: dict[str, Texture] = {
            f"ps_sum_{name}": device.texture(size, "RGBA32F") for name in ("place", *_blended(variant))
        }
        self.sum_target: Target = device.target(list(self.sums.values()))
        self._splats: list[Splats] = []
        self.draws: list[PageDraw] | None = None  # of which the splats are projected
        self._mask: Texture | None = None  # of the region that they are listed for
        self._left = False  # some are left out
        self._begun = False  # visibility has drawn what comes first

    def project(self, draws: list[PageDraw], record: np.ndarray, shared: dict[str, Texture]) -> None:
        """Project the splats of a view and list those that are drawn; `record`: of the sample that is drawn next."""
        self._forget()
        self.draws = draws
        record["lens"][0, 3] = self.options.low_pass
        for draw in draws:
            splats = Splats(self.device, self.programs.splats, draw)
            self._splats.append(splats)
            textures = {**shared, **draw.page.textures, "ps_blocks": draw.blocks}
            self.device.draw(self.programs.splats, splats.target, uniforms=draw.fill(record), textures=textures)
            splats.find(self.device, record, self.options.reach(WIDEST_POINT) + JITTER)
        self._leave_out(record, shared)
        for splats in self._splats:
            splats.list_found(self.device)

    def _leave_out(self, record: np.ndarray, shared: dict[str, Texture]) -> None:
        """Of many splats, leave out those that passes/ewa_cover.py finds not needed."""
        device = self.device
        facing, turned = (sum(len(splats.found[name]) for splats in self._splats) for name in ("first", "then"))
        if facing == 0 or facing + turned < ewa_cover.LEAST_SPLATS:
            return
        record["lens"][0, 3] = self.options.low_pass
        for splats in self._splats:
            splats.list_first(device, splats.found["first"])
        pages = [({**splats.textures, "ps_list": texture}, total)
                 for splats in self._splats for texture, total in (splats.lists["first"],) if total]  # fmt: skip
        sizes = ewa_cover.measure(device, pages, record)
        if not sizes.pays(facing, turned):
            return
        drawn = [ewa_cover.thinned(splats.found["first"], sizes.share) for splats in self._splats]
        if sizes.thin:
            for splats, index in zip(self._splats, drawn, strict=True):
                splats.list_first(device, index)
        device.clear(self.nearest_target)
        self._see(("first",), record, shared)
        if ewa_cover.closed(device, self.nearest, sizes) < ewa_cover.ENOUGH:
            self._begun = not sizes.thin
            return
        margin = 0.0 if self.options.low_pass == 1 else JITTER
        cover = ewa_cover.Cover(device, self.nearest, sizes, margin, record)
        for splats, index in zip(self._splats, drawn, strict=True):
            splats.keep(index, cover.needed(splats.textures, record))
        cover.release()
        self._begun = self._left = True

    def narrow(self, region: Region) -> None:
        """List the splats for what `region` shows; it names tiles as far around as kernels reach."""
        if region.mask is self._mask:
            return
        self._mask = region.mask
        tiles = None if region.mask is None else self.device.read(region.mask)[..., 0] != 0
        for splats in self._splats:
            splats.list_found(self.device, tiles)

    def see(self, record: np.ndarray, shared: dict[str, Texture]) -> None:
        """The nearest surface under each pixel's centre."""
        if not self._begun:
            self.device.clear(self.nearest_target)
            self._see(("first",), record, shared)
        self._begun = False
        self._see(("then", "large"), record, shared)

    def _see(self, names: tuple[str, ...], record: np.ndarray, shared: dict[str, Texture]) -> None:
        self._draw(self.programs.visibility, names, self.nearest_target, record, shared, depth_test=True)

    def blend(self, record: np.ndarray, shared: dict[str, Texture]) -> None:
        """Attributes of that surface's splats times their kernels."""
        self.device.clear(self.sum_target)
        textures = {**shared, "ps_nearest": self.nearest}
        names = ("blended",) if self._left else ("first", "then")
        self._draw(self.programs.blend, (*names, "large"), self.sum_target, record, textures, blend=True)

    def normalise(self, record: np.ndarray, out: GBuffer, region: Region) -> None:
        """Sums over weights, into the G-buffer; pixels that nothing reaches stay as they are."""
        program = self.programs.normalise
        textures = {**self.sums, "ps_nearest": self.nearest}
        region.draw(self.device, program, out.target, uniforms=record, textures=textures, depth_test=program.depth)

    def _draw(
        self,
        kinds: tuple[Interface, ...],
        names: tuple[str, ...],
        target: Target,
        record: np.ndarray,
        shared: dict[str, Texture],
        depth_test: bool = False,
        blend: bool = False,
    ) -> None:
        """Draw lists of splats; `kinds`: programs of small ones and, where there are any, of large ones."""
        record["lens"][0, 3] = self.options.low_pass
        for splats in self._splats:
            draw = splats.draw
            textures = {**shared, **draw.page.textures, "ps_blocks": draw.blocks, **splats.textures}
            draw.fill(record)
            for name in names:
                large = name == "large"
                if name not in splats.lists or large >= len(kinds):
                    continue
                textures["ps_list"], total = splats.lists[name]
                for first in range(0, max(total, 1), CHUNK):
                    record["page"][0, 0] = first
                    count = min(CHUNK, total - first)
                    self.device.draw(
                        kinds[large], target, uniforms=record, textures=textures, vertices=count * (6 if large else 1),
                        primitive="TRIANGLES" if large else "POINTS", depth_test=depth_test, blend=blend,
                    )  # fmt: skip

    def _forget(self) -> None:
        for splats in self._splats:
            splats.release()
        self._splats.clear()
        self.draws = self._mask = None
        self._begun = self._left = False

    def release(self) -> None:
        self._forget()
        self.nearest_target.release()
        self.sum_target.release()
        for texture in (self.nearest, *self.sums.values()):
            texture.release()
