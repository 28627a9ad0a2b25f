"""bpy.ops.render.render of PointSplat against Cycles, EEVEE and Workbench, each render in a fresh process.

python -m scripts.benchmarks.blender [--quick] [--no-eevee]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from functools import wraps
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]

SAMPLES = 16  # of PointSplat and Cycles; EEVEE and Workbench keep their defaults
SIZES = {"mesh": 1024, "pointcloud": 512, "empty": 1024, "cube": 256}  # pixels
TURN = 0.05  # radians that the camera moves before the second frame
LIMIT = 3600  # seconds for one process
MARK = "RESULT "  # begins the line of the worker's answer, among Blender's own lines

# ---------------------------------------------------------------------------- scenes (in the worker)


def cube_sphere(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """A bumpy sphere of 12 steps^2 triangles: vertices (V, 3) float32 and triangles (T, 3) int32; the edges between
    the six sides are double."""
    u, v = np.meshgrid(*2 * [np.tan(np.linspace(-np.pi / 4, np.pi / 4, steps + 1))], indexing="ij")
    side = np.stack([u, v, np.ones_like(u)], -1).reshape(-1, 3)
    sides = [np.roll(side, i, axis=1) for i in range(3)]
    # A point reflection turns the sense of the triangles over.
    sides += [-s for s in sides]
    position = np.concatenate(sides)
    position /= np.linalg.norm(position, axis=1, keepdims=True)
    x, y, z = position.T
    position *= (1 + 0.04 * np.sin(9 * x) * np.cos(7 * y) + 0.02 * np.sin(31 * z))[:, None]
    corner = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).reshape(-1)
    across, along = corner + steps + 1, corner + 1
    one = np.stack([corner, across, along, along, across, across + 1], 1).reshape(-1, 3)
    triangles = [(one if i < 3 else one[:, ::-1]) + i * len(side) for i in range(6)]
    return position.astype(np.float32), np.concatenate(triangles).astype(np.int32)


def add_mesh(count: int) -> Any:
    import bpy

    position, triangles = cube_sphere(round((count / 12) ** 0.5))
    mesh = bpy.data.meshes.new("Sphere")
    mesh.vertices.add(len(position))
    mesh.vertices.foreach_set("co", position.ravel())
    mesh.loops.add(triangles.size)
    mesh.loops.foreach_set("vertex_index", triangles.ravel())
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()
    return link(bpy.data.objects.new("Sphere", mesh))


def add_pointcloud(count: int) -> Any:
    from scripts.common.point_objects import point_cloud_object

    rng = np.random.default_rng(0)
    position = rng.standard_normal((count, 3)).astype(np.float32)
    position /= np.linalg.norm(position, axis=1, keepdims=True)
    radius = 1.4 * np.sqrt(4 / count)
    return point_cloud_object("Cloud", position, radius)


def link(ob: Any) -> Any:
    import bpy

    bpy.context.collection.objects.link(ob)
    return ob


def build(case: str, count: int) -> None:
    """The scene of a case: what it is about, a camera that sees all of it, and where there is something a sun."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = SIZES[case]
    scene.render.resolution_percentage = 100
    scene.camera = link(bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera")))
    scene.camera.data.angle = 2 * np.arctan(1 / 3.5)
    move_camera(0.0)
    world = scene.world = bpy.data.worlds.new("World")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True  # from 5.0 on it always does
    world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.05, 0.05, 0.05, 1)
    if case == "empty":
        return
    sun = link(bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN")))
    sun.data.energy, sun.rotation_euler = 3.0, (0.6, 0.4, 0.0)
    if case == "cube":
        bpy.ops.mesh.primitive_cube_add(size=1)
        return
    ob = add_mesh(count) if case == "mesh" else add_pointcloud(count)
    material = bpy.data.materials.new("Material")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    ob.data.materials.append(material)


def move_camera(angle: float) -> None:
    import bpy

    ob = bpy.context.scene.camera
    ob.location = 4.4 * np.sin(angle), -4.4 * np.cos(angle), 0.0
    ob.rotation_euler = np.pi / 2, 0.0, angle


def choose_engine(engine: str) -> None:
    """PointSplat by its primitive, another engine by its name; EEVEE has two."""
    import bpy

    scene = bpy.context.scene
    if engine in ("POINTS", "POLYGONS", "AUTO"):
        scene.render.engine = "POINTSPLAT"
        scene.pointsplat.samples = SAMPLES
        for ob in scene.objects:
            ob.pointsplat.primitive = engine
    elif engine == "EEVEE":
        names = [item.identifier for item in bpy.types.RenderSettings.bl_rna.properties["engine"].enum_items]
        scene.render.engine = next(name for name in names if "EEVEE" in name)
    elif engine == "CYCLES":
        scene.render.engine = "CYCLES"
        scene.cycles.device = "CPU"
        scene.cycles.samples = SAMPLES
        scene.cycles.use_denoising = False
    else:
        scene.render.engine = engine


# ---------------------------------------------------------------------------- the worker


def timed_render() -> dict[str, float]:
    """Seconds by the clock, and of the processor in all threads."""
    import bpy

    start, busy = time.perf_counter(), time.process_time()
    bpy.ops.render.render()
    return {"seconds": time.perf_counter() - start, "processor": time.process_time() - busy}


class Stages:
    """Time that the parts of PointSplat's render take, each without those within it; they follow one another, whatever
    thread they run on."""

    def __init__(self) -> None:
        from pointsplat_addon.devices.opengl import OpenGLDevice
        from pointsplat_addon.host import final
        from pointsplat_addon.render.frame import frame
        from pointsplat_addon.render.frame.uploads import uploads
        from pointsplat_addon.render.plan import frame_plan

        self.spent: dict[str, float] = {}
        self._within = [0.0]
        self._wrap(final.Synchronizer, "scene", "convert")
        self._wrap(OpenGLDevice, "__init__", "make context")
        self._wrap(frame_plan, "prepare", "sample, cut")
        self._wrap(frame.Frame, "__init__", "allocate")
        self._wrap(uploads.Uploads, "__init__", "upload")
        self._wrap(frame.Frame, "sample", "draw")
        self._wrap(frame.Frame, "pixels", "read back")
        self._wrap(final, "_write", "write")

    def _wrap(self, owner: Any, name: str, stage: str) -> None:
        call = getattr(owner, name)

        @wraps(call)
        def timed(*args, **kwargs):
            start = time.perf_counter()
            self._within.append(0.0)
            try:
                return call(*args, **kwargs)
            finally:
                elapsed = time.perf_counter() - start
                self.spent[stage] = self.spent.get(stage, 0.0) + elapsed - self._within.pop()
                self._within[-1] += elapsed

        setattr(owner, name, timed)

    def take(self, total: float) -> dict[str, float]:
        """Milliseconds by stage since the last call, what is left of `total` seconds as Blender's."""
        found = {name: 1e3 * s for name, s in self.spent.items()}
        found["Blender and waiting"] = 1e3 * total - sum(found.values())
        self.spent.clear()
        return found


def render_twice(engine: str) -> dict[str, Any]:
    """A first frame, and a second one after moving only the camera."""
    stages = Stages() if engine in ("POINTS", "POLYGONS", "AUTO") else None
    choose_engine(engine)
    found: dict[str, Any] = {}
    for name, angle in (("first", 0.0), ("second", TURN)):
        move_camera(angle)
        found[name] = timed_render()
        if stages:
            from pointsplat_addon.host import engine as host

            found[name] |= {"stages": stages.take(found[name]["seconds"]), "report": dict(host.last_report)}
    return found


def register_idle() -> None:
    """An engine that does nothing: what is left is Blender's own work."""
    import bpy

    class IdleEngine(bpy.types.RenderEngine):
        bl_idname = "IDLE"
        bl_label = "Idle"

        def render(self, depsgraph):
            render = depsgraph.scene.render
            self.end_result(self.begin_result(0, 0, render.resolution_x, render.resolution_y))

    bpy.utils.register_class(IdleEngine)


def empty_scene(frames: int) -> dict[str, Any]:
    """Milliseconds of frames of an empty scene, PointSplat and the idle engine taking turns."""
    register_idle()
    choose_engine("AUTO")
    cold = timed_render()["seconds"]
    turns: dict[str, list[float]] = {"POINTSPLAT": [], "IDLE": []}
    for _ in range(frames):
        for engine, times in turns.items():
            choose_engine("AUTO" if engine == "POINTSPLAT" else engine)
            times.append(1e3 * timed_render()["seconds"])
    return {"cold": 1e3 * cold, **turns}


def one_cube() -> dict[str, Any]:
    """Which of the things that hold buffers for points a render makes."""
    from pointsplat_addon.render.passes.image_space.projection import Projection
    from pointsplat_addon.render.passes.image_space.pyramid import Pyramid
    from pointsplat_addon.render.passes.pages.point_page import Page

    made = []
    for kind in (Page, Projection, Pyramid):

        def count(self, *args, make=kind.__init__, **kwargs):
            made.append(type(self).__name__)
            make(self, *args, **kwargs)

        kind.__init__ = count
    choose_engine("AUTO")
    timed_render()
    return {"made": made}


def work(case: str, engine: str, count: int) -> dict[str, Any]:
    import pointsplat_addon

    pointsplat_addon.register()
    build(case, count)
    if case == "empty":
        return empty_scene(count)
    return one_cube() if case == "cube" else render_twice(engine)


def worker(case: str, engine: str, count: int) -> None:
    """Print the answer and leave without the interpreter's shutdown, which hangs in Blender 4.5."""
    status = 1
    try:
        sys.stdout.write(f"\n{MARK}{json.dumps(work(case, engine, count))}\n")
        status = 0
    except Exception as error:
        sys.stderr.write(f"{type(error).__name__}: {error}\n")
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


# ---------------------------------------------------------------------------- rows


def in_fresh_process(case: str, engine: str, count: int) -> dict[str, Any]:
    """The worker's answer; {"failed": why} where there is none."""
    command = [sys.executable, "-m", "scripts.benchmarks.blender", "--worker", case, engine, str(count)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, cwd=ROOT)
    except subprocess.TimeoutExpired:
        return {"failed": f"took longer than {LIMIT} s"}
    lines = [line for line in done.stdout.splitlines() if line.startswith(MARK)]
    if done.returncode or not lines:
        told = [line for line in done.stderr.splitlines() if line.strip()]
        return {"failed": told[-1] if told else f"exit status {done.returncode}"}
    return json.loads(lines[-1].removeprefix(MARK))


def row(name: str, value: float | None, unit: str, target: str = "", note: str = "") -> dict:
    return {"name": name, "value": value, "unit": unit, "target": target, "note": note}


def seconds(results: list[dict[str, Any]], frame: str = "first") -> np.ndarray:
    """Of each run that did not fail."""
    return np.array([r[frame]["seconds"] for r in results if "failed" not in r])


def ratio(name: str, theirs: np.ndarray, ours: np.ndarray, target: str = "", note: str = "") -> dict:
    """Median of theirs over median of ours; the note tells how far single runs lie apart."""
    if len(theirs) == 0 or len(ours) == 0:
        return row(name, None, "x", target, note or "did not run")
    told = f"{np.median(theirs):.2f} s against {np.median(ours):.2f} s"
    if len(ours) > 1:
        told += f"; {theirs.min() / ours.max():.3g} to {theirs.max() / ours.min():.3g} over {len(ours)} runs"
    return row(name, float(np.median(theirs) / np.median(ours)), "x", target, told + (f"; {note}" if note else ""))


def against(
    case: str, what: str, count: int, runs: dict[str, int], targets: dict[str, str]
) -> tuple[list[dict], dict[str, list[list[str]]]]:
    """Rows for one scene: every engine against PointSplat's points, taking turns; `runs` says how often each."""
    found: dict[str, list[dict[str, Any]]] = {engine: [] for engine in runs}
    for turn in range(max(runs.values())):
        for engine, times in runs.items():
            if turn < times:
                found[engine].append(in_fresh_process(case, engine, count))
    failed = {engine: r["failed"] for engine, results in found.items() for r in results if "failed" in r}
    rows = []
    for ours in (engine for engine in runs if engine in ("POINTS", "AUTO")):
        for theirs in (engine for engine in runs if engine not in ("POINTS", "AUTO")):
            target = targets.get(theirs, "") if ours == "POINTS" else ""
            note = failed.get(theirs) or failed.get(ours, "")
            name = f"{what}, cold, {theirs.capitalize() if theirs != 'EEVEE' else theirs} / PointSplat {ours}"
            rows.append(ratio(name, seconds(found[theirs]), seconds(found[ours]), target, note))
        rows.append(
            ratio(
                f"{what}, {ours}, first frame / second after moving the camera",
                seconds(found[ours]),
                seconds(found[ours], "second"),
                targets["second"] if ours == "POINTS" else "",
            )
        )
    return rows, stage_tables(what, found)


def stage_tables(what: str, found: dict[str, list[dict[str, Any]]]) -> dict[str, list[list[str]]]:
    """Where PointSplat's time went, in milliseconds of the median run: stages, and within `draw` the passes."""
    columns: dict[str, dict[str, float]] = {}
    for engine, results in found.items():
        good = sorted((r for r in results if "stages" in r.get("first", {})), key=lambda r: r["first"]["seconds"])
        if not good:
            continue
        for frame in ("first", "second"):
            part = good[len(good) // 2][frame]
            passes = {f"- {p['name']}": p["ms"] for p in part["report"].get("passes", ())}
            columns[f"{engine}, {frame}"] = part["stages"] | passes | {"all": 1e3 * part["seconds"]}
    if not columns:
        return {}
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    names.sort(key=lambda name: (name == "all", name.startswith("- ")))
    table = [["ms", *columns]]
    table += [[name, *(f"{column.get(name, 0.0):.0f}" for column in columns.values())] for name in names]
    return {f"{what}: where the time goes": table}


def empty_rows(frames: int) -> list[dict]:
    found = in_fresh_process("empty", "AUTO", frames)
    name = "empty scene, beyond an idle engine"
    if "failed" in found:
        return [row(name, None, "ms", "< 10", found["failed"])]
    ours, idle = np.array(found["POINTSPLAT"]), np.array(found["IDLE"])
    side = SIZES["empty"]
    note = (f"{np.median(ours):.1f} ms against {np.median(idle):.1f} ms at {side}x{side}; quartiles "
            f"of the difference {np.percentile(ours - idle, 25):.1f} to {np.percentile(ours - idle, 75):.1f}; "
            f"the first frame of a process takes {found['cold']:.0f} ms")  # fmt: skip
    return [row(name, float(np.median(ours - idle)), "ms", "< 10", note)]


def cube_rows() -> list[dict]:
    found = in_fresh_process("cube", "AUTO", 1)
    name = "one cube, buffers for points"
    if "failed" in found:
        return [row(name, None, "", "<= 0", found["failed"])]
    return [row(name, float(len(found["made"])), "", "<= 0", ", ".join(found["made"]) or "none is made")]


def run(quick: bool = False, eevee: bool = True) -> tuple[list[dict], dict[str, list[list[str]]]]:
    """(rows of name, value, unit, target and note; tables of text by title)."""
    if find_spec("bpy") is None:
        return [row("Blender", None, "", "", "the bpy package is not installed")], {}
    count, times = (100_000, 1) if quick else (1_000_000, 3)
    say: Callable[[str], str] = lambda what: f"{count / 1e6:g} M {what}"  # noqa: E731
    once = {"EEVEE": 1} if eevee else {}
    ours = {"POINTS": times, "CYCLES": times}
    rows = [*empty_rows(9 if quick else 31), *cube_rows()]
    mesh, mesh_tables = against(
        "mesh", say("triangles"), count, {**ours, "AUTO": times, "BLENDER_WORKBENCH": times, **once},
        {"CYCLES": "> 1", "EEVEE": ">= 10", "second": ">= 5"},
    )  # fmt: skip
    cloud, cloud_tables = against(
        "pointcloud", say("points as a PointCloud object"), count, ours, {"CYCLES": ">= 3", "second": ">= 5"}
    )
    return [*rows, *mesh, *cloud], {**mesh_tables, **cloud_tables}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the size, once")
    parser.add_argument("--no-eevee", action="store_true", help="leave EEVEE out, which takes minutes")
    parser.add_argument("--worker", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.worker:
        case, engine, count = options.worker
        worker(case, engine, int(count))
    rows, tables = run(options.quick, not options.no_eevee)
    for r in rows:
        value = "-" if r["value"] is None else f"{r['value']:.2f}"
        sys.stdout.write(f"{r['name']:70} {value:>8} {r['unit']:4} {r['target']:8} {r['note']}\n")
    for title, table in tables.items():
        sys.stdout.write(f"\n{title}\n")
        for line in table:
            sys.stdout.write(f"{line[0]:24}" + "".join(f"{cell:>18}" for cell in line[1:]) + "\n")


if __name__ == "__main__":
    main()
