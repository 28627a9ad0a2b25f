"""Grids of one tower of 350,000 triangles, 10x10 to 200x200 instances (Coconu and Hege 2002, table 4), at 500x400.

python -m scripts.benchmarks.instances [--quick] [--alone] [--pictures FOLDER]

The whole grid fills the picture (`above`), or the camera stands at its edge (`edge`). The camera turns about the grid
from frame to frame.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.render.frame.report import report
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.prepare.prepare import prepare
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.frame import MeteredDevice, row
from scripts.common import tower

SIZE = (500, 400)  # pixels
TURN = np.radians(1.0)  # of the camera from frame to frame
SETTINGS = Settings(use_shadows=False)
FOCAL = 2.0  # distance of the picture over half its height


def mesh() -> Mesh:
    """The tower with flat normals."""
    position, triangles, material = tower.tower()
    a, b, c = position[triangles].transpose(1, 0, 2).astype(np.float64)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    corner = np.repeat(normal[:, None].astype(np.float32), 3, axis=1)
    return Mesh(
        "tower", "Tower", position, triangles, corner_normal=corner, material=material, materials=(0, 1, 2, 3),
        topology="tower",
    )  # fmt: skip


def scene(side: int, of: Mesh) -> Scene:
    """A grid of towers under a sun and a sky of one colour."""
    table = default_materials()
    rows = np.zeros(len(tower.COLORS), int)
    table = replace(
        table,
        **{name: getattr(table, name)[rows] for name in ("roughness", "metallic", "ior", "specular", "emission")},
        **{name: getattr(table, name)[rows] for name in ("alpha", "cull", "pass_index", "hash")},
        base_color=np.array(tower.COLORS, np.float32), names=("Wall", "Glass", "Lit", "Roof"), graphs=(None,) * 4,
    )  # fmt: skip
    sun = Light("SUN", np.full(3, 3.0), np.zeros(3), np.array([-0.48, -0.6, -0.64]))
    matrices = tower.grid(side)
    instances = Instances(np.zeros(len(matrices), np.int32), matrices)
    geometry = Geometry("tower", "Tower", mesh=of)
    return Scene((geometry,), instances, table, (sun,), World(np.array([0.25, 0.3, 0.4])))


def look_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """view_from_world (4, 4), Z up."""
    back = (eye - target) / np.linalg.norm(eye - target)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = right, np.cross(back, right), back
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return matrix


def camera(side: int, view: str, angle: float, size: tuple[int, int] = SIZE) -> Camera:
    """`above`: all of a grid of `side` towers fills the picture. `edge`: from the height of three towers at its edge.
    `angle`: turned about the grid's middle."""
    extent = side * tower.SPACING
    turn = np.array([np.sin(angle + 0.5), -np.cos(angle + 0.5), 0.0])
    if view == "above":
        eye, target = turn * extent * 0.9 + [0, 0, extent * 0.6], np.array([0, 0, -0.05 * extent])
    else:
        eye, target = turn * extent * 0.75 + [0, 0, 2.0], np.array([0, 0, -0.1 * extent])
    near, far = 0.05, 10 * extent
    depth = -(far + near) / (far - near), -2 * far * near / (far - near)
    clip = np.array([[FOCAL * size[1] / size[0], 0, 0, 0], [0, FOCAL, 0, 0], [0, 0, *depth], [0, 0, -1.0, 0]])
    return Camera(look_at(eye, target), clip, size, near=near, far=far)


class Ours:
    """Draws frames of grids."""

    def __init__(self) -> None:
        self.device = MeteredDevice()
        self.renderer, self.mesh = Renderer(self.device), mesh()
        self._scenes: dict[int, Scene] = {}

    def frame(self, side: int, view: str, angle: float, samples: int = 1, pixels: bool = False) -> dict[str, Any]:
        """One frame until the device has finished it: seconds of all and of preparing, splats, bytes uploaded."""
        of = self._scenes.setdefault(side, scene(side, self.mesh))
        request = Request(camera(side, view, angle), SETTINGS, frozenset({"combined"}), samples)
        uploaded, start = self.device.uploaded, time.perf_counter()
        prepare(of, request.camera, SETTINGS, samples, self.renderer.store)
        prepared = time.perf_counter()
        picture = self.renderer.start(of, request)
        while picture.done < samples:
            picture.sample()
        self.device.finish()
        end = time.perf_counter()
        told, image = report(picture, end - prepared), picture.pixels()["combined"] if pixels else None
        picture.release()
        return {
            "seconds": end - prepared, "prepare": prepared - start, "cut": told["points"]["cut"],
            "bytes": told["bytes"], "uploaded": self.device.uploaded - uploaded, "image": image,
        }  # fmt: skip


