"""Puts what a view draws of scans that are read by pages in the place of these scans.

A picture that may wait gets all pages that its tolerance needs and that fit the budget; a viewport what is there, and
asks for the rest.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Set
from dataclasses import replace

import numpy as np

from ...core.numeric.record import record, value_record
from ...core.scene.bounds import within
from ...core.scene.camera import Camera
from ...core.scene.cloud import PointCloud
from ...core.scene.lights import Light
from ...core.scene.scene import Geometry, Scene, StreamedScan
from ...core.scene.settings import Settings
from ...core.splat.pixel_radii import with_pixel_radii
from ...stream.casting import Casters, receivers_of
from ...stream.cut import CutSplats, PageCut, cut_pages, parts_of, splats_of_cut
from ...stream.need import Need, needed_pages
from ...stream.page import Page
from ...stream.pool import PICTURE, POOL, VIEWPORT, PagePool, Wish, wishes_of
from ...stream.tree import PageTree
from ..cache.keys import STREAMED_NAME, Key, Kind
from ..cache.store import Store
from .separation import with_repeated

WAIT = 0.05  # seconds between two looks whether the picture is still wanted
PATIENCE = 60.0  # seconds without a page, after which a picture no longer waits for the rest
FIRST = 0.3  # the same for a viewport that has never shown a scan, so that its first picture is not empty
ENOUGH = 64  # pages that such a picture waits for, no longer than that: it compiles shaders, and is looked at meanwhile
MEGABYTE = 1 << 20
NARROW = 0.01  # radians: half the angle of suns that are points while a view moves; that of the sun is 0.0047


@value_record
class Streamed:
    """What a view reads and draws of scans that are read by pages."""

    needed: int  # pages that the tolerance needs
    drawn: int
    points: int  # that are drawn
    read_pages: int  # for this view
    read_bytes: int
    waiting: bool  # more pages are to come
    arrivals: int  # of the pool, before it was asked for pages
    warnings: tuple[str, ...] = ()

    @property
    def progress(self) -> str:
        """What a person is told while pages come; empty when all are there."""
        return f"Reading pages: {self.drawn:,} of {self.needed:,}" if self.waiting else ""

    @property
    def report(self) -> dict[str, int]:
        """What a report says of it."""
        read = {"pages": self.read_pages, "bytes": self.read_bytes}
        return {"needed_pages": self.needed, "drawn_pages": self.drawn, "points": self.points, **read}


@record
class _Scan:
    """A geometry that is read by pages, with the views of its instances (I, 4, 4)."""

    row: int
    geometry: Geometry
    streamed: StreamedScan
    view_from_object: np.ndarray


def with_pages(
    scene: Scene,
    camera: Camera,
    settings: Settings,
    store: Store,
    interactive: bool,
    check: Callable[[], None],
    pool: PagePool = POOL,
    moving: bool = False,
    of: Camera | None = None,
    forget: Callable[[Set[str]], None] = lambda drawn: None,
) -> tuple[Scene, Streamed | None]:
    """Returns the scene with clouds in the place of scans that are read by pages, and what was read; None: there are no
    such scans.

    `check` is called while pages are read, and may raise to stop. `moving`: the view is drawn finely once nothing
    moves: until then what is out of view casts no shadows, and suns that are nearly points are points. `of`: whose
    picture needs the pages; None: the camera's. `forget`: is called with the content keys of what is drawn of scans,
    before it is made.
    """
    asking = camera if of is None else of
    scans = _scans(scene, camera)
    if not scans:
        return scene, None
    pool.budget = settings.memory_budget * MEGABYTE
    before = [(scan.read_pages, scan.read_bytes) for scan in _files(scans)]
    warnings: list[str] = []
    for scan in _files(scans):
        pool.refresh(scan)

    def opening() -> bool:
        return any(scan.tree is None and not scan.failure for scan in _files(scans))

    new = interactive and pool.first_time(_files(scans))
    if not interactive:
        _wait(pool, opening, check, warnings)
    elif new:
        _wait(pool, opening, check, [], FIRST)
    if moving:
        scene = replace(scene, lights=tuple(map(_hurried, scene.lights)))
        needs = [_need(scan, asking, settings.tolerance) for scan in scans]
    else:
        needs = _needs(scans, scene, asking, settings)
    view = VIEWPORT if interactive else PICTURE
    of_each = [_wishes(scan, need) for scan, need in zip(scans, needs, strict=True)]
    wishes = sorted((wish for some in of_each for wish in some), key=lambda wish: -wish.gain)
    spare = _coming(scans, asking, settings.tolerance, pool, wishes) if interactive else []
    fitting = pool.want(view, wishes, spare, moving)
    if new:
        shown = [scan.streamed for scan in scans if scan.streamed.scan.tree is not None]
        _wait(pool, lambda: pool.is_busy(view) and not _begun(pool, shown), check, [], FIRST)
        until = time.monotonic() + FIRST
        some = wishes[: min(ENOUGH, fitting)]
        _wait(pool, lambda: pool.is_busy(view) and time.monotonic() < until and not _are_there(pool, some), check, [])
    if not interactive:
        _wait(pool, lambda: pool.is_busy(view), check, warnings)
        fitting = pool.fitting(view)
        if fitting < len(wishes):
            warnings.append(
                f"The memory budget of {settings.memory_budget:,} MB holds {fitting:,} of {len(wishes):,} pages that"
                " the tolerance needs: coarser ones are drawn"
            )
    for scan in _files(scans):
        warnings += scan.warnings
    # Before pages are taken: one that comes meanwhile is drawn next time, and who waits must know.
    arrivals, waiting = pool.arrivals, pool.is_busy(view)
    fits = {wish.key for wish in wishes[:fitting]}
    geometries, instances = list(scene.geometries), scene.instances
    drawn = points = 0
    cuts = [
        _shown(scan, [wish.page for wish in some if wish.key in fits], pool)
        for scan, some in zip(scans, of_each, strict=True)
    ]
    names = {name for one in cuts for name in (one.name, one.of_nodes)}
    store.forget_streamed(view, names)
    forget(names)
    for scan, one in zip(scans, cuts, strict=True):
        first, *more = _joined(scan, one, store, None if moving else pool)
        geometries[scan.row] = first
        drawn += 0 if one.cut is None else len(one.cut)
        rows = np.flatnonzero(scene.instances.geometry == scan.row)
        for part in more:
            instances = with_repeated(instances, rows, np.full(len(rows), len(geometries)))
            geometries.append(part)
        points += sum(len(part.cloud) for part in (first, *more) if part.cloud is not None)
    read = np.array([(scan.read_pages, scan.read_bytes) for scan in _files(scans)]) - before
    pages, size = read.sum(axis=0).tolist()
    found = Streamed(len(wishes), drawn, points, pages, size, waiting, arrivals, tuple(dict.fromkeys(warnings)))
    scene = replace(scene, geometries=tuple(geometries), instances=instances)
    return with_pixel_radii(scene, camera, of_pages=True), found


def _scans(scene: Scene, camera: Camera) -> list[_Scan]:
    found = []
    for row, geometry in enumerate(scene.geometries):
        if geometry.streamed is not None and not geometry.key.startswith(STREAMED_NAME):  # or it has its cloud
            where = scene.instances.geometry == row
            with np.errstate(all="ignore"):
                views = camera.view_from_world @ scene.instances.world_from_object[where]
            found.append(_Scan(row, geometry, geometry.streamed, views))
    return found


def _begun(pool: PagePool, scans: list[StreamedScan]) -> bool:
    """Whether the first pages of scans are there."""
    return all(pool.pages(one.scan, one.look, [0]) for one in scans)


def _are_there(pool: PagePool, wishes: list[Wish]) -> bool:
    """Whether pages are there, or cannot be read."""
    return all(wish.page in wish.scan.damaged or pool.pages(wish.scan, wish.look, [wish.page]) for wish in wishes)


def _files(scans: list[_Scan]) -> list:
    """The files of scans, each once."""
    return list(dict.fromkeys(scan.streamed.scan for scan in scans))


def _wait(
    pool: PagePool,
    unfinished: Callable[[], bool],
    check: Callable[[], None],
    warnings: list[str],
    patience: float = PATIENCE,
) -> None:
    """Waits for pages, until none comes for too long."""
    seen, idle = pool.arrivals, 0.0
    while unfinished():
        check()
        pool.wait(WAIT, seen)
        idle = idle + WAIT if pool.arrivals == seen else 0.0
        seen = pool.arrivals
        if idle > patience:
            warnings.append(f"No page of a scan has come for {PATIENCE:.0f} seconds: what is there is drawn")
            return


def _needs(scans: list[_Scan], scene: Scene, camera: Camera, settings: Settings) -> list[Need]:
    """What a view needs of each scan: what it sees, and what casts shadows into that."""
    tolerance = settings.tolerance
    seen = [_need(scan, camera, tolerance) for scan in scans]
    lights = [light for light in scene.lights if light.shadow] if settings.use_shadows else []
    if not lights:
        return seen
    instances = scene.instances
    casts = np.ones(len(instances), bool) if instances.casts is None else instances.casts
    shown, found = [], []
    for scan, need in zip(scans, seen, strict=True):
        if scan.streamed.scan.tree is not None:
            where = instances.geometry == scan.row
            shown.append((scan.streamed.scan.tree, need, instances.world_from_object[where]))
    receivers = receivers_of(shown, camera, tolerance)
    if receivers is None:
        return seen
    for scan, need in zip(scans, seen, strict=True):
        tree, where = scan.streamed.scan.tree, (instances.geometry == scan.row) & casts
        if tree is None or not where.any():
            found.append(need)
            continue
        world = instances.world_from_object[where]
        cast = Casters(tree, world, receivers, lights, settings.shadow_resolution)
        found.append(_need(scan, camera, tolerance, cast.spacing))
    return found


def _hurried(light: Light) -> Light:
    """Returns a light as it lights a view that moves: maps of one that is no point are drawn from several points."""
    return replace(light, radius=0.0) if light.kind == "SUN" and light.radius < NARROW else light


def _need(
    scan: _Scan, camera: Camera, tolerance: float, cast: Callable[[np.ndarray], np.ndarray] | None = None
) -> Need:
    tree = scan.streamed.scan.tree
    if tree is None or len(scan.view_from_object) == 0:
        return Need(np.empty(0, np.int64), np.empty(0))
    return needed_pages(tree, scan.view_from_object, camera, tolerance, cast)


def _coming(scans: list[_Scan], camera: Camera, tolerance: float, pool: PagePool, wishes: list[Wish]) -> list[Wish]:
    """Pages that a viewport will need where it moves on as it did since its last picture, and does not need yet."""
    before, now = pool.view_before, camera.view_from_world
    pool.view_before = now
    if before is None or np.array_equal(before, now):
        return []
    moved = now @ np.linalg.inv(before)
    known = {wish.key for wish in wishes}
    found = []
    for scan in scans:
        later = replace(scan, view_from_object=moved @ scan.view_from_object)
        found += [wish for wish in _wishes(scan, _need(later, camera, tolerance)) if wish.key not in known]
    return found


def _wishes(scan: _Scan, need: Need) -> list[Wish]:
    return wishes_of(scan.streamed.scan, scan.streamed.look, need.pages, need.gain)


@record
class _Shown:
    """What a view draws of a scan."""

    name: str  # content keys, of points
    pages: dict[int, Page]  # that are there
    cut: PageCut | None  # None: the stand-in is drawn

    @property
    def of_nodes(self) -> str:
        return f"{self.name} nodes"


def _shown(scan: _Scan, wanted: list[int], pool: PagePool) -> _Shown:
    """What a view that wants some pages draws of a scan."""
    streamed, name = scan.streamed, f"{STREAMED_NAME}{scan.geometry.key}"
    tree: PageTree | None = streamed.scan.tree
    there = pool.pages(streamed.scan, streamed.look, wanted) if tree is not None else {}
    if tree is None or 0 not in there:
        return _Shown(f"{name} stand-in", there, None)
    cut = cut_pages(tree, there)
    return _Shown(f"{name} {streamed.scan.number} {cut.digest}", there, cut)


def _joined(scan: _Scan, shown: _Shown, store: Store, pool: PagePool | None) -> list[Geometry]:
    """What a view draws of a scan, points and nodes, each a geometry. `pool`: where pages become parts of it; None:
    the view moves, and the next one is drawn soon."""
    streamed, geometry, cut = scan.streamed, scan.geometry, shown.cut
    tree: PageTree | None = streamed.scan.tree
    if tree is None or cut is None:
        return [replace(geometry, key=shown.name, cloud=streamed.stand_in)]

    def make() -> CutSplats:
        splats = splats_of_cut(tree, cut, shown.pages, streamed.size, lasting=pool is not None)
        return splats if streamed.box_from_object is None else clipped(splats, streamed)

    splats: CutSplats = store.lookup(Key(Kind.STREAMED, shown.name), make)
    if pool is not None and not pool.is_shared(geometry.key, splats):
        pool.share(streamed.scan, streamed.look, geometry.key, splats, parts_of(splats, shown.pages))
    found = []
    if splats.points is not None or splats.nodes is None:
        found.append(replace(geometry, key=shown.name, cloud=splats.points))
    if splats.nodes is not None:
        found.append(replace(geometry, key=shown.of_nodes, cloud=splats.nodes, node_shape=splats.shape))
    return found


def clipped(splats: CutSplats, streamed: StreamedScan) -> CutSplats:
    """Returns the splats that clip boxes keep, by their centres."""
    boxes = streamed.box_from_object
    assert boxes is not None

    def kept(cloud: PointCloud | None) -> np.ndarray:
        return np.flatnonzero(within(cloud.position, boxes) == streamed.inside) if cloud is not None else np.empty(0)

    points, nodes = kept(splats.points), kept(splats.nodes)
    return CutSplats(
        splats.points.take(points) if splats.points is not None and len(points) else None,
        splats.nodes.take(nodes) if splats.nodes is not None and len(nodes) else None,
        splats.shape[nodes] if splats.shape is not None and len(nodes) else None,
    )
