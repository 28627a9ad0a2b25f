"""Where the time of a process's first picture goes: each phase from the start of the interpreter to the written file.

    python -m scripts.benchmarks.first_picture FILE.blend ... [--set NAME=VALUE ...] [--size WxH] [--times N] [--second]
        [--engine POINTSPLAT|CYCLES|BLENDER_WORKBENCH ...] [--processor] [--no-shader-cache] [--keep DIR]
    python -m scripts.benchmarks.first_picture --make DIR [--data DIR]

Each picture is drawn by a fresh process; with several, the tables hold the medians. Functions of the add-on are wrapped
while they are imported, so that nothing of this is in the add-on; a phase's time is without that of the phases within
it. What runs on the drawing thread while Blender's waits is counted where it runs. --second: also the same picture with
the camera moved, in the same process. --processor: processor time of the whole process, which depends less on what else
the machine does, instead of time by the clock. --no-shader-cache: without what Mesa's driver kept on disk of shaders
that it has compiled before. --keep: the folder that gets the pictures as OpenEXR. A picture that is not counted comes
first, so that modules are compiled as those of an installed extension are.
--make writes the scenes that are measured: the default cube, points, and what there is in the folder --data: the
dragon (dragon_vrip_res2.ply.gz), once as it is and once subdivided, and the truck (peterbilt/*.obj or the like).
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from functools import wraps
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from scripts.common.process import environment

ROOT = Path(__file__).resolve().parents[2]
MARK = "RESULT "  # begins the line of the worker's answer, among Blender's own lines
LIMIT = 3600  # seconds for one process
PACKAGE = "pointsplat_addon"
ELSEWHERE = "(waits for the drawing thread)"

# Functions by module: name to phase, in the order of the table.
PROBES: dict[str, dict[str, str]] = {
    "host.registration": {"register": "register classes"},
    "host.sync": {"Synchronizer.scene": "convert: the rest"},
    "host.convert.objects": {"collect": "convert: dependency graph"},
    "host.convert.material.materials": {"convert_materials": "convert: materials"},
    "host.convert.mesh": {"read_mesh": "convert: mesh"},
    "host.convert.pointcloud": {"read_pointcloud": "convert: points", "_make_cloud": "convert: cloud"},
    "host.convert.arrays": {"read": "read arrays", "digest": "hash content"},
    "host.device.gl_thread": {"_make_device": "OpenGL context"},
    "host.final": {"FinalRender.render": "render: the rest", "Job.wait": ELSEWHERE, "_write": "write result"},
    "devices.probe": {"capabilities": "probe of the device"},
    "core.scene.validation": {"validate": "validate"},
    "core.scene.cloud": {"coherent": "coherent order"},
    "core.lod.foliage": {"is_foliage": "prepare: foliage", "disconnected_splats": "prepare: foliage"},
    "core.surface.density": {"make_parts": "measure: parts"},
    "core.surface.triangles": {"measure_triangles": "measure: triangles"},
    "core.scene.bounds": {"cloud_ball": "measure: balls", "triangles_ball": "measure: balls"},
    "render.prepare.separation": {"separate_translucent": "prepare: the rest"},
    "render.prepare.prepare": {"prepare": "prepare: the rest"},
    "render.plan.frame_plan": {"make_frame_plan": "plan"},
    "render.shadow.shadows": {"make_shadows": "shadow tables"},
    "render.frame.uploads.uploads": {"Uploads.__init__": "uploads: the rest"},
    "render.frame.uploads.lighting": {"LightingUploads.__init__": "uploads: lights"},
    "render.passes.visibility.polygon_mesh": {"PolygonMesh.__init__": "pack: meshes"},
    "render.passes.pages.point_page": {"Page.__init__": "pack: points"},
    "devices.opengl": {
        "OpenGLDevice.texture": "texture to the device",
        "OpenGLDevice._compile": "compile",
        "OpenGLDevice.draw": "draw",
        "OpenGLDevice.dispatch": "draw",
        "OpenGLDevice.clear": "draw",
        "OpenGLDevice.fill": "draw",
        "OpenGLDevice.read": "read back",
    },
    "render.frame.frame": {"Frame.__init__": "frame: the rest", "Frame.sample": "frame: the rest",
                           "Frame.pixels": "frame: the rest"},
}  # fmt: skip
WHOLE = ("probe of the device",)  # phases that hold all within them
IMPORTS = ("import: add-on", "import: numpy", "import: moderngl", "import: others")
BEFORE = ("interpreter", "import: bpy", "open file")


# ---------------------------------------------------------------------------- the worker


class Phases:
    """Seconds of each phase, by the name of the thread, each without the phases within it."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self.seconds: dict[str, float] = defaultdict(float)
        self.calls: dict[str, int] = defaultdict(int)
        self._stack = threading.local()

    def within(self, phase: str, work: Callable, *arguments, **named) -> Any:
        """Call `work` as a part of a phase."""
        stack = self._stack.__dict__.setdefault("items", [])
        if getattr(self._stack, "whole", False):
            return work(*arguments, **named)
        self._stack.whole = phase in WHOLE
        stack.append(0.0)
        start = self._clock()
        try:
            return work(*arguments, **named)
        finally:
            self._stack.whole = False
            taken = self._clock() - start
            self.seconds[phase] += taken - stack.pop()
            self.calls[phase] += 1
            if stack:
                stack[-1] += taken

    def wrapped(self, phase: str, function: Callable) -> Callable:
        @wraps(function)
        def call(*arguments, **named):
            return self.within(phase, function, *arguments, **named)

        return call

    def take(self) -> dict[str, float]:
        """Milliseconds of the phases so far, which start anew."""
        found = {phase: 1e3 * seconds for phase, seconds in self.seconds.items()}
        self.seconds.clear()
        return found


