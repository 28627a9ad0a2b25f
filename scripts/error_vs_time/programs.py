"""Pictures of Cycles, EEVEE and VTK for scripts/error_vs_time/measure.py, of the scene that is open in Blender."""

from __future__ import annotations

import importlib
import time
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from PIL import Image

from pointsplat_addon.core.numeric.pixel_filter import FILTER_SIZE, blackman_harris
from pointsplat_addon.core.scene.camera import Camera
from scripts.benchmarks import frame
from scripts.error_vs_time.curves import Row, Truths, errors
from scripts.error_vs_time.scenes import CLOUD, KINDS, SCAN_FILE, SCAN_RADIUS, disk_radius, scan, sphere, subject
from scripts.error_vs_time.truths import EXTINCTION, VOXELS, voxel_field
from scripts.error_vs_time.vtk_volume import VolumeView

CYCLES = (1, 4, 16, 64, 256)
CONVERGED = 1024  # samples of each of the two pictures that tell what Cycles comes to
SEEDS = 101, 202  # of their random numbers
EEVEE = (1, 16)  # samples, beside the default
FINE = (1, 2, 4)  # times as many pixels a side of VTK's, averaged


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


def cycles_pictures(folder: Path, samples_and_seeds: Iterable[tuple[int, int]]) -> Iterator[tuple[np.ndarray, float]]:
    """Pictures of Cycles and their seconds, of the open scene: direct light only, as PointSplat has it, and the same
    filter."""
    import bpy

    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    settings = scene.cycles
    settings.device, settings.use_adaptive_sampling, settings.use_denoising = "CPU", False, False
    settings.max_bounces, settings.pixel_filter_type, settings.filter_width = 0, "BLACKMAN_HARRIS", FILTER_SIZE
    settings.samples = 1
    blender_picture(folder / "cycles.exr")  # loads kernels
    for settings.samples, settings.seed in samples_and_seeds:
        yield blender_picture(folder / "cycles.exr")


def cycles(name: str, truths: Truths, folder: Path) -> list[Row]:
    drawn = zip(CYCLES, cycles_pictures(folder, ((samples, 0) for samples in CYCLES)), strict=True)
    return [other(name, "Cycles", samples, seconds, **errors(pixels, truths)) for samples, (pixels, seconds) in drawn]


def converged(name: str, size: int, data: Path, folder: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Two independent pictures of Cycles with many samples; None of a scene that Blender does not have."""
    if KINDS[name].build is None:
        return None
    subject(name, size, data, folder)
    first, second = (pixels for pixels, _ in cycles_pictures(folder, ((CONVERGED, seed) for seed in SEEDS)))
    return first, second


def eevee(name: str, truths: Truths, folder: Path) -> list[Row]:
    """At its defaults, and with fewer samples. A picture before compiles shaders."""
    bench_blender = importlib.import_module("scripts.benchmarks.blender")
    bench_blender.choose_engine("EEVEE")
    import bpy

    bpy.context.scene.render.filter_size = FILTER_SIZE
    settings = bpy.context.scene.eevee
    counts = *EEVEE, settings.taa_render_samples
    rows = []
    for samples in (1, *counts):
        settings.taa_render_samples = samples
        pixels, seconds = blender_picture(folder / "eevee.exr")
        rows.append(other(name, "EEVEE", samples, seconds, **errors(pixels, truths)))
    return rows[1:]


def vtk(name: str, truths: Truths, folder: Path, data: Path, size: int, counts: tuple[int, ...]) -> list[Row]:
    """Opaque disks that face the camera, from one to sixteen samples a pixel: pictures of so many more pixels,
    averaged. `counts`: costs of one sample of so many points of the sphere."""
    if KINDS[name].build is not None:
        return vtk_points(name, truths, folder, size, scan((data / SCAN_FILE).resolve()), SCAN_RADIUS)
    rows = vtk_points(name, truths, folder, size, sphere(CLOUD), disk_radius(CLOUD))
    for count in counts:
        one = vtk_points("counts", truths, folder, size, sphere(count), disk_radius(count), (1,))
        rows += [row | {"series": "count"} for row in one]
    return rows


def vtk_points(
    name: str, truths: Truths, folder: Path, size: int, cloud: tuple, radius: float, times: tuple[int, ...] = FINE
) -> list[Row]:
    """Rows of a cloud: positions and colours (N, 3), of disks of one radius. None where VTK cannot draw."""
    across = radius / frame.radius(1.0, size)
    rows = []
    for fine in times:
        theirs = frame.Theirs(cloud, size * fine)
        path = folder / "vtk.png"
        try:
            theirs.frame("disk", across * fine, 0.0)
            # A window's radius in pixels is that of its own size.
            _, seconds = theirs.times("disk", across * fine, 0.0)
            theirs.frame("disk", across * fine, 0.0, str(path))
        except (EOFError, OSError):
            return []
        finally:
            theirs.close()
        pixels = np.asarray(Image.open(path).convert("RGB"), float)[::-1] / 255
        pixels = filtered(pixels, fine)
        rows.append(other(name, "VTK", fine**2, seconds, **errors(pixels, truths)) | {"points": len(cloud[0])})
    return rows


def filtered(pixels: np.ndarray, fine: int) -> np.ndarray:
    """The picture (H, W, 3) of one with `fine` times as many pixels a side, by the pixel filter."""
    taken = 2 * int(FILTER_SIZE + 1) + 1  # pixels, of which the middle one is the pixel itself
    weights = blackman_harris((np.arange(taken * fine) + 0.5) / fine - taken / 2, FILTER_SIZE)
    for axis in (0, 1):
        around = [(0, 0)] * 3
        around[axis] = taken // 2 * fine, taken // 2 * fine
        windows = np.lib.stride_tricks.sliding_window_view(np.pad(pixels, around, mode="edge"), taken * fine, axis)
        pixels = np.take(windows, np.arange(0, pixels.shape[axis], fine), axis) @ (weights / weights.sum())
    return pixels


def vtk_volume(name: str, truths: Truths, camera: Camera) -> list[Row]:
    """The voxels of the open scene, with so many more pixels averaged. Nothing where VTK is missing."""
    if not find_spec("vtk"):
        return []
    values, world_from_index = voxel_field()
    rows = []
    for fine in (1, 2, 4):
        focal = float(camera.clip_from_view[1, 1])
        view = VolumeView(values, world_from_index, EXTINCTION, camera.view_from_world, focal, VOXELS * fine)
        view.frame()  # what is made once
        pixels, seconds = view.frame()
        view.close()
        pixels = filtered(pixels, fine)
        rows.append(other(name, "VTK", fine**2, seconds, **errors(pixels, truths)))
    return rows


def theirs(
    name: str, truths: Truths, size: int, data: Path, folder: Path, counts: tuple[int, ...], with_eevee: bool
) -> list[Row]:
    """Rows of the other programs, or of EEVEE alone."""
    kind = KINDS[name]
    rows = vtk(name, truths, folder, data, size, counts) if kind.vtk == "points" and not with_eevee else []
    if kind.build is None:
        return rows
    seen = subject(name, size, data, folder)
    if with_eevee:
        return eevee(name, truths, folder)
    rows += vtk_volume(name, truths, seen.camera) if kind.vtk == "voxels" else []
    return rows + cycles(name, truths, folder)
