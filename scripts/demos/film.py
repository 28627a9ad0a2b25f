"""Build a short film in which everything moves that a farm has to draw alike on every machine.

    python -m scripts.demos.film --output out/film.blend [--frames 48] [--points 250000] [--size 160x90]

A cow twists on a scanned hill while smoke rises beside it, and the camera flies around them. The scan (.ply) and the
smoke (.vdb, one file a frame) lie in a folder of the .blend file's name beside it. Render it by
`python scripts/farm.py render out/film.blend --frames 1-48 --output out/film/shot.png --workers 2`.
"""

import argparse
import math
import sys
from pathlib import Path

import bpy
import numpy as np

import pointsplat_addon
from scripts.common.process import run
from scripts.common.volume_objects import medium, volume_object, write_vdb
from scripts.demos import park
from scripts.render import size

VOXELS = 24  # along a side of the smoke
SIDE = 12.0  # metres, of the scan


def height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Returns heights of the scanned hill, in metres: it is level where the cow stands."""
    return 0.06 * np.maximum(np.hypot(x, y) - 1.5, 0) ** 2 * (1 + 0.5 * np.sin(1.3 * x + 0.4 * y))


def write_scan(path: Path, points: int) -> None:
    """A binary PLY file of coloured points of the hill."""
    rng = np.random.default_rng(7)
    x, y = rng.uniform(-SIDE / 2, SIDE / 2, (2, points))
    shade = 0.5 + 0.5 * np.sin(3 * x) * np.cos(2 * y)
    color = np.stack([70 + 60 * shade, 110 + 50 * shade, 50 + 20 * shade], axis=1)
    records = np.empty(points, [("position", "<f4", 3), ("color", "u1", 3)])
    records["position"], records["color"] = np.stack([x, y, height(x, y)], axis=1), color
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {points}"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property uchar {channel}" for channel in ("red", "green", "blue")]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + records.tobytes())


def write_smoke(folder: Path, frames: int) -> Path:
    """A puff that rises and turns, a .vdb file a frame from 1 on; the path of the first."""
    x, y, z = np.meshgrid(*[(np.arange(VOXELS) + 0.5) / VOXELS * 2 - 1] * 3, indexing="ij", sparse=True)
    for frame in range(1, frames + 1):
        turn = 2 * math.pi * frame / 48
        cx, cy, cz = 0.25 * math.cos(turn), 0.25 * math.sin(turn), -0.4 + 0.6 * frame / frames
        distance = np.sqrt((x - cx) ** 2 + (y - cy) ** 2 + ((z - cz) / 1.2) ** 2)
        density = np.clip(1.5 - 2.5 * distance, 0, 1) * (0.7 + 0.3 * np.sin(9 * x + turn) * np.sin(8 * z - 2 * turn))
        write_vdb(folder / f"smoke_{frame:04d}.vdb", {"density": density}, (-1, -1, 0), 2 / VOXELS)
    return folder / "smoke_0001.vdb"


def keyframes(item, name: str, values: dict) -> None:
    """Animate a property: values by frame."""
    for frame, value in values.items():
        setattr(item, name, value)
        item.keyframe_insert(name, frame=frame)


def build(path: Path, frames: int, points: int, resolution: tuple[int, int]) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    folder = path.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, frames

    write_scan(folder / "hill.ply", points)
    bpy.ops.pointsplat.import_points(filepath=str(folder / "hill.ply"))
    bpy.context.object.location = (0, 0, 0)

    cow = park.load("spot/spot_triangulated.obj.gz", park.material("Cow", image="spot/spot_texture.png"), 1.6, "Cow")
    cow.data.shade_smooth()
    twist = cow.modifiers.new("Twist", "SIMPLE_DEFORM")
    twist.deform_method, twist.deform_axis = "TWIST", "Z"
    keyframes(twist, "angle", {1: -0.6, frames: 0.9})

    smoke = volume_object("Smoke", write_smoke(folder, frames), medium("Smoke", 4.0, (0.8, 0.82, 0.85)))
    smoke.location, smoke.scale = (1.3, 0.6, 0.2), (0.7, 0.7, 0.9)
    smoke.data.is_sequence = True
    smoke.data.frame_duration, smoke.data.frame_start, smoke.data.sequence_mode = frames, 1, "CLIP"

    park.light("SUN", "Sun", 3.0, (1.0, 0.95, 0.85), (4, -3, 6), (0, 0, 0)).angle = 0.0
    park.light("POINT", "Fill", 200.0, (0.7, 0.8, 1.0), (-3, -3, 4), (0, 0, 0.5)).shadow_soft_size = 0.0
    scene.world = bpy.data.worlds.new("Sky")
    if not scene.world.node_tree:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.25, 0.35, 0.5, 1.0)

    target = bpy.data.objects.new("Target", None)
    camera = scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    for item in (target, camera):
        scene.collection.objects.link(item)
    target.location = (0.4, 0.2, 0.8)
    follow = camera.constraints.new("TRACK_TO")
    follow.target, follow.track_axis, follow.up_axis = target, "TRACK_NEGATIVE_Z", "UP_Y"
    keyframes(camera, "location", {1: (-3.2, -4.2, 1.6), (1 + frames) // 2: (0.3, -5.2, 2.4), frames: (3.4, -3.6, 1.4)})
    camera.data.lens = 38

    scene.render.engine = "POINTSPLAT"
    scene.render.resolution_x, scene.render.resolution_y = resolution
    bpy.ops.wm.save_as_mainfile(filepath=str(path))  # paths are relative to where the file lies
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=48)
    parser.add_argument("--points", type=int, default=250_000)
    parser.add_argument("--size", type=size, default=(160, 90), metavar="WxH")
    options = parser.parse_args(sys.argv[1:])
    path = options.output.resolve()
    path.parent.mkdir(parents=True, exist_ok=True)
    build(path, options.frames, options.points, options.size)


if __name__ == "__main__":
    run(main)