class Watcher(PathFinder):
    """Times the imports of modules, and wraps the functions of PROBES in modules as soon as they are loaded, before
    others import the functions by name."""

    phases: Phases

    @classmethod
    def find_spec(cls, fullname: str, path=None, target=None):
        spec = super().find_spec(fullname, path, target)
        loader = getattr(spec, "loader", None)
        if loader is None or not hasattr(loader, "exec_module"):
            return spec
        phase = "import: others"
        for name, row in ((PACKAGE, 0), ("numpy", 1), ("moderngl", 2), ("glcontext", 2)):
            if fullname.partition(".")[0] == name:
                phase = IMPORTS[row]
        run = loader.exec_module

        def exec_module(module):
            cls.phases.within(phase, run, module)
            for name, label in PROBES.get(fullname.removeprefix(f"{PACKAGE}."), {}).items():
                owner, _, attribute = name.rpartition(".")
                holder = getattr(module, owner) if owner else module
                setattr(holder, attribute, cls.phases.wrapped(label, getattr(holder, attribute)))

        loader.exec_module = exec_module
        return spec


def resident() -> tuple[int, int]:
    """Bytes of memory of this process, and the most since the last call."""
    try:
        lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
        found = tuple(1024 * int(lines[key].split()[0]) for key in ("VmRSS", "VmHWM"))
        Path("/proc/self/clear_refs").write_text("5")
        return found[0], found[1]
    except OSError:
        return 0, 0


def worker(task: dict[str, Any]) -> None:
    """Draw the picture of a task, and print what its phases took."""
    clock = time.process_time if task["processor"] else time.monotonic
    begin = 0.0 if task["processor"] else task["started"]
    found: dict[str, float] = {"interpreter": 1e3 * (clock() - begin)}
    phases = Watcher.phases = Phases(clock)
    start = clock()
    import bpy

    found["import: bpy"] = 1e3 * (clock() - start)
    if task["engine"] == "POINTSPLAT":
        sys.meta_path.insert(0, Watcher)
        import pointsplat_addon

        pointsplat_addon.register()
    start = clock()
    bpy.ops.wm.open_mainfile(filepath=task["file"], load_ui=False)
    found["open file"] = 1e3 * (clock() - start)
    scene = bpy.context.scene
    scene.render.engine = task["engine"]
    choose(scene, task)
    with tempfile.TemporaryDirectory() as folder:
        pictures = []
        for number in range(2 if task["second"] else 1):
            if number:
                scene.camera.matrix_world.translation.x += 1e-3 * scene.camera.matrix_world.translation.length
                scene.camera.location.x += 1e-3 * scene.camera.location.length
            before, _ = resident()
            begun = clock()
            scene.render.filepath = str(Path(folder) / "picture.exr")
            bpy.ops.render.render(write_still=True)
            taken = 1e3 * (clock() - begun)
            found |= phases.take()
            inside = sum(found.get(phase, 0.0) for phase in {p for some in PROBES.values() for p in some.values()})
            found["picture"], found["memory"] = taken, resident()[1] - before
            found["Blender and the rest"] = taken - (inside - found.get(ELSEWHERE, 0.0))
            pictures.append(found)
            found = {}
            if task["keep"]:
                kept = Path(task["keep"]) / f"{Path(task['file']).stem}_{task['engine'].lower()}_{number}.exr"
                kept.write_bytes(Path(scene.render.filepath).read_bytes())
    pictures[0]["whole process"] = 1e3 * (clock() - begin)
    sys.stdout.write("\n" + MARK + json.dumps(pictures) + "\n")
    sys.stdout.flush()
    os._exit(0)  # Blender 4.5 may not come back from the interpreter's own shutdown


def choose(scene: Any, task: dict[str, Any]) -> None:
    """Put what a task asks for into the scene."""
    if task["size"]:
        scene.render.resolution_x, scene.render.resolution_y = task["size"]
        scene.render.resolution_percentage = 100
    image = scene.render.image_settings
    if hasattr(image, "media_type"):  # since Blender 5.0 the format's kind comes first
        image.media_type = "IMAGE"
    image.file_format, image.color_depth = "OPEN_EXR", "32"
    scene.render.use_file_extension = False
    if task["engine"] == "CYCLES":
        scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 1, False
        scene.cycles.use_adaptive_sampling = False
    elif task["engine"] == "POINTSPLAT":
        for name, text in task["set"]:
            value = getattr(scene.pointsplat, name)
            setattr(scene.pointsplat, name, text if isinstance(value, str) else type(value)(json.loads(text.lower())))


