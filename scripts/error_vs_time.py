"""Error against time: each technique over tolerance, samples, shadow resolution and lens, beside Cycles, EEVEE and VTK.

    python scripts/error_vs_time.py [--data DIR] [--only NAME ...] [--quick] [--docs docs] [--rows FILE.json]
    python scripts/error_vs_time.py --from docs/error_vs_time.json

DIR (or the folder that POINTSPLAT_DATA names) holds japaneseMaple/, pedestrianRailing1/, dragon_vrip_res2.ply.gz and
../volume/gaffer_smoke.vdb: scenes of what is missing are left out; what DOCS has of scenes that are not drawn stays.
DOCS receives error_vs_time.json and, in images/, error_vs_time.png, error_vs_time_brief.png and cost_over_points.png;
the tables in error_vs_time.md are replaced. `--from` makes tables and plots anew from rows. `--quick` draws small
pictures of one scene and writes nothing but the rows that `--rows` names. Needs bpy for all scenes but one, matplotlib
for plots, and takes FLIP where the package flip-evaluator is there (requirements/benchmark.txt).

Every scene is drawn in a process of its own, as are the other programs. Times are those of the processor in all
threads, from Blender's data to the finished picture, shaders compiled before: converting the scene, sampling, shadow
tables and drawing, with nothing kept from pictures before.
"""

from __future__ import annotations

import argparse
import importlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast
from unittest import mock

import numpy as np
from PIL import Image

