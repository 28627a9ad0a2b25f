"""A process that renders a .blend file, moves the camera, and renders it again: what a user's process would do.

python -m scripts.benchmarks.beside_cycles.worker JSON, by scripts/benchmarks/beside_cycles.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

MARK = "RESULT "  # begins the line of the answer, among Blender's own lines
TURN = 0.05  # radians that the camera moves about what it looks at


def state() -> dict[str, float]:
    """Seconds of a clock that all processes share; of the processor since this one began; and the most bytes of memory
    that it has had."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    peak = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM"))
    return {"clock": time.monotonic(), "processor": time.process_time(), "peak": 1024 * peak}


def work(
    file: str, program: str, samples: int, seed: int, settings: dict, outputs: list[str], size: list[int] | None
) -> dict[str, Any]:
    """Render the file to each of `outputs`, EXR files, the camera a step further before each but the first.

    program: CYCLES, BLENDER_WORKBENCH, or a technique of PointSplat's. settings: of scene.pointsplat or scene.cycles.
    size: in pixels; None: the file's.
    """
    import bpy

    states = {"import": state()}
    report: dict[str, Any] = {}
    native = program in ("CYCLES", "BLENDER_WORKBENCH")
    if not native:
        from scripts.render import engine_class

        report = sys.modules[engine_class().__module__].last_report
        states["register"] = state()
    bpy.ops.wm.open_mainfile(filepath=file, load_ui=False)
    states["open"] = state()
    scene = bpy.context.scene
    scene.render.engine = program if native else "POINTSPLAT"
    scene.render.use_persistent_data = len(outputs) > 1
    written = scene.render.image_settings
    written.file_format, written.color_mode, written.color_depth = "OPEN_EXR", "RGBA", "32"
    if size:
        scene.render.resolution_x, scene.render.resolution_y = size
        scene.render.resolution_percentage = 100
    own = scene.cycles if native else scene.pointsplat
    own.samples = samples
    if native:
        own.seed = seed
    else:
        own.technique, own.use_indirect = program, False  # unless settings have it: Cycles' scenes are without bounces
    for name, value in settings.items():
        setattr(own, name, value)
    reports = []
    for i, output in enumerate(outputs):
        if i:
            orbit(scene)
        scene.render.filepath = output
        bpy.ops.render.render(write_still=True)
        states[f"picture {i + 1}"] = state()
        if not native and "technique" not in report:
            raise RuntimeError("the picture was not rendered")
        reports.append(json.loads(json.dumps(report, default=str)))
    return {"states": states, "reports": reports}


def orbit(scene: Any) -> None:
    """Turn the camera about a vertical axis through the cursor."""
    from mathutils import Matrix

    to = Matrix.Translation(scene.cursor.location)
    scene.camera.matrix_world = to @ Matrix.Rotation(TURN, 4, "Z") @ to.inverted() @ scene.camera.matrix_world


def main() -> None:
    sys.stdout.write(f"\n{MARK}{json.dumps(work(**json.loads(sys.argv[1])))}\n")


if __name__ == "__main__":
    from scripts.common.process import run

    run(main)