# ---------------------------------------------------------------------------- measuring


def measure(task: dict[str, Any]) -> list[dict[str, float]] | str:
    """Phases of the pictures of one process in milliseconds, or why there are none."""
    code = "import sys, json; from scripts.benchmarks.first_picture import worker; worker(json.loads(sys.argv[1]))"
    task = {**task, "started": time.monotonic()}
    done = subprocess.run(
        [sys.executable, "-c", code, json.dumps(task)],
        cwd=ROOT, env=environment(Path(task["bytecode"]), task["shader_cache"]), capture_output=True, text=True,
        timeout=LIMIT,
    )  # fmt: skip
    for line in done.stdout.splitlines():
        if line.startswith(MARK):
            return json.loads(line.removeprefix(MARK))
    return "\n".join((done.stdout + done.stderr).splitlines()[-12:])


def median(runs: list[dict[str, float]]) -> dict[str, float]:
    """The median of each phase over several processes."""
    names = dict.fromkeys(name for run in runs for name in run)
    return {name: statistics.median(run.get(name, 0.0) for run in runs) for name in names}


def phase_order() -> list[str]:
    named = dict.fromkeys(phase for some in PROBES.values() for phase in some.values() if phase != ELSEWHERE)
    return [*BEFORE, *IMPORTS, *named, "Blender and the rest", "picture", "whole process"]


def show(columns: dict[str, dict[str, float]]) -> None:
    """Print one column for each picture, in milliseconds; memory in megabytes."""
    names = [name for name in phase_order() if any(column.get(name, 0.0) >= 0.5 for column in columns.values())]
    width = max(12, *(len(title) + 2 for title in columns))
    sys.stdout.write(f"{'ms':28}" + "".join(f"{title:>{width}}" for title in columns) + "\n")
    for name in names:
        cells = "".join(f"{column.get(name, 0.0):{width}.0f}" for column in columns.values())
        sys.stdout.write(f"{name:28}{cells}\n")
    cells = "".join(f"{column.get('memory', 0.0) / 1e6:{width}.0f}" for column in columns.values())
    sys.stdout.write(f"{'memory of the picture, MB':28}{cells}\n")
    sys.stdout.flush()


# ---------------------------------------------------------------------------- scenes


def make_scenes(folder: Path, data: Path | None) -> None:
    """Write the scenes that are measured into a folder."""
    import bpy

    from scripts.benchmarks import first_picture_scenes as scenes

    folder.mkdir(parents=True, exist_ok=True)
    for name, build in scenes.SCENES.items():
        try:
            build(data)
        except FileNotFoundError as error:
            sys.stdout.write(f"{name}: {error}\n")
            continue
        bpy.ops.wm.save_as_mainfile(filepath=str((folder / f"{name}.blend").resolve()), compress=False)
    sys.stdout.flush()
    os._exit(0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*", type=Path, metavar="FILE.blend")
    parser.add_argument("--engine", action="append", choices=("POINTSPLAT", "CYCLES", "BLENDER_WORKBENCH"))
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="of scene.pointsplat")
    parser.add_argument("--size", metavar="WxH", help="default: the file's")
    parser.add_argument("--times", type=int, default=1, help="processes for each picture")
    parser.add_argument("--second", action="store_true", help="a second picture in the same process")
    parser.add_argument("--processor", action="store_true", help="processor time instead of time by the clock")
    parser.add_argument("--no-shader-cache", action="store_true")
    parser.add_argument("--keep", type=Path, metavar="DIR")
    parser.add_argument("--make", type=Path, metavar="DIR")
    parser.add_argument("--data", type=Path, metavar="DIR", help="a folder with scanned meshes")
    options = parser.parse_args()
    if options.make:
        make_scenes(options.make, options.data)
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    tasks = {
        f"{file.stem} {engine[:8]}".removesuffix(" POINTSPL"): {
            "file": str(file.resolve()),
            "engine": engine,
            "set": [text.split("=", 1) for text in options.set],
            "size": [int(side) for side in options.size.split("x")] if options.size else None,
            "second": options.second,
            "processor": options.processor,
            "shader_cache": not options.no_shader_cache,
            "keep": str(options.keep.resolve()) if options.keep else "",
        }
        for file in options.files
        for engine in options.engine or ["POINTSPLAT"]
    }
    runs: dict[str, list[list[dict[str, float]]]] = defaultdict(list)
    with tempfile.TemporaryDirectory() as bytecode:
        measure({**next(iter(tasks.values())), "bytecode": bytecode})  # compiles the add-on's modules
        for _ in range(options.times):  # in turns, so that all see the same load
            for title, task in tasks.items():
                found = measure({**task, "bytecode": bytecode})
                if isinstance(found, str):
                    sys.stdout.write(f"{title} failed:\n{found}\n")
                else:
                    runs[title].append(found)
    columns = {}
    for title, found in runs.items():
        for number in range(len(found[0])):
            columns[title if number == 0 else f"{title} 2nd"] = median([run[number] for run in found])
    if columns:
        show(columns)


if __name__ == "__main__":
    main()