def vtk_seconds(side: int, frames: int) -> list[float]:
    """Frames of VTK's glyph mapper, which instances the tower on the device."""
    import vtk
    from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

    position, triangles, _ = tower.tower()
    data, points, cells = vtk.vtkPolyData(), vtk.vtkPoints(), vtk.vtkCellArray()
    points.SetData(numpy_to_vtk(position, deep=1))
    rows = np.concatenate([np.full((len(triangles), 1), 3), triangles], axis=1).astype(np.int64)
    cells.SetCells(len(triangles), numpy_to_vtkIdTypeArray(rows.ravel(), deep=1))
    data.SetPoints(points)
    data.SetPolys(cells)
    places, at = vtk.vtkPolyData(), vtk.vtkPoints()
    at.SetData(numpy_to_vtk(np.ascontiguousarray(tower.grid(side)[:, :3, 3]), deep=1))
    places.SetPoints(at)
    mapper = vtk.vtkGlyph3DMapper()
    mapper.SetInputData(places)
    mapper.SetSourceData(data)
    mapper.ScalingOff()
    actor, renderer = vtk.vtkActor(), vtk.vtkRenderer()
    actor.SetMapper(mapper)
    renderer.AddActor(actor)
    window = getattr(vtk, "vtkEGLRenderWindow", vtk.vtkRenderWindow)()
    window.SetOffScreenRendering(1)
    window.SetMultiSamples(0)
    window.SetSize(*SIZE)
    window.AddRenderer(renderer)
    seconds = []
    for i in range(frames + 1):
        eye = np.linalg.inv(camera(side, "above", i * TURN).view_from_world)
        view = renderer.GetActiveCamera()
        view.SetPosition(*eye[:3, 3])
        view.SetFocalPoint(*(eye[:3, 3] - eye[:3, 2]))
        view.SetViewUp(0, 0, 1)
        view.SetViewAngle(2 * np.degrees(np.arctan(1 / FOCAL)))
        renderer.ResetCameraClippingRange()
        start = time.perf_counter()
        window.Render()
        window.WaitForCompletion()
        seconds.append(time.perf_counter() - start)
    window.Finalize()
    return seconds[1:]  # the first frame compiles and uploads


def eevee_seconds(side: int, frames: int) -> list[float]:
    """Frames of one sample of Blender's EEVEE, of objects that share a mesh."""
    import bpy

    from scripts.demos import towers as demo_towers

    demo_towers.build(side)
    of = bpy.context.scene
    of.render.engine = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0, 0) else "BLENDER_EEVEE"
    of.eevee.taa_render_samples = 1
    of.eevee.use_shadows = False
    of.render.use_persistent_data = True
    seconds = []
    for _ in range(frames + 1):
        start = time.perf_counter()
        bpy.ops.render.render()
        seconds.append(time.perf_counter() - start)
    return seconds[1:]  # the first frame compiles


def worker(pipe: Connection, measure: Callable[[int, int], list[float]], side: int, frames: int) -> None:
    pipe.send(measure(side, frames))
    os._exit(0)  # Blender as a module may hang on the way out


def theirs(measure: Callable[[int, int], list[float]], side: int, frames: int) -> list[float]:
    """Another renderer's frames, in a process of its own; empty where it cannot draw."""
    context = multiprocessing.get_context("spawn")
    mine, other = context.Pipe()
    process = context.Process(target=worker, args=(other, measure, side, frames), daemon=True)
    process.start()
    other.close()
    try:
        return mine.recv()
    except EOFError:
        return []
    finally:
        process.join()


