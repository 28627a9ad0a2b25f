"""The gallery's scene with everything in it, by AUTO and by Cycles: their pictures, and errors part by part.

    python -m scripts.studies.everything --data DIR --output docs/notes/images/everything.jpg --folder WORK
        [--size 480x270] [--samples 16] [--cycles-samples 256] [--splats FILE]

DIR holds real meshes (scripts/benchmarks/beside_cycles/everything.py names them), WORK keeps what was drawn: pictures
that are there are not drawn again. Cycles draws two pictures of half the samples each, so that errors do not count its
noise (scripts/benchmarks/beside_cycles/figures.py). A pixel's part is what a picture of flat colours shows at its
centre; smoke and panes, which others are seen through, have the pixels of which they cover a twentieth. Captured splats
of a FILE are in AUTO's picture alone, for Cycles draws none: they cast no shadows, and their pixels are left out of the
table. From the left: AUTO, Cycles, and eight times their difference about grey. The table goes to stdout.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from PIL import Image

import pointsplat_addon
from scripts.benchmarks.beside_cycles import figures, pictures
from scripts.benchmarks.beside_cycles.processes import Program, rendered, scene_file
from scripts.common.images import displayed
from scripts.common.process import run
from scripts.render import size

SEEDS = 101, 202
# Of parts whose objects have names of their files.
NAMES = {"tree_CUtree": "maple", "Ground_Untitled": "plant", "1": "bonsai", "dragon_vrip_res2": "dragon",
         "spot_triangulated": "Spot", "Plane": "floor"}  # fmt: skip
VEILS = "smoke", "panes"  # which others are seen through
LEAST = 0.05  # of a pixel that a veil covers, or that captured splats hide
CAPTURE, PLACE, WIDTH = "Capture", (0.95, -1.35), 0.6  # name, place on the floor and metres of captured splats


def part_of(item: Any) -> str:
    if item.active_material is not None and item.active_material.name.startswith("Pane"):
        return "panes"
    if item.type == "CURVES":
        return "fur"
    return NAMES.get(str(item.name).split(".")[0], str(item.name).lower())


def flat(scene: Any, path: Path) -> np.ndarray:
    """(H, W, 4) one sample at each pixel's centre, by Cycles."""
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.filter_width, scene.render.filepath = 1, 0.01, str(path)
    bpy.ops.render.render(write_still=True)
    return pictures.read(path)


def glow(item: Any, strength: float) -> None:
    """Let an object's surfaces shine evenly, where they are not cut out."""
    for slot in item.material_slots:
        slot.material = slot.material.copy()
        tree = slot.material.node_tree
        for node in [n for n in tree.nodes if n.type == "BSDF_DIFFUSE"]:
            shine = tree.nodes.new("ShaderNodeEmission")
            shine.inputs["Color"].default_value = (strength, strength, strength, 1.0)
            for link in list(node.outputs[0].links):
                tree.links.new(shine.outputs[0], link.to_socket)


def masks(file: Path, folder: Path) -> dict[str, np.ndarray]:
    """(H, W) bool by part."""
    bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False)
    scene = bpy.context.scene
    items = [item for item in scene.objects if item.type not in ("LIGHT", "CAMERA", "EMPTY")]
    parts = sorted({part_of(item) for item in items})
    for item in items:
        glow(item, 1.0 + parts.index(part_of(item)))
        item.hide_render = part_of(item) in VEILS
    shown = flat(scene, folder / "parts.exr")
    number = np.round(shown[..., 0] / np.maximum(shown[..., 3], 1e-6)).astype(int) * (shown[..., 3] > 0.5)
    found = {part: number == 1 + i for i, part in enumerate(parts) if part not in VEILS}
    for veil in VEILS:
        for item in items:
            item.hide_render = part_of(item) != veil
        found[veil] = flat(scene, folder / f"{veil}.exr")[..., 3] > LEAST
    return {part: mask for part, mask in found.items() if mask.any()}


