"""Frame after frame of a scene that changes, as a viewport and as final renders, on one device: what is left behind."""

from __future__ import annotations

import ctypes
import gc
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build
from scripts.scenes.build import mesh, moved, points, scene
from scripts.scenes.cameras import camera
from scripts.scenes.case import ALL_PASSES
from scripts.scenes.clouds import smoke_cloud, sphere_cloud
from scripts.scenes.meshes import cube_mesh
from tests.support.extremes import COMBINED, TECHNIQUES, lamp

KEPT = 8 << 20  # bytes that the stores may keep, so that they are full, and let go, long before the end
# Frames, after which the scene and its views come again, as new objects: by then the stores are full and all shaders
# compiled, by PointSplat and by the driver, which keeps its own for each state that it meets.
PERIOD = 180
SHORT = 36  # frames in which each technique has met each kind of frame
SIZES = ((40, 30), (24, 32), (33, 17))


@dataclass(frozen=True)
class Memory:
    process: int  # bytes that lie in memory; 0 where the system does not tell
    device: int  # bytes


def resident() -> int:
    """Bytes of the process that lie in memory, after what can be given back was."""
    if not sys.platform.startswith("linux"):
        return 0
    gc.collect()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def changing(number: int) -> Scene:
    """A mesh that deforms, points that come anew, smoke that comes and goes, strands, and a lamp that wanders."""
    turn = 2 * np.pi * 3 * number / PERIOD
    block = cube_mesh("soaked cube", 0.5)
    bent = (block.position * np.float32(1 + 0.2 * np.sin(turn + block.position[:, :1]))).astype(np.float32)
    deformed = replace(block, key=f"soaked cube {number}", position=bent, topology="soaked cube")
    things = [
        (mesh(deformed, ("POINTS", "POLYGONS")[number % 2]), moved((-0.8, 0, 0))),
        (points(f"soaked points {number}", sphere_cloud(2000 + number % 5)), moved((0.8, 0, 0), 0.6)),
    ]
    if number % 3 == 0:
        things.append((points(f"soaked smoke {number % 9}", smoke_cloud(8)), moved((0, -0.8, 0.5), 0.5)))
    if number % 4 == 0:
        u = np.linspace(0, 1, 8)
        strand = np.stack([np.sin(3 * u + turn), -0.5 + 0 * u, 2 * u - 1], axis=1)
        things.append((build.strand_lines(f"soaked strands {number}", [strand], 0.05), moved()))
    lights = (lamp(("POINT", "SPOT", "AREA")[number % 3], (2 * np.sin(turn), -2, 2), 20), build.sun(1.0))
    return scene(*things, lights=lights)


def draw(renderer: Renderer, number: int) -> None:
    """One frame: three of four as a viewport shows them while something moves, one as a final render."""
    eye = camera((3 * np.sin(2 * np.pi * number / PERIOD), -4, 1), resolution=SIZES[number // 10 % 3])
    settings = Settings(technique=TECHNIQUES[number // 3 % 3], shadow_resolution=32, tolerance=2.0)
    if number % 4 < 3:
        frame = renderer.start(changing(number), Request(eye, settings, COMBINED, 2, interactive=True))
        try:
            while frame.sample():
                pass
        finally:
            frame.release()
        return
    found = renderer.render(changing(number), Request(eye, settings, ALL_PASSES, 2)).pixels["combined"]
    assert np.isfinite(found).all()


def soak(
    renderer: Renderer, frames: int, beside: Callable[[], None] = lambda: None, warm: int = PERIOD
) -> tuple[Memory, Memory]:
    """Memory after the first `warm` frames, and after so many more. `beside` is called after each."""
    store, kept = renderer.store, renderer.kept
    limits = store.limit, kept.limit
    store.limit = kept.limit = KEPT
    seen = []
    try:
        for number in range(warm + frames):
            draw(renderer, number)
            beside()
            if number + 1 in (warm, warm + frames):
                seen.append(Memory(resident(), renderer.device.bytes_allocated()))
    finally:
        store.limit, kept.limit = limits
        store.clear()
    return seen[0], seen[1]
