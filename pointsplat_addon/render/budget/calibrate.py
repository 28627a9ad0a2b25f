"""How fast a device draws points and triangles in image space: `core.lod.cost.Costs`, measured by drawing a few small
scenes. The visibility buffer draws meshes by triangles whatever they cost (docs/notes/techniques.md)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import count

import numpy as np

from ...core.lod.cost import Costs
from ...core.scene.camera import Camera
from ...core.scene.cloud import PointCloud
from ...core.scene.materials import default_materials
from ...core.scene.mesh import Mesh
from ...core.scene.scene import Geometry, Instances, Scene
from ...core.scene.settings import Settings
from ...core.scene.world import World
from ..frame.frame import Frame
from ..plan.request import Request
from .protocol import SampleRenderer

SIZE = 256  # pixels
# Splats and triangles: what a scene of many takes longer is their own cost. Many are more than there are pixels, as of
# what may be either: of fewer, each splat brings a pixel of its own to resolve, and triangles fit into caches.
FEW, MANY = 1 << 10, 1 << 17
INSTANCES = 64
FILLED = 4  # layers of triangles that fill the picture
TURNS = 5  # of which the fastest counts: nothing makes a device faster than it is
MADE = 1 << 13  # triangles of a mesh that is prepared as points and as triangles
LEGS = 2.0  # pixels: of these triangles, so that they have several samples each
NUMBER = count()  # of meshes that were prepared: what is kept of one that is known costs nothing
LEAST = 1e-3  # nanoseconds: differences below the clock's resolution are no cost of nothing


def calibrate(renderer: SampleRenderer, clock: Callable[[], float] = time.perf_counter) -> Costs:
    """Measures the costs of the renderer's device, on the thread that it belongs to. Once shaders are compiled it takes
    1.4 s of processor time of the software renderer. `clock` in seconds.
    DeviceError: it cannot draw."""
    scenes = {
        "few points": _points(FEW), "many points": _points(MANY),
        "few triangles": _triangles(FEW), "many triangles": _triangles(MANY),
        "one layer": _layers(1), "layers": _layers(1 + FILLED),
        "one draw": _repeated(1), "draws": _repeated(INSTANCES),
    }  # fmt: skip
    seconds = _seconds(renderer, scenes, clock)

    def each(many: str, few: str, count: float) -> float:
        return max(1e9 * (seconds[many] - seconds[few]) / count, LEAST)

    point = each("many points", "few points", MANY - FEW)
    triangle = each("many triangles", "few triangles", MANY - FEW)
    # Both pictures hold few things, and differ by the passes over all pixels that points need.
    pixel = 1e9 * (seconds["few points"] - seconds["one draw"]) - FEW * point
    prepared, uploaded = _once(renderer, clock)
    return Costs(
        point=point,
        pixel=max(pixel / SIZE**2, LEAST),
        triangle=triangle,
        fragment=each("layers", "one layer", FILLED * SIZE**2),
        draw=each("draws", "one draw", INSTANCES - 1),
        prepared=prepared,
        uploaded=uploaded,
    )


def _once(renderer: SampleRenderer, clock: Callable[[], float]) -> tuple[float, float]:
    """Returns the nanoseconds of all that is done for a splat of a mesh, and for a triangle, before the first sample is
    drawn."""
    request, turns = _request(), []
    for _ in range(TURNS):
        mesh = _triangles(MADE, LEGS, f"{next(NUMBER)}").geometries[0]
        points, from_points = _started(renderer, replace(mesh, primitive="POINTS"), request, clock)
        # What is looked at of a mesh before anything is chosen is known by now.
        _, from_triangles = _started(renderer, mesh, request, clock)
        turns.append((from_points / max(points, 1), from_triangles / MADE))
    prepared, uploaded = (max(1e9 * min(turn), LEAST) for turn in zip(*turns, strict=True))
    return prepared, uploaded


def _started(
    renderer: SampleRenderer, geometry: Geometry, request: Request, clock: Callable[[], float]
) -> tuple[int, float]:
    """Returns how many points a picture has, and the seconds until the first sample of it can be drawn."""
    start = clock()
    frame = renderer.start(_scene(geometry, np.zeros(1)), request)
    try:
        frame.device.read(frame.color)  # waits for what was uploaded
        return frame.frame_plan.prepared.total, clock() - start
    finally:
        frame.release()


def _seconds(renderer: SampleRenderer, scenes: dict[str, Scene], clock: Callable[[], float]) -> dict[str, float]:
    """Times one more sample of each scene that is on the device already, until it is finished. They take turns, so that
    what else the machine does slows all of them."""
    request = _request()
    frames: dict[str, Frame] = {}
    try:
        for name, scene in scenes.items():
            frames[name] = renderer.start(scene, request)
            _sample(frames[name])  # compiles shaders
        turns = [{name: _timed(frame, clock) for name, frame in frames.items()} for _ in range(TURNS)]
    finally:
        for frame in frames.values():
            frame.release()
    return {name: min(turn[name] for turn in turns) for name in scenes}


def _sample(frame: Frame) -> None:
    frame.done = 0
    frame.sample()
    frame.device.read(frame.color)


def _timed(frame: Frame, clock: Callable[[], float]) -> float:
    start = clock()
    _sample(frame)
    return clock() - start


def _request() -> Request:
    settings = Settings(technique="IMAGE_SPACE", use_shadows=False, use_adaptive_sampling=False)
    return Request(_camera(), settings, frozenset({"combined"}), 1)


def _camera() -> Camera:
    """Looks along -Z at the square from -1 to 1, in parallel."""
    clip = np.diag([1.0, 1.0, -2 / 9.8, 1.0])
    clip[2, 3] = -10.2 / 9.8
    view = np.eye(4)
    view[2, 3] = -5.0
    return Camera(view, clip, (SIZE, SIZE), near=0.2, far=10.0)


def _scene(geometry: Geometry, depth: np.ndarray) -> Scene:
    matrices = np.tile(np.eye(4), (len(depth), 1, 1))
    matrices[:, 2, 3] = depth
    return Scene(
        (geometry,), Instances(np.zeros(len(depth), np.int32), matrices), default_materials(), world=World(np.ones(3))
    )


def _grid_points(count: int) -> np.ndarray:
    """Returns points (count, 3) float32, row by row over the square."""
    side = int(np.ceil(np.sqrt(count)))
    i = np.arange(count)
    return (np.stack([(i % side + 0.5) / side, (i // side + 0.5) / side, 0 * i], axis=1) * 2 - [1, 1, 0]).astype("f4")


def _points(count: int) -> Scene:
    normal = np.tile(np.array([0, 0, 1], np.float32), (count, 1))
    cloud = PointCloud(_grid_points(count), normal=normal, radii=np.full((count, 1), 1.5 / SIZE, np.float32))
    return _scene(Geometry(f"calibration {count} points", "Calibration", cloud=cloud), np.zeros(1))


def _triangles(count: int, legs: float = 0.5, name: str = "") -> Scene:
    """Returns a scene of right triangles with legs of so many pixels."""
    corner = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32) * np.float32(2 * legs / SIZE)
    position = (_grid_points(count)[:, None] + corner).reshape(-1, 3)
    triangles = np.arange(3 * count, dtype=np.int32).reshape(-1, 3)
    mesh = Mesh(f"calibration {count} triangles {name}", "Calibration", position, triangles)
    return _scene(Geometry(mesh.key, mesh.name, mesh=mesh, primitive="POLYGONS"), np.zeros(1))


def _square() -> Geometry:
    position = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    mesh = Mesh("calibration square", "Calibration", position, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    return Geometry(mesh.key, mesh.name, mesh=mesh, primitive="POLYGONS")


def _layers(count: int) -> Scene:
    """Squares that fill the picture, the farthest first, so that each is drawn."""
    return _scene(_square(), np.linspace(-2, 2, count) if count > 1 else np.zeros(1))


def _repeated(count: int) -> Scene:
    """Instances of one small triangle, each a draw of its own."""
    mesh = _triangles(1).geometries[0]
    return _scene(mesh, np.linspace(2, -2, count))
