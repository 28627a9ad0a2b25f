"""One frame of a static cloud on moderngl's device: against VTK, by pass, and what it uploads.

A million points with normals as disks, and one and ten million as balls, which the visibility buffer draws.

python -m scripts.benchmarks.frame [--quick] [--no-vtk]

VTK draws in a process of its own, so that neither context disturbs the other; the two take turns, frame by frame.
"""

from __future__ import annotations

import argparse
import multiprocessing
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.util import find_spec
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.frame.report import report
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer

SIZE = 1024  # pixels
SETTINGS = Settings(technique="IMAGE_SPACE", use_shadows=False, use_adaptive_sampling=False)
DISTANCE = 4.0  # of the camera from the centre of the unit sphere
FOCAL = 3.5  # distance of the picture over half its side: the sphere is 920 pixels wide
VISIBLE_DEPTH = (3 + 3.75) / 2  # mean distance of the visible cap's points along the view, uniform in [3, 3.75]
TURN = np.radians(3.0)  # of the camera from frame to frame
SPLATS = ("gaussian", "disk")
TARGETS = {1: ">= 4", 2: ">= 4", 4: ">= 4", 8: ">= 10"}  # by splat radius in pixels
BLENDED_AT, BLENDED_TARGET = 2, "<= 4"  # radius in pixels at which EWA has a limit, and that, over image space
BLENDED_VTK = {2: ">= 0.5", 8: ">= 1"}  # VTK's time over that of EWA, by splat radius in pixels
BALLS, BALLS_TARGET = (1_000_000, 10_000_000), ">= 10"  # VTK's time over that of the visibility buffer, at every radius
TABLES = 4 << 20  # bytes: a frame may upload tables of blocks and uniforms, never a million points (32 MB)


def sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(positions, which are the normals too, and colours), each (N, 3) float32: uniform on the unit sphere."""
    rng = np.random.default_rng(0)
    position = rng.standard_normal((count, 3))
    position /= np.linalg.norm(position, axis=1, keepdims=True)
    return position.astype(np.float32), rng.random((count, 3), np.float32)


def radius(pixels: float, size: int) -> float:
    """The radius of splats in object space whose projection has `pixels` at the visible points' mean depth."""
    return pixels * VISIBLE_DEPTH / (FOCAL * size / 2)


def camera(angle: float, size: int) -> Camera:
    """Around the sphere at the height of its centre."""
    cos, sin = np.cos(angle), np.sin(angle)
    view = np.array([[cos, 0, -sin, 0], [0, 1, 0, 0], [sin, 0, cos, -DISTANCE], [0, 0, 0, 1.0]])
    near, far = 0.1, 100.0
    depth = -(far + near) / (far - near), -2 * far * near / (far - near)
    clip = np.array([[FOCAL, 0, 0, 0], [0, FOCAL, 0, 0], [0, 0, *depth], [0, 0, -1.0, 0]])
    return Camera(view, clip, (size, size), near=near, far=far)


def scene(points: tuple[np.ndarray, np.ndarray], radius: float, lit: bool, balls: bool = False) -> Scene:
    """The sphere with its colours as emission, or as base colour under one sun. balls: its points have no normals."""
    position, color = points
    table, normal = default_materials(), None if balls else position
    radii = np.full((len(position), 1), radius, np.float32)
    if lit:
        cloud = PointCloud(position, normal=normal, radii=radii, color=color)
        lights = (Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([-0.48, -0.6, -0.64])),)
    else:
        table = replace(table, base_color=np.zeros((1, 3), np.float32), specular=np.zeros(1, np.float32))
        cloud = PointCloud(position, normal=normal, radii=radii, emission=color)
        lights = ()
    geometry = Geometry(f"sphere {len(position)} {radius} {lit} {balls}", "Sphere", cloud=cloud)
    return Scene((geometry,), Instances(np.zeros(1, np.int32), np.eye(4)[None]), table, lights, World())


