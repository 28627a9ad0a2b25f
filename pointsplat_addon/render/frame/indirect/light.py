"""Gathers indirect light for the groups of a tile: at some of them, from which the others interpolate it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ....core.indirect.around import LightAt
from ....core.indirect.moments import in_relief, irradiance, lobes, of_planes
from ....core.indirect.sites import Sites, hashed, quantised_directions, scrambled
from ...device.packing import paged
from ...device.protocol import Device, Target, Texture
from ...indirect.known_sites import Slices
from ...indirect.light import IndirectLight, coherent_rows
from ...indirect.traced import is_traced
from ...passes.gbuffer import GBuffer, Variant
from ...passes.indirect.group_points import GROUP_POINTS_BLOCK, group_points_program
from ...passes.indirect.interpolate import INTERPOLATE, INTERPOLATE_BLOCK, TILE
from ...passes.indirect.pages import RECEIVER_WIDTH, paged_texture, receiver_texture
from ...passes.indirect.reflect import REFLECT, REFLECT_BLOCK
from ...passes.uniforms import SampleView
from ..uploads.uploads import Uploads
from .known import Known
from .mirrors import Mirrors, Shown
from .receivers import SIDES, Groups, Receivers, choose_receivers, directions_to_eye, sites_of, sole_groups
from .scattered import WIDER, Scattered, scattered_cells

FEWEST_IN_TILE = 3  # groups of a surface in a square, from which on it has a receiver there beside that of the largest
FEWEST_SHARE = 16  # a surface has a receiver in wider squares if it fills one in so many pixels; tilted ones fill few
FEWEST_OF_BALLS = 1  # the same of balls: the deeper they are seen between others, the fewer groups show one normal
RIM = 0.4  # cosine to the eye below which what mirrors gathers, as that changes fast there
SHARPER = 3.0  # than which a lobe is that does; wider ones, as of grass, change as slowly as what falls on a surface
MIRRORS, ROUGHNESSES = 48, 64  # steps of mirrored views, each way of an octahedron, and of roughness
NOT_KNOWN = (None, None)
OF_BALLS = 8.0  # more than the roughness of anything else; shaders/indirect/group_points.frag
MATTE_FIBRE = -4.0  # in place of the roughness of fibres, which mirror nothing; others have -2 less theirs
# Places across a fibre, over half its width, and their weights (Gauss and Legendre).
ACROSS = (0.0, 8 / 18), (0.6**0.5, 5 / 18), (-(0.6**0.5), 5 / 18)
WHOLE = 0.0, 1.0
SHARPEST = 24.0  # of a glossy lobe that the cells of a hemisphere resolve


class GroupsInIndirectLight:
    """What the groups of a list receive of indirect light, in textures as long as the list."""

    def __init__(
        self,
        device: Device,
        light: IndirectLight,
        uploads: Uploads,
        variant: Variant,
        slices: Slices | None,
        mirrors: Mirrors | None = None,
    ) -> None:
        """`variant`: of the G-buffer of groups. `slices`: in which they gather; None: they do not, and what they
        receive is estimated from what is known. `mirrors`: what sharp ones show."""
        self._device, self._light, self._variant = device, light, variant
        self._materials = uploads.lighting.materials["ps_materials"]
        self._sky = uploads.lighting.sky
        self._lists: _Lists | None = None
        self._slices = slices
        self._mirrors = mirrors
        self._mirrored: Texture | None = None  # what the last list shows, with sharp mirrors

    @property
    def goes_on(self) -> bool:
        """Whether gathering that was put off may go on later."""
        return self._slices is not None and not self._slices.endless

    def gather(self, view: SampleView, surfaces: GBuffer, listed: Texture, entries: np.ndarray) -> dict[str, Texture]:
        """Returns what shading reads, by sampler name. Cancelled: gathering was put off.

        `surfaces`: attributes of the groups. `listed`: the list of groups, and `entries` (N, 2): pixel and layer of
        each of them.
        """
        device, mirrors = self._device, self._mirrors
        self._release_mirrored()
        if self._lists is None or self._lists.size != listed.size:
            self._release_lists()
            self._lists = _Lists(device, listed.size, mirrors is not None)
        lists = self._lists
        assert lists.place_target is not None
        device.clear(lists.place_target)
        turned = np.eye(4)
        turned[:3, :3] = view.world_from_view[:3, :3]
        program = group_points_program(self._variant, mirrors is not None)
        textures = surfaces.bound() | {"ps_list": listed, "ps_materials": self._materials}
        names = {name for _, name in program.samplers}
        device.draw(
            program,
            lists.place_target,
            uniforms=view.record(GROUP_POINTS_BLOCK, tree_from_view=turned),
            textures={name: texture for name, texture in textures.items() if name in names},
        )
        count = len(entries)
        held = "ps_places", "ps_ups", *(() if mirrors is None else ("rays",))
        place, up, *rays = (device.read(lists.textures[name]).reshape(-1, 4)[:count] for name in held)
        balls = up[:, 3] > 0.5 * OF_BALLS
        up[balls, 3] -= OF_BALLS
        if self._light.occlusion:
            up[:, 3] = np.where(is_fibre(up[:, 3]), MATTE_FIBRE, -1)  # nothing is mirrored
        eye = view.world_from_view[:3, 3] - self._light.origin
        to_eye = directions_to_eye(view, place[:, :3])
        pixel = entries[:, 0].astype(np.int64)
        groups = Groups(eye, place[:, :3] + eye, up[:, :3], place[:, 3], pixel, balls if balls.any() else None)
        if mirrors is None or not mirrors.trace(groups, up[:, 3]):
            self._receive(view, lists, listed, groups, place, up, to_eye)
            return lists.received
        gathering, beyond = up, None
        if not mirrors.others:  # then cells show nothing of sharp mirrors
            gathering = up.copy()
            gathering[is_traced(up[:, 3]) == 1, 3] = -1
        self._receive(view, lists, listed, groups, place, gathering, to_eye)
        if mirrors.others:
            beyond = device.read(lists.textures["mirrored"]).reshape(-1, 4)[:count]
        shown = mirrors.shown(view, groups, up[:, 3], rays[0], beyond, self._lit)
        self._mirrored = self._reflected(view, lists, listed, groups, shown)
        return lists.received | {"ps_mirrored_light": self._mirrored}

    def received_by(
        self, view: SampleView, place: np.ndarray, up: np.ndarray, draw: Callable[[dict[str, Texture]], None]
    ) -> None:
        """Calls `draw` with what N splats receive, as `gather` returns it, one texel each in their order.

        place, up: (N, 4) float32, as shaders/indirect/group_points.frag writes them; what has no depth receives
        nothing.
        """
        (width, height), camera = view.size, view.camera
        seen = place[:, :3].astype(np.float64) @ view.world_from_view[:3, :3]
        ahead = np.maximum(place[:, 3:], 1e-30) if camera.perspective else np.ones_like(place[:, 3:])
        at = seen[:, :2] * camera.pixel_from_view()[:2] / ahead + np.asarray(view.principal_point)
        x, y = (
            np.clip(np.floor(of), 0, side - 1).astype(np.int64) for of, side in zip(at.T, (width, height), strict=True)
        )
        eye = view.world_from_view[:3, 3] - self._light.origin
        groups = Groups(eye, place[:, :3] + eye, up[:, :3], place[:, 3], y * width + x)
        self._lit(view, groups, up[:, 3], directions_to_eye(view, place[:, :3]), draw, directly=True)

    def _lit(
        self,
        view: SampleView,
        groups: Groups,
        roughness: np.ndarray,
        to_eye: np.ndarray,
        draw: Callable[[dict[str, Texture]], None],
        directly: bool = False,
    ) -> None:
        """Calls `draw` with what groups that are seen by way of mirrors receive, as `gather` returns it; see Lit.
        `directly`: as of _receive."""
        count, device = len(groups.depth), self._device
        place = np.column_stack([groups.position - groups.eye, groups.depth]).astype(np.float32)
        up = np.column_stack([groups.normal, roughness]).astype(np.float32)
        entries = np.stack([groups.pixel, np.zeros(count)], axis=1).astype(np.float32)
        size, data = paged(entries, 2)
        listed = device.texture(size, "RG32F", data)
        lists = _Lists(device, size, False, (paged(place, 4)[1], paged(up, 4)[1]))
        try:
            self._receive(view, lists, listed, groups, place, up, to_eye, directly)
            draw(lists.received)
        finally:
            listed.release()
            lists.release()

    def _reflected(self, view: SampleView, lists: _Lists, listed: Texture, groups: Groups, shown: Shown) -> Texture:
        """Returns what all groups mirror, of which `shown` tells what rays have met."""
        device, texels = self._device, lists.size[0] * lists.size[1]
        made: dict[str, Texture] = {}
        columns, height = lists.size
        for name, values in (("ps_shown", shown.light), ("ps_ends", shown.ends), ("ps_kinds", shown.kinds[None])):
            laid = np.zeros((len(values), texels, values.shape[2]), np.float32)
            laid[:, shown.rows] = values
            format = "RGBA32F" if values.shape[2] == 4 else "RG32F"
            made[name] = device.texture((columns, height * len(values)), format, laid.reshape(-1))
        width, height = view.size
        of_pixels = np.zeros((width * height, 2), np.float32)
        of_pixels[groups.pixel[shown.rows]] = np.column_stack([shown.rows, shown.count])
        made["ps_of_pixels"] = device.texture((width, height), "RG32F", of_pixels.reshape(-1))
        held = {"ps_places": "ps_places", "ps_rays": "rays", "ps_in_cells": "mirrored"}
        textures = {"ps_list": listed} | made | {name: lists.textures[own] for name, own in held.items()}
        out = device.texture(lists.size, "RGBA32F")
        target = device.target([out])
        to_eye = (*view.world_from_view[:3, 2], 0.0)
        device.draw(REFLECT, target, uniforms=view.record(REFLECT_BLOCK, to_eye=to_eye), textures=textures)
        for item in (target, *made.values()):
            item.release()
        return out

    def _receive(
        self,
        view: SampleView,
        lists: _Lists,
        listed: Texture,
        groups: Groups,
        place: np.ndarray,
        up: np.ndarray,
        to_eye: np.ndarray,
        directly: bool = True,
    ) -> None:
        """Gathers for groups at places with normals (N, 4), as `gather` has them, seen from directions (N, 3).
        `directly`: not by way of mirrors, for which cells may be wider than rooms; only then does what is turned all
        ways in a cell share a gather."""
        fewest: int | np.ndarray = FEWEST_IN_TILE
        if directly and groups.balls is not None:
            fewest = np.where(groups.balls, FEWEST_OF_BALLS, FEWEST_IN_TILE)
        chosen = choose_receivers(groups, view, TILE, fewest, True)
        found = self._found(view, groups, to_eye, up, chosen, directly)
        self._interpolate(view, lists, listed, chosen, found, place, up)

    def _found(
        self, view: SampleView, groups: Groups, to_eye: np.ndarray, up: np.ndarray, chosen: Receivers, directly: bool
    ) -> np.ndarray:
        """(R, 8): what receivers have gathered, or interpolated from others that are farther apart and see alike."""
        if self._slices is None:
            return self._estimated(groups, up, chosen)
        sole = sole_groups(groups, view) if directly else None
        known = Known(groups.position.astype(np.float32), groups.normal)
        rim = (up[:, 3] >= 0) & ((up[:, :3] * to_eye).sum(axis=1) < RIM) & (lobe_sharpness(up[:, 3]) > SHARPER)
        fibres = is_fibre(up[:, 3])
        sharing = chosen if directly else chosen.none
        # Of fibres all share what is gathered in a cell: it tells what falls on them from all sides.
        of_fibres = fibres[sharing.rows]
        scattered = [(scattered_cells(groups, sharing.without_tiles(~of_fibres)), ~fibres)]
        if of_fibres.any():
            scattered.append((scattered_cells(groups, sharing.without_tiles(of_fibres), every=True), fibres))
        for side in SIDES:
            fewest = side * side // FEWEST_SHARE
            wanted = chosen if side == TILE else choose_receivers(groups, view, side, fewest, False)
            found, valid = known.interpolated(wanted.rows, wanted.pixels)
            level = wanted.level + WIDER - np.log2(side / TILE)
            turned = [
                ~valid & kind[wanted.rows] & cells.hold(groups.position[wanted.rows], level)
                for cells, kind in scattered
            ]
            alone = ~valid & ~np.logical_or.reduce(turned)
            found[alone] = self._gathered_by(groups, wanted, alone, view, sole, to_eye, up)
            if side > TILE:
                known.add(wanted, side, found, alone)
            else:
                for some, (cells, _) in zip(turned, scattered, strict=True):
                    found[some] = self._gathered_around(groups, wanted, some, cells, to_eye, up)
                # Of lobes alone: what falls on a surface is the same in a picture of a term that has none.
                lobes = valid & rim[wanted.rows]
                found[lobes, 4:] = self._gathered_by(groups, wanted, lobes, view, sole, to_eye, up)[:, 4:]
        lone = fibres[chosen.rows] & ~np.logical_or.reduce(turned)
        found[lone, 4:7], found[lone, 7] = found[lone, :3], 0
        return found

    def _gathered_by(
        self,
        groups: Groups,
        wanted: Receivers,
        some: np.ndarray,
        view: SampleView,
        sole: np.ndarray | None,
        to_eye: np.ndarray,
        up: np.ndarray,
    ) -> np.ndarray:
        """(n, 8): what some of receivers, (R,) bool, gather."""
        rows, level = wanted.rows[some], wanted.level[some]
        return self._gathered(sites_of(groups, rows, level, view, sole), level, to_eye[rows], up[rows, 3])

    def _gathered_around(
        self,
        groups: Groups,
        wanted: Receivers,
        some: np.ndarray,
        scattered: Scattered,
        to_eye: np.ndarray,
        up: np.ndarray,
    ) -> np.ndarray:
        """(n, 8): what some of receivers, (R,) bool, receive where light is gathered for all that is in a cell."""
        assert self._slices is not None
        light, rows, found = self._light, wanted.rows[some], np.zeros((np.count_nonzero(some), 8), np.float32)
        if len(rows) == 0:
            return found
        at = scattered.position
        order = coherent_rows(at, np.ones_like(at))
        moments = light.known_moments.lookup(
            scattered.site, order, lambda some: light.moments(at[some], self._sky), self._slices
        )
        position, normal = groups.position[rows], groups.normal[rows].astype(np.float64)
        if (plane := scattered.plane) is not None:
            moments = np.column_stack([moments, of_planes(moments, plane)])
        moments = scattered.between(position, wanted.level[some] + WIDER, moments)
        eye, roughness, fibre = to_eye[rows].astype(np.float64), up[rows, 3], is_fibre(up[rows, 3])
        smooth = (roughness >= 0) | (fibre & (roughness > MATTE_FIBRE))
        sharpness = lobe_sharpness(np.where(fibre, -2 - roughness, roughness)[smooth])
        beside = np.cross(normal, eye - (normal * eye).sum(axis=1, keepdims=True) * normal)
        beside *= fibre[:, None] / np.maximum(np.linalg.norm(beside, axis=1, keepdims=True), 1e-4)
        for across, weight in ACROSS if fibre.any() else (WHOLE,):
            # Of fibres the mean over their width.
            turned = np.where(fibre[:, None], (1 - across * across) ** 0.5, 1.0) * normal + across * beside
            mirror = 2 * (turned * eye).sum(axis=1, keepdims=True) * turned - eye
            found[:, :3] += weight * irradiance(moments, turned)
            found[smooth, 4:] += weight * lobes(moments[smooth], mirror[smooth], sharpness)
        if scattered.plane is not None:
            found[:, :3] = in_relief(found[:, :3], moments, normal)
        light.remember(LightAt(position, normal, wanted.level[some], found, smooth & ~fibre))
        return found

    def _estimated(self, groups: Groups, up: np.ndarray, chosen: Receivers) -> np.ndarray:
        """(R, 8): what receivers are likely to gather, by what is known around them."""
        around, rows = self._light.around, chosen.rows
        if around is None:
            return np.zeros((len(rows), 8), np.float32)
        found = around.estimated(groups.position[rows], groups.normal[rows], chosen.level)
        found[up[rows, 3] < 0, 4:] = 0
        fibre = is_fibre(up[rows, 3])
        found[fibre, 4:7] = found[fibre, :3]
        return found

    def _gathered(self, at: Sites, level: np.ndarray, to_eye: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """(n, 8): what is gathered at sites in cells of 2^level, (n,); `roughness` (n,): < 0: nothing is mirrored."""
        assert self._slices is not None
        light, found = self._light, np.empty((len(at.key), 8), np.float32)
        matte = np.flatnonzero(roughness < 0)
        smooth = np.flatnonzero(roughness >= 0)

        def remembered(rows: np.ndarray, found: np.ndarray, lobes: bool) -> np.ndarray:
            light.remember(LightAt(at.position[rows], at.normal[rows], level[rows], found, np.full(len(rows), lobes)))
            return found

        def gather_matte(some: np.ndarray) -> np.ndarray:
            some = matte[some]
            diffuse = light.gathered(at.position[some], at.normal[some], self._sky)
            return remembered(some, np.column_stack([diffuse, np.zeros_like(diffuse)]), False)

        if len(matte):
            order = coherent_rows(at.position[matte], at.normal[matte])
            found[matte] = light.known.lookup(at.key[matte], order, gather_matte, self._slices)
        if len(smooth):
            # Sites see the mirrored view as the quantised one, so that others find what was gathered.
            to_eye, alpha = to_eye[smooth], np.rint(roughness[smooth] * ROUGHNESSES) / ROUGHNESSES
            normal = at.normal[smooth]
            code, mirror = quantised_directions(
                2 * (normal * to_eye).sum(axis=1, keepdims=True) * normal - to_eye, MIRRORS
            )
            keys = scrambled(at.key[smooth] ^ hashed(np.column_stack([code, alpha])))

            def gather_smooth(some: np.ndarray) -> np.ndarray:
                rows = smooth[some]
                of_lobes = mirror[some], lobe_sharpness(alpha[some])
                return remembered(rows, light.gathered(at.position[rows], at.normal[rows], self._sky, *of_lobes), True)

            order = coherent_rows(at.position[smooth], normal)
            found[smooth] = light.known.lookup(keys, order, gather_smooth, self._slices)
        return found

    def _interpolate(
        self,
        view: SampleView,
        lists: _Lists,
        listed: Texture,
        chosen: Receivers,
        found: np.ndarray,
        place: np.ndarray,
        up: np.ndarray,
    ) -> None:
        """Brings what `found` (R, 8) tells of receivers to all groups, at places with normals (N, 4)."""
        device, rows = self._device, chosen.rows
        none = np.zeros((len(rows), 3), np.float32)
        receivers = receiver_texture(device, place[rows, :3], up[rows, :3], none, none[:, 0])
        size = RECEIVER_WIDTH, receivers.size[1]
        pixels = np.zeros((size[0] * size[1], 2), np.float32)
        pixels[: len(rows)] = chosen.pixels
        where = device.texture(size, "RG32F", pixels.reshape(-1))
        diffuse, glossy = (paged_texture(device, part, RECEIVER_WIDTH) for part in (found[:, :4], found[:, 4:]))
        height, width = chosen.tiles.shape[:2]
        tiles = device.texture((width, height), "RG32F", chosen.tiles.reshape(-1))
        textures = {
            "ps_list": listed, "ps_places": lists.textures["ps_places"], "ps_ups": lists.textures["ps_ups"],
            "ps_tiles": tiles, "ps_receivers": receivers, "ps_receiver_pixels": where,
            "ps_found_diffuse": diffuse, "ps_found_glossy": glossy,
        }  # fmt: skip
        device.draw(INTERPOLATE, lists.light_target, uniforms=view.record(INTERPOLATE_BLOCK), textures=textures)
        for item in (diffuse, glossy, receivers, where, tiles):
            item.release()

    def _release_mirrored(self) -> None:
        if self._mirrored is not None:
            self._mirrored.release()
        self._mirrored = None

    def _release_lists(self) -> None:
        self._release_mirrored()
        if self._lists is not None:
            self._lists.release()
        self._lists = None

    def release(self) -> None:
        self._release_lists()


def is_fibre(roughness: np.ndarray) -> np.ndarray:
    """(N,) bool: which groups are fibres, strands that are seen as a whole, by what stands for their roughness."""
    return roughness < -1.5


def lobe_sharpness(roughness: np.ndarray) -> np.ndarray:
    """(N,): of the spherical Gaussian that is about as wide as a GGX lobe around the mirrored view (Wang et al. 2009),
    at most as sharp as cells resolve."""
    alpha = np.maximum(np.clip(roughness, 0, 1).astype(np.float64) ** 2, 1e-3)
    return np.minimum(0.5 / alpha**2, SHARPEST)


class _Lists:
    """One texel a group."""

    def __init__(
        self,
        device: Device,
        size: tuple[int, int],
        mirrors: bool,
        known: tuple[np.ndarray | None, np.ndarray | None] = NOT_KNOWN,
    ) -> None:
        """`mirrors`: with where each mirrors the eye to. `known`: what is in the first two, flat; None: a pass writes
        it."""
        self.size = size
        places, ups = (device.texture(size, "RGBA32F", data) for data in known)
        gathered, mirrored = (device.texture(size, "RGBA32F") for _ in range(2))
        self.textures = {"ps_places": places, "ps_ups": ups, "gathered": gathered, "mirrored": mirrored}
        if mirrors:
            self.textures["rays"] = device.texture(size, "RGBA32F")
        rays = [self.textures["rays"]] if mirrors else []
        self.place_target: Target | None = device.target([places, ups, *rays]) if known is NOT_KNOWN else None
        self.light_target: Target = device.target([gathered, mirrored])
        targets = [target for target in (self.place_target, self.light_target) if target is not None]
        self._owned: list[Any] = [*targets, *self.textures.values()]

    @property
    def received(self) -> dict[str, Texture]:
        """What shading reads, by sampler name."""
        return {"ps_gathered_light": self.textures["gathered"], "ps_mirrored_light": self.textures["mirrored"]}

    def release(self) -> None:
        for item in self._owned:
            item.release()