def with_splats(file: Path, splats: Path) -> Path:
    """Adds captured splats, which lie on the floor, to a copy of a file."""
    path = file.with_name(f"{file.stem}-splats.blend")
    if not path.exists():
        bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False)
        bpy.ops.pointsplat.import_splats(filepath=str(splats.resolve()))
        item = bpy.context.object
        item.name, item.visible_shadow = CAPTURE, False
        position = np.empty(3 * len(item.data.points), np.float32)
        item.data.attributes["position"].data.foreach_get("vector", position)
        bpy.context.view_layer.update()
        turn = np.array(item.matrix_world)[:3, :3]
        low, middle, high = np.quantile(position.reshape(-1, 3) @ turn.T, (0.01, 0.5, 0.99), axis=0)
        scale = WIDTH / float((high - low)[:2].max())
        to = Matrix.Translation((*PLACE, 0.0)) @ Matrix.Scale(scale, 4) @ Matrix.Translation((*-middle[:2], -low[2]))
        item.matrix_world = to @ item.matrix_world
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
    return path


def hidden_by_splats(file: Path, path: Path) -> np.ndarray:
    """(H, W) bool: pixels that the captured splats of a file hide in part."""
    bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False)
    scene = bpy.context.scene
    for item in scene.objects:
        item.hide_render = item.name != CAPTURE
    scene.world, scene.render.film_transparent = None, True
    scene.render.engine, scene.render.filepath = "POINTSPLAT", str(path)
    bpy.ops.render.render(write_still=True)
    return pictures.read(path)[..., 3] > LEAST


def drawn(file: Path, program: Program, seed: int, folder: Path) -> np.ndarray:
    """(H, W, 4), drawn in a process of its own if it is not there. RuntimeError: it could not be."""
    path = folder / f"{file.stem}-{program.name}-{program.samples}-{seed}.exr"
    if not path.exists():
        found = rendered(file, program, [path], seed, bytecode=folder / "bytecode")
        if "failed" in found:
            raise RuntimeError(found["failed"])
    return pictures.read(path)


def table(
    found: dict[str, np.ndarray], counted: np.ndarray, own: np.ndarray, few: np.ndarray, truth: list[np.ndarray]
) -> str:
    """counted: (H, W) bool: pixels that parts have."""
    lines = ["| part | of the picture | RMSE | Cycles, 16 | brightness |", "|---|---|---|---|---|"]
    mean = (truth[0].astype(float) + truth[1]) / 2
    for part, of_part in {"all": counted, **found}.items():
        mask = of_part & counted
        errors = [figures.rmse(x[mask][:, :3], *(t[mask][:, :3] for t in truth)) for x in (own, few)]
        brightness = own[mask][:, :3].mean(dtype=float) / max(mean[mask][:, :3].mean(), 1e-9)
        lines.append(f"| {part} | {100 * mask.mean():.1f} % | {errors[0]:.4f} | {errors[1]:.4f} | {brightness:.3f} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--size", type=size, default=(480, 270), metavar="WxH")
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--cycles-samples", type=int, default=256)
    parser.add_argument("--splats", type=Path)
    options = parser.parse_args()
    pointsplat_addon.register()
    folder, (wide, high) = options.folder.resolve(), options.size
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"everything-{wide}x{high}.blend"
    if not file.exists():
        scene_file(
            file, ["everything", str(file), "--data", str(options.data.resolve()), "--size", str(wide), str(high)]
        )
    mixed = file if options.splats is None else with_splats(file, options.splats)
    own = drawn(mixed, Program("AUTO", options.samples), 0, folder)
    few = drawn(file, Program("CYCLES", 16), 303, folder)
    truth = [drawn(file, Program("CYCLES", options.cycles_samples // 2), seed, folder) for seed in SEEDS]
    counted = np.ones(own.shape[:2], bool)
    if options.splats is not None:
        counted &= ~hidden_by_splats(mixed, folder / "splats.exr")
    sys.stdout.write(table(masks(file, folder), counted, own, few, truth))
    shown = [displayed(own), displayed((truth[0] + truth[1]) / 2)]
    sheet = [*shown, np.clip(0.5 + pictures.GAIN * (shown[0] - shown[1]), 0, 1)]
    Image.fromarray((255 * np.concatenate(sheet, axis=1)[::-1] + 0.5).astype(np.uint8)).save(options.output, quality=90)


if __name__ == "__main__":
    run(main)