def save(path: Path, image: np.ndarray) -> None:
    """A picture as PNG, in sRGB's gamma."""
    from PIL import Image

    levels = np.clip(image[::-1, :, :3], 0, 1) ** (1 / 2.2)
    Image.fromarray((255 * levels + 0.5).astype(np.uint8)).save(path)


def run(quick: bool = False, others: bool = True, pictures: Path | None = None) -> tuple[list[dict], dict]:
    """(rows of name, value, unit, target and note; tables of text by title)."""
    sides, frames = ((10, 20, 40) if quick else (10, 50, 100, 200)), 3
    ours, rows, seconds = Ours(), [], {}
    table = [
        ["grid", "view", "triangles", "splats drawn", "first frame, ms", "frame, ms", "prepare, ms", "uploaded, MB"]
    ]
    try:
        for view in ("above", "edge"):
            for side in sides:
                ours.renderer.store.clear()
                cold = ours.frame(side, view, 0.0)
                turns = [ours.frame(side, view, (i + 1) * TURN) for i in range(frames)]
                seconds[view, side] = float(np.median([t["seconds"] for t in turns]))
                prepared = float(np.median([t["prepare"] for t in turns]))
                table.append([
                    f"{side}x{side}", view, f"{side**2 * tower.TRIANGLES:.2g}", f"{turns[-1]['cut']:,}",
                    f"{1e3 * (cold['seconds'] + cold['prepare']):.0f}", f"{1e3 * seconds[view, side]:.0f}",
                    f"{1e3 * prepared:.0f}", f"{turns[-1]['uploaded'] / 1e6:.1f}",
                ])  # fmt: skip
                if pictures is not None:
                    image = ours.frame(side, view, 0.0, 16, pixels=True)["image"]
                    save(pictures / f"towers_{view}_{side}.png", image)
                if side == sides[-1]:
                    share = prepared / (seconds[view, side] - prepared)
                    rows.append(row(f"towers, {view}, prepare / draw, {side}x{side}", share, "x", "1", ""))
                    held = ", ".join(f"{name} {n / 1e6:.0f} MB" for name, n in turns[-1]["bytes"].items())
                    rows.append(row(f"towers, {view}, memory", sum(turns[-1]["bytes"].values()) / 1e6, "MB", "", held))
            growth = seconds[view, sides[-1]] / seconds[view, sides[1]]
            rows.append(row(f"towers, {view}, {sides[-1]}x{sides[-1]} / {sides[1]}x{sides[1]}", growth, "x", "4",
                            f"{(sides[-1] / sides[1]) ** 2:.0f} times the triangles"))  # fmt: skip
        for who, module, measure in (("VTK's glyphs", "vtk", vtk_seconds), ("Blender's EEVEE", "bpy", eevee_seconds)):
            there = others and find_spec(module) is not None
            against = theirs(measure, sides[0], 1 if module == "bpy" else frames) if there else []
            ratio = seconds["above", sides[-1]] / np.median(against) if against else None
            missing = "could not draw here" if there else "was left out" if not others else f"{module} is missing"
            note = f"{1e3 * np.median(against):.0f} ms" if against else f"{who} {missing}"
            rows.append(row(f"towers, {sides[-1]}x{sides[-1]} / {who}, {sides[0]}x{sides[0]}", ratio, "x", "1", note))
        return rows, {"Grids of a tower of 350,000 triangles (500x400)": table}
    finally:
        ours.renderer.release()
        ours.device.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="smaller grids")
    parser.add_argument("--alone", action="store_true", help="neither VTK nor EEVEE")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="save one of each grid, of 16 samples")
    options = parser.parse_args()
    rows, tables = run(options.quick, not options.alone, options.pictures)
    for r in rows:
        value = "-" if r["value"] is None else f"{r['value']:.2f}"
        sys.stdout.write(f"{r['name']:60} {value:>8} {r['unit']:4} {r['target']:8} {r['note']}\n")
    for title, lines in tables.items():
        sys.stdout.write(f"\n{title}\n")
        for line in lines:
            sys.stdout.write("  ".join(f"{cell:>15}" for cell in line) + "\n")


if __name__ == "__main__":
    main()