sys.path.insert(0, str(Path(__file__).resolve().parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from pointsplat_addon.core.cloud import PointCloud
from pointsplat_addon.core.scene import Camera, Geometry, Instances, Scene, Settings, World, default_materials
from pointsplat_addon.render.filtering import FILTER_WIDTH, offsets
from pointsplat_addon.render.frame import Frame
from pointsplat_addon.render.renderer import Renderer
from pointsplat_addon.render.report import report
from pointsplat_addon.render.request import Request
from pointsplat_addon.render.store import STORE
from scripts import bench_frame
from scripts.error_curves import Row, errors, plot, plot_brief, plot_counts, written
from scripts.vtk_volume import VolumeView

ROOT = Path(__file__).resolve().parent.parent
SIZE = 256  # pixels
TECHNIQUES = ("IMAGE_SPACE", "EWA", "PAINTER")
TOLERANCES = (16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25)  # pixels
LENS_TOLERANCES = (4.0, 1.0)  # of samples through the lens
SAMPLES = (1, 4, 16, 64)
RESOLUTIONS = (64, 256, 4096)  # of shadows, beside the default
LONGEST = 4.0  # seconds: a picture that has taken longer gets no further samples, and finer ones are not drawn
TRUTH = 256  # samples of polygons
TRUTH_LENS = 1024  # the same, through a lens
TRUTH_SHADOWS = 8192  # cells of the shadow tables of these
CYCLES = (1, 4, 16, 64, 256)
CYCLES_LIMIT = 512  # samples, with other random numbers: what Cycles comes to
COUNTS = (10_000, 30_000, 100_000, 300_000, 1_000_000)  # points of the sphere
CLOUD = 200_000  # points of the sphere whose error is told over time
SMOKE = 96, 48  # pixels and voxels of the ball of smoke
PLUME = 96  # pixels of the plume of smoke
PLUME_FILE = "../volume/gaffer_smoke.vdb"  # of DIR
EXTINCTION = 3.0  # of its smoke where the density is 1, per unit: it is two units high
LIMIT = 1200  # seconds for one process


@dataclass(frozen=True)
class Subject:
    """A scene, how it is seen, what there is to choose about it, and the seconds that it took to read from Blender."""

    scene: Scene
    camera: Camera
    shadows: bool = False
    lens: bool = False
    truth: Callable[[], np.ndarray] | None = None  # scene-linear; None: by polygons
    converted: float = 0.0

    def drawn_as(self, primitive: str) -> Scene:
        geometries = tuple(replace(geometry, primitive=primitive) for geometry in self.scene.geometries)
        return replace(self.scene, geometries=geometries)


# ---------------------------------------------------------------------------- the sphere of points


def sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions, which are the normals too, and colours (count, 3) float32: a spiral of nearly equal spacing."""
    i = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    position = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)
    return position.astype(np.float32), pattern(position).astype(np.float32)


def pattern(p: np.ndarray) -> np.ndarray:
    """Radiance (N, 3) at places of the unit sphere: waves, and squares with edges."""
    x, y, z = p.T
    squares = (np.floor(6 * x + 0.5) + np.floor(6 * y + 0.5) + np.floor(6 * z + 0.5)) % 2
    waves = np.stack([np.sin(9 * x) * np.cos(7 * y), np.sin(8 * z), np.cos(11 * y + 5 * z)], axis=1)
    return 0.35 + 0.2 * waves + 0.3 * squares[:, None]


def disk_radius(count: int) -> float:
    """At which disks of that many points cover the sphere."""
    return 1.5 * (4 / count) ** 0.5


def sphere_subject(count: int, size: int) -> Subject:
    """Points that glow, in the view of bench_frame.py."""
    position, color = sphere(count)
    table = default_materials()
    table = replace(table, base_color=np.zeros((1, 3), np.float32), specular=np.zeros(1, np.float32))
    radii = np.full((count, 1), disk_radius(count), np.float32)
    cloud = PointCloud(position, normal=position, radii=radii, emission=color)
    geometry = Geometry(f"error over time {count}", "Sphere", cloud=cloud)
    scene = Scene((geometry,), Instances(np.zeros(1, np.int32), np.eye(4)[None]), table, (), World())
    camera = bench_frame.camera(0.0, size)
    return Subject(scene, camera, truth=lambda: sphere_truth(camera))


def sphere_truth(camera: Camera, samples: int = TRUTH) -> np.ndarray:
    """The unit sphere of `pattern` by its rays, (H, W, 3): the pixel's filter by as many places."""
    width, height = camera.resolution
    fx, fy, cx, cy = camera.pixel_from_view()
    world = np.linalg.inv(camera.view_from_world)
    y, x = np.mgrid[0:height, 0:width] + 0.5
    total = np.zeros((height * width, 3))
    for u, v in offsets(samples):
        direction = np.stack([(x + u - cx) / fx, (y + v - cy) / fy, np.full(x.shape, -1.0)], axis=-1).reshape(-1, 3)
        direction = direction @ world[:3, :3].T
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        along = -direction @ world[:3, 3]
        inside = along**2 - world[:3, 3] @ world[:3, 3] + 1
        hit = np.flatnonzero(inside > 0)
        total[hit] += pattern(world[:3, 3] + (along[hit] - np.sqrt(inside[hit]))[:, None] * direction[hit])
    return (total / samples).reshape(height, width, 3)


# ---------------------------------------------------------------------------- scenes of Blender's


def spot(size: int, data: Path, folder: Path) -> None:
    model(ROOT / "assets/spot/spot_triangulated.obj.gz", size, ROOT / "assets/spot/spot_texture.png")


def maple(size: int, data: Path, folder: Path) -> None:
    model(data / "japaneseMaple/japaneseMaple.obj", size, shadows=True)


def dragon(size: int, data: Path, folder: Path) -> None:
    model(data / "dragon_vrip_res2.ply.gz", size, smooth=True)


def railing(size: int, data: Path, folder: Path) -> None:
    model(data / "pedestrianRailing1/pedestrianRailing1.obj", size)


def model(path: Path, size: int, picture: Path | None = None, shadows: bool = False, smooth: bool = False) -> None:
    """A file before a camera, lit by one sun. With a picture, or smooth, it has a material of its own."""
    gallery = importlib.import_module("gallery")
    scene = gallery.studio(size)
    _ = gallery.load(path, picture) if picture is not None or smooth else gallery.read(path)
    direction = np.array([0.5, -1.0, 0.45])
    gallery.look_from(scene, direction / np.linalg.norm(direction))
    sun = scene.objects["Sun"].data
    sun.angle, sun.use_shadow = 0.0, shadows
    if hasattr(sun.cycles, "cast_shadow"):
        sun.cycles.cast_shadow = shadows


def balls(size: int, data: Path, folder: Path) -> None:
    scene = importlib.import_module("demo_depth_of_field").build()
    scene.render.resolution_x, scene.render.resolution_y = size, 3 * size // 4


def smoke(size: int, data: Path, folder: Path) -> None:
    media = importlib.import_module("compare_media")
    media.volumes_last(media.sphere_scene(folder, "absorbing", "outside", SMOKE[0], SMOKE[1]))


def plume(size: int, data: Path, folder: Path) -> None:
    """Smoke of a file, which absorbs, before a sky of radiance 1."""
    media, volumes = importlib.import_module("compare_media"), importlib.import_module("volume_objects")
    scene = media.studio(PLUME)
    media.sky(scene, 1.0)
    item = volumes.volume_object("Smoke", (data / PLUME_FILE).resolve(), volumes.medium("Smoke", 1.0, (0.0, 0.0, 0.0)))
    values, object_from_index = plume_voxels(item)
    # Its y points up; the picture shows where most of it is.
    heights = values.sum(axis=(0, 2), dtype=float)
    ends = np.searchsorted(np.cumsum(heights) / heights.sum(), (0.02, 0.98))
    middle = (np.array(values.shape) - 1) / 2
    middle[1] = ends.mean()
    scale = 2 / float(np.linalg.norm(object_from_index[:3, 1]) * (ends[1] - ends[0]))
    world = np.array([[scale, 0, 0, 0], [0, 0, -scale, 0], [0, scale, 0, 0], [0, 0, 0, 1.0]])
    world[:3, 3] = -1.0 * (world @ object_from_index @ np.append(middle, 1.0))[:3]
    item.matrix_world = [list(row) for row in world]
    # A volume's density is that of its own units, whatever its scale.
    volume = item.data.materials[0].node_tree.nodes["Principled Volume"]
    volume.inputs["Density"].default_value = EXTINCTION * scale
    media.look(scene.camera, (1.8, -3.6, 0.2), (0.0, 0.0, -0.35))
    scene.camera.data.angle = np.radians(34)


def plume_voxels(item: Any) -> tuple[np.ndarray, np.ndarray]:
    """Densities (X, Y, Z) float32 of a volume object's file, and its (4, 4) object_from_index of them."""
    vdb = importlib.import_module("volume_objects").openvdb()
    grid = vdb.read(item.data.filepath, "density")
    low, high = (np.array(corner) for corner in grid.evalActiveVoxelBoundingBox())
    values = np.empty(high - low + 1, np.float32)
    grid.copyToArray(values, ijk=tuple(int(i) for i in low))
    matrix = np.eye(4)
    matrix[:3, 3] = grid.transform.indexToWorld(tuple(float(i) for i in low))
    for axis in range(3):
        beside = low + np.eye(3, dtype=int)[axis]
        matrix[:3, axis] = np.array(grid.transform.indexToWorld(tuple(float(i) for i in beside))) - matrix[:3, 3]
    return values, matrix


def plume_field() -> tuple[np.ndarray, np.ndarray]:
    """Densities and (4, 4) world_from_index of the plume in the open scene."""
    import bpy

    item = next(o for o in bpy.context.scene.objects if o.type == "VOLUME")
    values, object_from_index = plume_voxels(item)
    return values, np.array(item.matrix_world) @ object_from_index


def plume_truth() -> np.ndarray:
    """What the voxels let through, trilinear, along rays that are spread as the pixel's filter: by the midpoints of
    steps of less than a voxel."""
    import bpy

    from pointsplat_addon.core import media_reference as reference

    values, world_from_index = plume_field()
    field = reference.voxels(values, world_from_index, EXTINCTION)
    count = 8
    origins, directions = filtered_rays(bpy.context.scene, count)
    near, far = field.interval(origins, directions)
    steps = 2 * max(values.shape)  # rays cross it sideways
    part = (np.arange(steps) + 0.5) / steps
    through = np.ones(len(origins))
    for some in np.array_split(np.flatnonzero(far > near), 256):
        along = near[some, None] + (far - near)[some, None] * part
        places = origins[some, None] + along[..., None] * directions[some, None]
        extinction = field.extinction(places.reshape(-1, 3))[:, 0].reshape(along.shape)
        through[some] = np.exp(-extinction.mean(axis=1) * (far - near)[some])
    picture = through.reshape(PLUME, PLUME, count**2).mean(axis=2)
    return np.repeat(picture[..., None], 3, axis=2)


def filtered_rays(scene: Any, samples: int, even: Callable | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (H * W * samples^2, 3) of a scene's rays, spread as the pixel's filter. `even`: what
    gives those through the centres of pixels."""
    if even is None:
        even = cast(Callable, importlib.import_module("compare_media").rays)
    forward = np.array(scene.camera.matrix_world)[:3, 2]
    origins, direction = even(scene, 1)
    side = scene.render.resolution_x
    grid = direction.reshape(side, side, 3) / -(direction @ forward).reshape(side, side, 1)
    right, up = grid[0, 1] - grid[0, 0], grid[1, 0] - grid[0, 0]
    spread = offsets(samples**2)
    rays = grid[:, :, None] + spread[:, :1] * right + spread[:, 1:] * up
    rays = rays.reshape(-1, 3) / np.linalg.norm(rays.reshape(-1, 3), axis=1, keepdims=True)
    return np.broadcast_to(origins[0], rays.shape), rays


def smoke_truth() -> np.ndarray:
    """Marched in float64, along rays that are spread as the pixel's filter."""
    import bpy

    media = importlib.import_module("compare_media")
    with mock.patch.object(media, "rays", partial(filtered_rays, even=media.rays)):
        return media.sphere_truth(bpy.context.scene, "absorbing", 4)


@dataclass(frozen=True)
class Kind:
    """Of scenes: who builds it in Blender (None: a sphere of points), and what there is to choose about it."""

    build: Callable[[int, Path, Path], None] | None
    needs: str = ""  # of DIR
    shadows: bool = False
    lens: bool = False
    truth: Callable[[], np.ndarray] | None = None


KINDS = {
    "Spot": Kind(spot),
    "maple, shadows": Kind(maple, "japaneseMaple", shadows=True),
    "dragon": Kind(dragon, "dragon_vrip_res2.ply.gz"),
    "railing": Kind(railing, "pedestrianRailing1"),
    "balls, depth of field": Kind(balls, lens=True),
    "smoke, shadows": Kind(smoke, shadows=True, truth=smoke_truth),
    "plume of voxels": Kind(plume, PLUME_FILE, truth=plume_truth),
    "sphere of points": Kind(None),
}


def subject(name: str, size: int, data: Path, folder: Path) -> Subject:
    """What is drawn, read from Blender where it is built there."""
    kind = KINDS[name]
    if kind.build is None:
        return sphere_subject(CLOUD, size)
    import bpy

    import pointsplat_addon
    from pointsplat_addon.host.convert.camera import from_camera_object
    from pointsplat_addon.host.sync import Synchronizer

    if not hasattr(bpy.types.Scene, "pointsplat"):
        pointsplat_addon.register()
    kind.build(size, data, folder)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    seen = bpy.context.scene
    before = time.process_time()
    scene = Synchronizer().scene(depsgraph)
    camera = from_camera_object(seen.camera, depsgraph, seen.render.resolution_x, seen.render.resolution_y)
    return Subject(scene, camera, kind.shadows, kind.lens, kind.truth, time.process_time() - before)


# ---------------------------------------------------------------------------- PointSplat


class ProcessorDevice(bench_frame.MeteredDevice):
    """Times passes by the processor's clock, in all threads, with the device finished before and after."""

    def start_timer(self) -> ProcessorWatch:
        return ProcessorWatch(self)


class ProcessorWatch:
    def __init__(self, device: ProcessorDevice) -> None:
        self._device = device
        device.finish()
        self._start = time.process_time()

    def stop(self) -> None:
        self._device.finish()
        self._elapsed = time.process_time() - self._start

    def milliseconds(self) -> float:
        return 1e3 * self._elapsed

    def release(self) -> None:
        pass


def pictures(
    renderer: Renderer, scene: Scene, camera: Camera, settings: Settings, samples: tuple[int, ...], lens: bool
) -> Iterator[tuple[np.ndarray, Row]]:
    """One picture after the first so many samples each, until LONGEST have passed, and its row. Nothing is kept from
    pictures before but shaders. The first samples do not depend on how many follow."""
    renderer.release()
    STORE.clear()
    start = time.process_time()
    request = Request(camera, settings, frozenset({"combined"}), samples[-1])
    # What the processor does is else timed by the wall's clock, which other work on the machine disturbs.
    with mock.patch.object(time, "perf_counter", time.process_time):
        frame = Frame(renderer, scene, request, presented=lens)
    allocated = time.process_time() - start
    seconds, reading = allocated, 0.0
    try:
        while not frame.complete and (seconds < LONGEST or frame.done == 0):
            frame.sample()
            if not (frame.done in samples or frame.complete):
                continue
            pixels = frame.pixels()["combined"]
            before = time.process_time()
            seconds = before - start - reading
            told = report(frame, seconds)
            passes = {entry["name"]: round(entry["ms"] / 1e3, 6) for entry in told["passes"]}
            prepare = max(allocated - passes.get("shadows", 0.0), 0.0)
            row = {"prepare": prepare, "passes": passes, "points": told["points"]["cut"], "bytes": told["bytes"]}
            yield pixels, {"samples": min(frame.done, samples[-1]), "seconds": seconds, **row}
            reading += time.process_time() - before
    finally:
        frame.release()


def swept(subject: Subject, tolerances: tuple[float, ...], samples: tuple[int, ...]) -> list[tuple[str, str, Settings]]:
    """(series, primitive, settings) of every picture."""
    plain = Settings(use_shadows=subject.shadows, use_adaptive_sampling=False)
    found = [
        ("tolerance", "POINTS", replace(plain, technique=technique, tolerance=tolerance))
        for tolerance in tolerances
        for technique in TECHNIQUES
    ]
    if subject.lens:
        found += [
            ("lens", "POINTS", replace(plain, technique=technique, tolerance=tolerance, dof_method="LENS_SAMPLES"))
            for tolerance in LENS_TOLERANCES
            for technique in TECHNIQUES
        ]
    if subject.shadows:
        found += [
            ("shadows", "POINTS", replace(plain, technique="IMAGE_SPACE", shadow_resolution=resolution))
            for resolution in RESOLUTIONS
        ]
    # As a user has it, each number of samples a picture of its own: samples that agree are then left out.
    usual = replace(plain, use_adaptive_sampling=True)
    return found + [("defaults", "AUTO", replace(usual, samples=count)) for count in samples]


def polygons(renderer: Renderer, subject: Subject, samples: int) -> np.ndarray:
    """The subject's triangles, with shadows as fine as they get, through the lens."""
    settings = Settings("IMAGE_SPACE", use_shadows=subject.shadows, use_adaptive_sampling=False,
                        shadow_resolution=TRUTH_SHADOWS, dof_method="LENS_SAMPLES", tolerance=0.5)  # fmt: skip
    STORE.clear()
    request = Request(subject.camera, settings, frozenset({"combined"}), samples)
    return renderer.render(subject.drawn_as("POLYGONS"), request).pixels["combined"]


def ours(
    renderer: Renderer,
    name: str,
    subject: Subject,
    tolerances: tuple[float, ...] = TOLERANCES,
    samples: tuple[int, ...] = SAMPLES,
    truth_samples: int = TRUTH,
) -> tuple[np.ndarray, list[Row]]:
    """The truth (H, W, 3 or 4), and PointSplat's rows."""
    many = max(truth_samples, TRUTH_LENS) if subject.lens else truth_samples
    truth = polygons(renderer, subject, many) if subject.truth is None else subject.truth()
    rows: list[Row] = []
    too_long = set()  # techniques at tolerances that no finer ones follow
    for series, primitive, settings in swept(subject, tolerances, samples):
        if series == "tolerance" and settings.technique in too_long:
            continue
        counts = (settings.samples,) if series == "defaults" else samples
        scene = subject.drawn_as(primitive)
        # Compiles shaders, which software renderers do anew for other sizes of textures; those of tiles that get no
        # more samples are first used after five
        few = 6 if settings.use_adaptive_sampling else 2
        _ = list(pictures(renderer, scene, subject.camera, settings, (min(few, counts[-1]),), subject.lens))
        for pixels, row in pictures(renderer, scene, subject.camera, settings, counts, subject.lens):
            if series == "tolerance" and row["samples"] == 1 and row["seconds"] > LONGEST:
                too_long.add(settings.technique)
            row |= {"seconds": row["seconds"] + subject.converted, "prepare": row["prepare"] + subject.converted}
            if series == "defaults":
                row["samples"] = settings.samples
            rows.append({"scene": name, "program": "PointSplat", "series": series, **described(subject, settings),
                         **row, **errors(pixels, truth)})  # fmt: skip
    return truth, rows


def described(subject: Subject, settings: Settings) -> Row:
    return {
        "technique": settings.technique,
        "tolerance": settings.tolerance,
        "shadow_resolution": settings.shadow_resolution if subject.shadows else None,
        "dof_method": settings.dof_method if subject.lens else None,
    }


def counted(renderer: Renderer, counts: tuple[int, ...], size: int) -> list[Row]:
    """Cost of one sample over the number of points, all of which are drawn: not even a hierarchy is built at so fine a
    tolerance."""
    rows = []
    for count in counts:
        drawn = sphere_subject(count, size)
        for technique in TECHNIQUES:
            settings = Settings(technique, tolerance=0.05, use_shadows=False, use_adaptive_sampling=False)
            for _ in range(2):  # the first compiles shaders
                [(_, row)] = pictures(renderer, drawn.scene, drawn.camera, settings, (1,), False)
            rows.append({"scene": "counts", "program": "PointSplat", "series": "count", **described(drawn, settings),
                         **row, "rmse": None, "psnr": None, "flip": None})  # fmt: skip
    return rows


# ---------------------------------------------------------------------------- other programs


def other(name: str, program: str, samples: int, seconds: float, **more: object) -> Row:
    plain = {"technique": None, "tolerance": None, "shadow_resolution": None, "dof_method": None, "points": None}
    return {"scene": name, "program": program, "series": "other", **plain, "samples": samples, "seconds": seconds,
            "prepare": None, "passes": {}, "bytes": None, **more}  # fmt: skip


def blender_picture(path: Path) -> tuple[np.ndarray, float]:
    """The picture (H, W, 4) of the scene as it is set up, scene-linear, bottom row first; seconds of the processor."""
    import bpy

    scene = bpy.context.scene
    scene.render.filepath = str(path)
    start = time.process_time()
    bpy.ops.render.render(write_still=True)
    seconds = time.process_time() - start
    image = bpy.data.images.load(scene.render.filepath)
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    width, height = image.size
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, -1), seconds


def cycles(name: str, truth: np.ndarray, folder: Path, counts: tuple[int, ...], limit: int) -> list[Row]:
    """Direct light only, as PointSplat has it, and the same filter; errors against the truth and, as `own`, against
    what Cycles itself comes to."""
    import bpy

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    settings = scene.cycles
    settings.device, settings.use_adaptive_sampling, settings.use_denoising = "CPU", False, False
    settings.max_bounces, settings.pixel_filter_type = 0, "BLACKMAN_HARRIS"
    settings.filter_width = FILTER_WIDTH / 2  # Cycles doubles it for this window
    path = folder / "cycles.exr"

    def draw(samples: int, seed: int) -> tuple[np.ndarray, float]:
        settings.samples, settings.seed = samples, seed
        return blender_picture(path)

    draw(1, 0)  # loads kernels
    limited = draw(limit, 1)[0]
    rows = []
    for samples in counts:
        pixels, seconds = draw(samples, 0)
        own = errors(pixels, limited)["rmse"]
        rows.append(other(name, "Cycles", samples, seconds, own=own, **errors(pixels, truth)))
    return rows


def eevee(name: str, truth: np.ndarray, folder: Path) -> list[Row]:
    """At its defaults: the second of two pictures, for the first compiles shaders."""
    bench_blender = importlib.import_module("bench_blender")
    bench_blender.choose_engine("EEVEE")
    import bpy

    bpy.context.scene.render.filter_size = FILTER_WIDTH
    samples = bpy.context.scene.eevee.taa_render_samples
    blender_picture(folder / "eevee.exr")
    pixels, seconds = blender_picture(folder / "eevee.exr")
    return [other(name, "EEVEE", samples, seconds, **errors(pixels, truth))]


def vtk(name: str, truth: np.ndarray, folder: Path, counts: tuple[int, ...], size: int) -> list[Row]:
    """Opaque disks that face the camera, from one to sixteen samples a pixel: pictures of so many more pixels,
    averaged; and costs of one sample. Nothing where VTK cannot draw."""
    rows = []
    for count in counts:
        across = disk_radius(count) / bench_frame.radius(1.0, size)
        for fine in (1, 2, 4) if count == CLOUD else (1,):
            theirs = bench_frame.Theirs(sphere(count), size * fine)
            path = folder / "vtk.png"
            try:
                theirs.frame("disk", across, 0.0)
                # The radius is of a picture of bench_frame.SIZE: `across` is in its units whatever the window's size.
                _, seconds = theirs.times("disk", across * fine, 0.0)
                theirs.frame("disk", across * fine, 0.0, str(path))
            except (EOFError, OSError):
                return []
            finally:
                theirs.close()
            pixels = np.asarray(Image.open(path).convert("RGB"), float)[::-1] / 255
            pixels = pixels.reshape(size, fine, size, fine, 3).mean(axis=(1, 3))
            row = other(name, "VTK", fine**2, seconds, **errors(pixels, truth)) | {"points": count}
            rows += [row] if count == CLOUD else []
            rows += [row | {"scene": "counts", "series": "count"}] if fine == 1 and count in COUNTS else []
    return rows


def vtk_volume(name: str, truth: np.ndarray, camera: Camera) -> list[Row]:
    """The plume, with so many more pixels averaged. Nothing where VTK is missing."""
    if not find_spec("vtk"):
        return []
    values, world_from_index = plume_field()
    rows = []
    for fine in (1, 2, 4):
        focal = float(camera.clip_from_view[1, 1])
        view = VolumeView(values, world_from_index, EXTINCTION, camera.view_from_world, focal, PLUME * fine)
        view.frame()  # what is made once
        pixels, seconds = view.frame()
        view.close()
        pixels = pixels.reshape(PLUME, fine, PLUME, fine, 3).mean(axis=(1, 3))
        rows.append(other(name, "VTK", fine**2, seconds, **errors(pixels, truth)))
    return rows


def theirs(name: str, truth: np.ndarray, size: int, data: Path, folder: Path, with_eevee: bool) -> list[Row]:
    if KINDS[name].build is None:
        return vtk(name, truth, folder, tuple(sorted({*COUNTS, CLOUD})), size)
    seen = subject(name, size, data, folder)
    if with_eevee:
        return eevee(name, truth, folder)
    voxels = vtk_volume(name, truth, seen.camera) if KINDS[name].build is plume else []
    return voxels + cycles(name, truth, folder, CYCLES, CYCLES_LIMIT)


# ---------------------------------------------------------------------------- processes


def work(what: str, name: str, arguments: argparse.Namespace) -> None:
    """In a process of its own: the rows of one scene, of PointSplat or of other programs."""
    folder: Path = arguments.worker_folder
    truth = folder / "truth.npy"
    if what == "ours":
        renderer = Renderer(ProcessorDevice())
        drawn = subject(name, SIZE, arguments.data, folder)
        found, rows = ours(renderer, name, drawn, tuple(arguments.tolerances), tuple(arguments.samples))
        np.save(truth, found)
        if KINDS[name].build is None:
            rows += counted(renderer, COUNTS, SIZE)
    else:
        rows = theirs(name, np.load(truth), SIZE, arguments.data, folder, what == "eevee")
    (folder / f"{what}.json").write_text(json.dumps(rows), encoding="utf-8")


def in_processes(names: list[str], arguments: argparse.Namespace) -> list[Row]:
    """Rows of scenes, in place of those that are known of them; what fails is told and left out."""
    rows: list[Row] = json.loads(arguments.rows.read_text(encoding="utf-8")) if arguments.rows.exists() else []
    for name in names:
        with tempfile.TemporaryDirectory() as folder:
            drawn_again = (name,) if KINDS[name].build else (name, "counts")
            kept = () if arguments.eevee else ("EEVEE",)
            rows = [row for row in rows if row["scene"] not in drawn_again or row["program"] in kept]
            for what in ("ours", "theirs", *(("eevee",) if KINDS[name].build and arguments.eevee else ())):
                command = [sys.executable, __file__, "--worker", what, name, "--worker-folder", folder]
                command += ["--data", str(arguments.data), "--tolerances", *map(str, arguments.tolerances)]
                command += ["--samples", *map(str, arguments.samples)]
                start = time.perf_counter()
                try:
                    done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, cwd=ROOT)
                    told = [] if done.returncode == 0 else done.stderr.splitlines()[-3:]
                except subprocess.TimeoutExpired:
                    told = [f"took longer than {LIMIT} s"]
                result = Path(folder, f"{what}.json")
                rows += json.loads(result.read_text(encoding="utf-8")) if result.exists() else []
                said = "; ".join(told) if told else f"{time.perf_counter() - start:.0f} s"
                sys.stderr.write(f"{name}, {what}: {said}\n")
        order = ("counts", *KINDS)
        rows.sort(key=lambda row: (order.index(row["scene"]), row["program"] != "PointSplat", row["program"]))
        save(rows, arguments.rows)
    return rows


def quick(size: int = 64, count: int = 3000) -> list[Row]:
    """The sphere, of few points, at two tolerances."""
    device = ProcessorDevice()
    renderer = Renderer(device)
    try:
        _, rows = ours(renderer, "sphere of points", sphere_subject(count, size), (4.0, 1.0), (1, 4))
        return rows + counted(renderer, (count, 4 * count), size)
    finally:
        renderer.release()
        device.release()


def rounded(value: object) -> object:
    """Floats of six digits."""
    if isinstance(value, dict):
        return {key: rounded(item) for key, item in value.items()}
    return float(f"{value:.6g}") if isinstance(value, float) else value


def save(rows: list[Row], path: Path | None) -> None:
    """One row a line."""
    if path is not None:
        lines = ",\n".join(json.dumps(rounded(row), separators=(",", ":")) for row in rows)
        path.write_text(f"[\n{lines}\n]\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=Path(os.environ.get("POINTSPLAT_DATA", "")), help="real meshes")
    parser.add_argument("--only", nargs="+", choices=KINDS, help="names of scenes")
    parser.add_argument("--tolerances", type=float, nargs="+", default=TOLERANCES, help="in pixels, coarse ones first")
    parser.add_argument("--samples", type=int, nargs="+", default=SAMPLES, help="of PointSplat, few first")
    parser.add_argument("--quick", action="store_true", help="does it run at all?")
    parser.add_argument("--no-eevee", dest="eevee", action="store_false", help="which takes long without a GPU")
    parser.add_argument("--docs", type=Path, default=ROOT / "docs", help="where the page is that is written to")
    parser.add_argument("--rows", type=Path, help="where the rows go; by default into DOCS")
    parser.add_argument("--from", dest="known", type=Path, help="rows that were measured before: draws them again")
    parser.add_argument("--worker", nargs=2, metavar=("WHAT", "NAME"), help=argparse.SUPPRESS)
    parser.add_argument("--worker-folder", type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        what, name = arguments.worker
        work(what, name, arguments)
        return
    if arguments.quick:
        save(quick(), arguments.rows)
        return
    arguments.rows = arguments.rows or arguments.docs / "error_vs_time.json"
    if arguments.known:
        rows = json.loads(arguments.known.read_text(encoding="utf-8"))
    else:
        there = [name for name, kind in KINDS.items() if not kind.needs or (arguments.data / kind.needs).exists()]
        rows = in_processes([name for name in there if not arguments.only or name in arguments.only], arguments)
    page = arguments.docs / "error_vs_time.md"
    page.write_text(written(page.read_text(encoding="utf-8"), rows), encoding="utf-8")
    if find_spec("matplotlib"):
        images = arguments.docs / "images"
        plot(rows, images / "error_vs_time.png")
        plot_brief(rows, images / "error_vs_time_brief.png")
        plot_counts(rows, images / "cost_over_points.png")
    else:
        sys.stderr.write(f"no plot without matplotlib: --from {arguments.rows} where it is installed\n")


if __name__ == "__main__":
    from leaving import run

    run(main)