class MeteredDevice(OpenGLDevice):
    """Counts what crosses to the device, and times passes by the clock with the device finished before and after:
    software renderers answer timer queries with the time of one of their threads, for one of their tiles."""

    uploaded = 0  # bytes
    timed = False  # finish the device around every pass

    def texture(self, size, format, data=None):
        made = super().texture(size, format, data)
        self.uploaded += 0 if data is None else made.nbytes
        return made

    def _bind(self, interface, program, uniforms, textures):
        self.uploaded += 0 if uniforms is None else uniforms.nbytes
        super()._bind(interface, program, uniforms, textures)

    def start_timer(self):
        return Stopwatch(self)

    def stop_timer(self, timer):
        timer.stop()


class Stopwatch:
    def __init__(self, device: MeteredDevice, clock: Callable[[], float] = time.perf_counter) -> None:
        self._device, self._clock = device, clock
        self._finish()
        self._start = clock()

    def _finish(self) -> None:
        if self._device.timed:
            self._device.finish()

    def stop(self) -> None:
        self._finish()
        self._elapsed = self._clock() - self._start

    def milliseconds(self) -> float:
        return 1e3 * self._elapsed

    def release(self) -> None:
        pass


@dataclass
class Ours:
    """Draws frames of one scene."""

    renderer: Renderer
    device: MeteredDevice
    scene: Scene
    size: int
    technique: str = SETTINGS.technique

    def frame(self, angle: float, samples: int = 1) -> dict[str, Any]:
        """Draw a picture until the device has finished it; the report, its seconds being the time of all."""
        settings = replace(SETTINGS, technique=self.technique)
        request = Request(camera(angle, self.size), settings, frozenset({"combined"}), samples)
        start = time.perf_counter()
        frame = self.renderer.start(self.scene, request)
        started = time.perf_counter()
        while frame.done < samples:
            frame.sample()
        self.device.finish()
        drawn = time.perf_counter()
        told = report(frame, drawn - start)
        pixels = frame.pixels() if self.device.timed else {}
        read = time.perf_counter()
        frame.release()
        stages = {"prepare, allocate": started - start, "read back": read - drawn if pixels else 0.0}
        return {**told, "stages": stages}

    def times(self, angle: float) -> tuple[float, float]:
        """Seconds of one frame by the clock, and of the processor."""
        busy = time.process_time()
        return self.frame(angle)["seconds"], time.process_time() - busy


# ---------------------------------------------------------------------------- VTK


def vtk_worker(pipe: Connection, cloud: tuple[np.ndarray, np.ndarray] | int, size: int) -> None:
    """Answers (splat, radius in pixels, angle) with the seconds of a frame, those of the processor in all threads, and
    the name of VTK's renderer. Draws positions and colours (N, 3), or a sphere of so many points."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk

    position, color = sphere(cloud) if isinstance(cloud, int) else cloud
    points, data = vtk.vtkPoints(), vtk.vtkPolyData()
    points.SetData(numpy_to_vtk(position, deep=1))
    data.SetPoints(points)
    data.GetPointData().SetScalars(numpy_to_vtk((255 * color + 0.5).astype(np.uint8), deep=1))
    windows: dict[tuple, tuple[Any, Any]] = {}

    def make(splat: str, pixels: float) -> tuple[Any, Any]:
        mapper = vtk.vtkPointGaussianMapper()
        mapper.SetInputData(data)
        mapper.EmissiveOff()
        # Both splats end at three times the scale: VTK's triangle encloses that circle.
        mapper.SetScaleFactor(radius(pixels, size) / 3)
        if splat == "disk":
            mapper.SetSplatShaderCode(
                "//VTK::Color::Impl\nif (dot(offsetVCVSOutput.xy, offsetVCVSOutput.xy) > 9.0) discard;\n"
            )
        actor = vtk.vtkActor()
        actor.SetMapper(mapper)
        actor.GetProperty().LightingOff()
        actor.ForceOpaqueOn()
        renderer = vtk.vtkRenderer()
        renderer.AddActor(actor)
        window = getattr(vtk, "vtkEGLRenderWindow", vtk.vtkRenderWindow)()
        window.SetOffScreenRendering(1)
        window.SetMultiSamples(0)
        window.SetSize(size, size)
        window.AddRenderer(renderer)
        view = renderer.GetActiveCamera()
        view.SetFocalPoint(0, 0, 0)
        view.SetViewAngle(2 * np.degrees(np.arctan(1 / FOCAL)))
        view.SetClippingRange(0.1, 100)
        return window, view

    while (asked := pipe.recv()) is not None:
        splat, pixels, angle, picture = asked
        key = splat, pixels
        if key not in windows:
            for window, _ in windows.values():
                window.Finalize()
            windows.clear()
            windows[key] = make(*key)
        window, view = windows[key]
        view.SetPosition(DISTANCE * np.sin(angle), 0, DISTANCE * np.cos(angle))
        start, busy = time.perf_counter(), time.process_time()
        window.Render()
        window.WaitForCompletion()
        seconds, processor = time.perf_counter() - start, time.process_time() - busy
        if picture:
            save_vtk(window, picture)
        pipe.send((seconds, processor, window.GetClassName()))


def save_vtk(window, path: str) -> None:
    import vtk

    grab, writer = vtk.vtkWindowToImageFilter(), vtk.vtkPNGWriter()
    grab.SetInput(window)
    writer.SetInputConnection(grab.GetOutputPort())
    writer.SetFileName(path)
    writer.Write()


class Theirs:
    """VTK in its own process."""

    def __init__(self, cloud: tuple[np.ndarray, np.ndarray] | int, size: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=vtk_worker, args=(other, cloud, size), daemon=True)
        self._process.start()
        other.close()

    def frame(self, splat: str, pixels: float, angle: float, picture: str = "") -> float:
        """Seconds of one frame. EOFError: VTK could not draw."""
        return self.times(splat, pixels, angle, picture)[0]

    def times(self, splat: str, pixels: float, angle: float, picture: str = "") -> tuple[float, float]:
        """Seconds of one frame by the clock, and of the processor. EOFError: VTK could not draw."""
        self._pipe.send((splat, pixels, angle, picture))
        return self._pipe.recv()[:2]

    def close(self) -> None:
        if self._process.is_alive():
            self._pipe.send(None)
        self._process.join(30)
        self._process.terminate()


# ---------------------------------------------------------------------------- rows


def row(name: str, value: float | None, unit: str, target: str = "", note: str = "") -> dict:
    return {"name": name, "value": value, "unit": unit, "target": target, "note": note}


def spread(values: list[float], unit: str = "") -> str:
    return f"{min(values):.3g} to {max(values):.3g}{unit}"


def against_vtk(ours: Callable[[float, bool], Ours], count: int, frames: int, quick: bool) -> list[dict]:
    """Ratios for each radius, shader of VTK's and lighting of ours; each frame of ours beside one of each of VTK's."""
    rows = []
    theirs = Theirs(count, SIZE)
    try:
        for pixels, target in TARGETS.items():
            for splat in SPLATS:
                unlit, lit = ours(pixels, False), ours(pixels, True)
                turns = []
                for i in range(frames + 1):
                    angle = i * TURN
                    turns.append((theirs.frame(splat, pixels, angle), unlit.frame(angle)["seconds"],
                                  lit.frame(angle)["seconds"]))  # fmt: skip
                # The first frames compile and upload.
                vtk, *mine = np.array(turns[1:]).T
                for name, times in zip(("unlit", "one sun"), mine, strict=True):
                    ratios = list(vtk / times)
                    note = (f"{1e3 * np.median(vtk):.0f} ms against {1e3 * np.median(times):.0f} ms; "
                            f"{spread(ratios)} in {frames} turns")  # fmt: skip
                    title = f"frame, radius {pixels} px, {name}, VTK {splat} / PointSplat"
                    rows.append(row(title, float(np.median(ratios)), "x", target, note))
    except (EOFError, OSError):
        rows.append(row("frame, VTK / PointSplat", None, "x", ">= 4", "VTK could not draw here"))
    finally:
        theirs.close()
    return rows


def balls_against_vtk(renderer: Renderer, device: MeteredDevice, count: int, frames: int) -> list[dict]:
    """Ratios for each radius: balls of the visibility buffer and VTK's disks, without light, each frame beside one of
    VTK's."""
    rows, points, theirs = [], sphere(count), Theirs(count, SIZE)
    try:
        for pixels in TARGETS:
            mine = Ours(renderer, device, scene(points, radius(pixels, SIZE), False, True), SIZE, "VISIBILITY")
            turns = [(*theirs.times("disk", pixels, i * TURN), *mine.times(i * TURN)) for i in range(frames + 1)]
            # The first frames compile and upload.
            vtk, vtk_busy, clock, busy = np.array(turns[1:]).T
            ratios = list(vtk / clock)
            note = (f"{1e3 * np.median(vtk):.0f} ms against {1e3 * np.median(clock):.0f} ms; {spread(ratios)} in "
                    f"{frames} turns; of the processor {np.median(vtk_busy / busy):.1f}")  # fmt: skip
            title = f"frame, {count / 1e6:g} M balls, radius {pixels} px, VTK disk / visibility buffer"
            rows.append(row(title, float(np.median(ratios)), "x", BALLS_TARGET, note))
    except (EOFError, OSError):
        rows.append(
            row(f"frame, {count / 1e6:g} M balls, VTK / PointSplat", None, "x", BALLS_TARGET, "VTK could not draw")
        )
    finally:
        theirs.close()
    return rows


def blended(ours: Callable[[float, bool], Ours], frames: int) -> list[dict]:
    """How many times as long as in image space EWA takes, in turns."""
    rows = []
    for pixels in TARGETS:
        for name, lit in (("unlit", False), ("one sun", True)):
            plain = ours(pixels, lit)
            soft = replace(plain, technique="EWA")
            turns = [(soft.frame(i * TURN)["seconds"], plain.frame(i * TURN)["seconds"]) for i in range(frames + 1)]
            mine, plainly = np.array(turns[1:]).T
            ratios = list(mine / plainly)
            note = (f"{1e3 * np.median(mine):.0f} ms against {1e3 * np.median(plainly):.0f} ms; "
                    f"{spread(ratios)} in {frames} turns")  # fmt: skip
            title = f"frame, radius {pixels} px, {name}, EWA / image space"
            target = BLENDED_TARGET if pixels == BLENDED_AT else ""
            rows.append(row(title, float(np.median(ratios)), "x", target, note))
    return rows


def blended_against_vtk(ours: Callable[[float, bool], Ours], count: int, frames: int) -> list[dict]:
    """VTK's blended Gaussians and EWA, both without light, in turns."""
    rows = []
    theirs = Theirs(count, SIZE)
    try:
        for pixels, target in BLENDED_VTK.items():
            soft = replace(ours(pixels, False), technique="EWA")
            angles = [i * TURN for i in range(frames + 1)]
            turns = [(theirs.frame("gaussian", pixels, angle), soft.frame(angle)["seconds"]) for angle in angles]
            vtk, mine = np.array(turns[1:]).T
            ratios = list(vtk / mine)
            note = (f"{1e3 * np.median(vtk):.0f} ms against {1e3 * np.median(mine):.0f} ms; "
                    f"{spread(ratios)} in {frames} turns")  # fmt: skip
            rows.append(
                row(f"frame, radius {pixels} px, VTK gaussian / EWA", float(np.median(ratios)), "x", target, note)
            )
    except (EOFError, OSError):
        rows.append(row("frame, VTK / EWA", None, "x", ">= 0.5", "VTK could not draw here"))
    finally:
        theirs.close()
    return rows


def uploads(ours: Ours) -> dict:
    """Bytes that one more frame of a static cloud uploads."""
    ours.frame(0.0)
    before = ours.device.uploaded
    ours.frame(TURN)
    value = ours.device.uploaded - before
    target = f"<= {TABLES >> 10}"
    return row("frame, uploaded for a static cloud", value / 1024, "KiB", target, "block table, materials, uniforms")


def by_pass(ours: Ours, frames: int, samples: int) -> tuple[dict[str, float], list[float]]:
    """(median milliseconds of each stage of a frame, all totals); passes are summed over samples."""
    ours.device.timed = True
    ours.frame(0.0, samples)
    taken: dict[str, list[float]] = {}
    totals = []
    for i in range(frames):
        told = ours.frame((i + 1) * TURN, samples)
        totals.append(1e3 * told["seconds"])
        stages = {name: 1e3 * s for name, s in told["stages"].items()}
        read = stages.pop("read back")
        stages |= {p["name"]: p["ms"] for p in told["passes"]}
        stages["read back"] = read
        for name, ms in stages.items():
            taken.setdefault(name, []).append(ms)
    ours.device.timed = False
    return {name: float(np.median(ms)) for name, ms in taken.items()}, totals


def split_tables(ours: Callable[[float, bool], Ours], frames: int, samples: int) -> dict[str, list[list[str]]]:
    """Milliseconds by pass for each case, as tables of text."""
    cases = {
        "radius 1, unlit": (ours(1, False), 1),
        "radius 1, one sun": (ours(1, True), 1),
        "radius 8, unlit": (ours(8, False), 1),
        "radius 8, one sun": (ours(8, True), 1),
        f"radius 1, one sun, {samples} samples": (ours(1, True), samples),
    }
    found = {name: by_pass(ours, frames if n == 1 else 1, n) for name, (ours, n) in cases.items()}
    stages = list(dict.fromkeys(stage for split, _ in found.values() for stage in split))
    table = [["ms", *stages, "frame without reading back"]]
    for name, (split, totals) in found.items():
        table.append([name, *(f"{split.get(s, 0.0):.1f}" for s in stages), f"{np.median(totals):.0f}"])
    return {"One frame by pass (the device finished after each)": table}


def run(quick: bool = False, vtk: bool = True) -> tuple[list[dict], dict[str, list[list[str]]]]:
    """(rows of name, value, unit, target and note; tables of text by title)."""
    count, frames = (100_000, 3) if quick else (1_000_000, 7)
    device = MeteredDevice()
    renderer, points = Renderer(device), sphere(count)
    known: dict[tuple[float, bool], Ours] = {}

    def ours(pixels: float, lit: bool) -> Ours:
        if (pixels, lit) not in known:
            known[pixels, lit] = Ours(renderer, device, scene(points, radius(pixels, SIZE), lit), SIZE)
        return known[pixels, lit]

    try:
        rows = []
        told = ours(1, False).frame(0.0)
        note = f"{count} points at {SIZE}x{SIZE} on {told['device']}"
        rows.append(row("frame, points in the cut", 100 * told["points"]["cut"] / count, "%", ">= 100", note))
        rows.append(uploads(ours(1, True)))
        rows += blended(ours, 3)
        if vtk and find_spec("vtk"):
            rows += against_vtk(ours, count, frames, quick)
            rows += blended_against_vtk(ours, count, 3)
            for many in BALLS:
                rows += balls_against_vtk(renderer, device, many // 10 if quick else many, frames)
        elif vtk:
            rows.append(row("frame, VTK / PointSplat", None, "x", ">= 4", "VTK is not installed"))
        return rows, split_tables(ours, 3 if quick else 5, 4 if quick else 16)
    finally:
        renderer.release()
        device.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the points")
    parser.add_argument("--no-vtk", action="store_true", help="PointSplat alone")
    options = parser.parse_args()
    rows, tables = run(options.quick, not options.no_vtk)
    for r in rows:
        value = "-" if r["value"] is None else f"{r['value']:.2f}"
        sys.stdout.write(f"{r['name']:60} {value:>8} {r['unit']:4} {r['target']:8} {r['note']}\n")
    for title, table in tables.items():
        sys.stdout.write(f"\n{title}\n")
        for line in table:
            sys.stdout.write("  ".join(f"{cell:>14}" for cell in line) + "\n")


if __name__ == "__main__":
    main()
