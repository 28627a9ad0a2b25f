"""Compare points with polygons and with Cycles: pictures, differences, and a table of figures.

    python -m scripts.studies.gallery MODEL[,TEXTURE] ... --output DIR [--views 24] [--size 512] [--samples 16]
        [--tolerances 2,1,0.5,0.25] [--no-pictures]

MODEL is a .ply or .obj file, which may be compressed (.gz); TEXTURE becomes its base colour. Each model is drawn from
`--views` directions that are spread evenly over the sphere, as points and as polygons by PointSplat, and once by
Cycles, lit by one sun without shadows. DIR receives NAME.jpg (points, polygons, Cycles, and their differences),
figures.json with every view's figures, and figures.md with the worst of them.

scripts/common/images.py says what is measured.
"""

import argparse
import gzip
import json
import math
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from scripts.common.images import compare, directions, displayed
from scripts.common.process import run

ROOT = Path(__file__).resolve().parents[2]
GAIN = 8.0  # of the difference pictures


# ---------------------------------------------------------------------------- Blender


def read(path: Path) -> bpy.types.Object:
    """The model with its own materials: joined, centred, one unit in radius."""
    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder, path.stem) if path.suffix == ".gz" else path
        if plain != path:
            plain.write_bytes(gzip.decompress(path.read_bytes()))
        operator = {".ply": bpy.ops.wm.ply_import, ".obj": bpy.ops.wm.obj_import}[plain.suffix.lower()]
        operator(filepath=str(plain), forward_axis="NEGATIVE_Z", up_axis="Y")
    parts = [o for o in bpy.context.selected_objects if o.type == "MESH"]
    if len(parts) > 1:
        with bpy.context.temp_override(active_object=parts[0], selected_editable_objects=parts):
            bpy.ops.object.join()
    model = parts[0]
    mesh = model.data
    mesh.transform(model.matrix_world)
    model.matrix_world = Matrix.Identity(4)
    position = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", position)
    position = position.reshape(-1, 3)
    middle = (position.min(0) + position.max(0)) / 2
    position = (position - middle) / np.linalg.norm(position - middle, axis=1).max()
    mesh.vertices.foreach_set("co", np.ascontiguousarray(position, np.float32).reshape(-1))
    mesh.update()
    return model


def load(path: Path, texture: Path | None) -> bpy.types.Object:
    """The model, joined, centred, one unit in radius, smooth, with one Principled material."""
    model = read(path)
    model.data.shade_smooth()
    model.data.materials.clear()
    model.data.materials.append(material(texture))
    return model


def material(texture: Path | None) -> bpy.types.Material:
    made = bpy.data.materials.new("Surface")
    if not made.node_tree:
        made.use_nodes = True
    nodes = made.node_tree.nodes
    surface = nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (0.55, 0.42, 0.30, 1.0)
    surface.inputs["Roughness"].default_value = 0.5
    if texture:
        picture = nodes.new("ShaderNodeTexImage")
        picture.image = bpy.data.images.load(str(texture))
        made.node_tree.links.new(picture.outputs["Color"], surface.inputs["Base Color"])
    return made


def studio(size: int) -> bpy.types.Scene:
    """A camera, one sun that casts no shadows, nothing else that shines."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.film_transparent = True
    image = scene.render.image_settings
    if hasattr(image, "media_type"):
        image.media_type = "IMAGE"
    image.file_format, image.color_mode, image.color_depth, image.exr_codec = "OPEN_EXR", "RGBA", "32", "NONE"
    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.data.energy = 4.0
    sun.data.use_shadow = False
    if hasattr(sun.data.cycles, "cast_shadow"):  # until Blender 4.5 Cycles had a switch of its own
        sun.data.cycles.cast_shadow = False
    scene.collection.objects.link(sun)
    cycles = scene.cycles
    cycles.device, cycles.max_bounces = "CPU", 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    return scene


def look_from(scene: bpy.types.Scene, direction: np.ndarray) -> None:
    """Put the camera where it sees the unit sphere fill the picture, and the sun over its left shoulder."""
    camera = scene.camera
    camera.data.angle = math.radians(35)
    distance = 1.05 / math.sin(math.radians(35) / 2)
    camera.location = Vector(direction) * distance
    turn = (-Vector(direction)).to_track_quat("-Z", "Y")
    camera.rotation_euler = turn.to_euler()
    camera.data.clip_start, camera.data.clip_end = distance - 1.5, distance + 1.5
    scene.objects["Sun"].rotation_euler = (turn @ Vector((0.45, -0.5, -1.0)).to_track_quat("-Z", "Y")).to_euler()


def picture(scene: bpy.types.Scene, path: Path) -> np.ndarray:
    """(H, W, 4) float32, premultiplied, scene-linear, bottom row first."""
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path))
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)


class Studio:
    """Renders one model in several ways."""

    def __init__(self, model: Path, texture: Path | None, size: int, folder: Path) -> None:
        self.scene = studio(size)
        self.model = load(model, texture)
        self.path = folder / "frame.exr"

    def pointsplat(self, primitive: str, direction: np.ndarray, tolerance: float, samples: int) -> np.ndarray:
        scene = self.scene
        look_from(scene, direction)
        scene.render.engine = "POINTSPLAT"
        settings = scene.pointsplat
        settings.tolerance, settings.samples, settings.use_indirect = tolerance, samples, False
        self.model.pointsplat.primitive = primitive
        return picture(scene, self.path)

    def cycles(self, direction: np.ndarray, samples: int) -> np.ndarray:
        scene = self.scene
        look_from(scene, direction)
        scene.render.engine = "CYCLES"
        scene.cycles.samples = samples
        return picture(scene, self.path)


# ---------------------------------------------------------------------------- pictures and tables


def save(rgb: np.ndarray, path: Path, quality: int = 88) -> None:
    """Displayed values (H, W, 3), bottom row first, as a .jpg or .png."""
    height, width, _ = rgb.shape
    image = bpy.data.images.new("out", width, height)
    image.pixels.foreach_set(np.dstack([rgb, np.ones((height, width))]).astype(np.float32).reshape(-1))
    image.file_format = "JPEG" if path.suffix == ".jpg" else "PNG"
    image.save(filepath=str(path), quality=quality)
    bpy.data.images.remove(image)


def sheet(points: np.ndarray, polygons: np.ndarray, cycles: np.ndarray) -> np.ndarray:
    """Points, polygons, Cycles; the differences of points from both, times GAIN."""
    shown = [displayed(p) for p in (points, polygons, cycles)]
    differences = [np.clip(GAIN * np.abs(shown[0] - other), 0, 1) for other in shown[1:]]
    return np.concatenate([*shown, *differences], axis=1)


def summarise(rows: list[dict]) -> dict[str, float]:
    """Over views: the most holes, thickening as far from 1 as it comes, of everything else the least; and means."""
    return {
        "views": len(rows),
        "holes": max(r["holes"] for r in rows),
        "thickening": max((r["thickening"] for r in rows), key=lambda t: abs(t - 1)),
        **{key: min(r[key] for r in rows) for key in ("iou", "soft_iou", "psnr", "interior_psnr")},
        **{f"mean_{key}": float(np.mean([r[key] for r in rows])) for key in ("iou", "thickening", "psnr")},
    }


def table(summary: list[dict]) -> str:
    """Worst (mean) over views, as Markdown."""
    lines = [
        "| model | tolerance | samples | views | holes | IoU | thickening | PSNR | interior PSNR |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for s in summary:
        lines.append(
            f"| {s['model']} | {s['tolerance']:g} | {s['samples']} | {s['views']} | {s['holes']} | "
            f"{s['iou']:.4f} ({s['mean_iou']:.4f}) | {s['thickening']:.4f} ({s['mean_thickening']:.4f}) | "
            f"{s['psnr']:.1f} dB ({s['mean_psnr']:.1f}) | {s['interior_psnr']:.1f} dB |"
        )
    return "\n".join(lines) + "\n"


def measure(name: str, shop: Studio, args: argparse.Namespace) -> list[dict]:
    """The figures of every view, tolerance and number of samples."""
    rows = []
    for samples, tolerances in ((args.samples, args.tolerances), (1, [1.0])):
        polygons = [shop.pointsplat("POLYGONS", d, 1.0, samples) for d in directions(args.views)]
        # Samples are only ever refined: coarse tolerances come first.
        for tolerance in sorted(tolerances, reverse=True):
            forget_points()
            for view, direction in enumerate(directions(args.views)):
                points = shop.pointsplat("POINTS", direction, tolerance, samples)
                figures = compare(points, polygons[view])
                rows.append({"model": name, "view": view, "tolerance": tolerance, "samples": samples, **figures})
    return rows


def forget_points() -> None:
    """Let the next picture choose its points anew, as the first one of a session does."""
    from pointsplat_addon.host.shared_store import STORE

    STORE.clear()


def show(name: str, shop: Studio, args: argparse.Namespace) -> dict:
    """Write the sheet of one view; PSNR and silhouettes against Cycles."""
    direction = np.array(args.direction) / np.linalg.norm(args.direction)
    forget_points()
    points = shop.pointsplat("POINTS", direction, 1.0, args.samples)
    polygons = shop.pointsplat("POLYGONS", direction, 1.0, args.samples)
    cycles = shop.cycles(direction, args.cycles_samples)
    save(sheet(points, polygons, cycles), args.output / f"{name}.jpg")
    for label, pixels in (("points", points), ("polygons", polygons), ("cycles", cycles)):
        if args.keep:
            np.save(args.output / f"{name}_{label}.npy", pixels)
    return {"model": name, "points_cycles": compare(points, cycles), "polygons_cycles": compare(polygons, cycles)}


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", nargs="+", metavar="MODEL[,TEXTURE]")
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--cycles-samples", type=int, default=256)
    parser.add_argument("--tolerances", type=lambda t: [float(x) for x in t.split(",")], default=[2.0, 1.0, 0.5, 0.25])
    parser.add_argument("--direction", type=lambda t: [float(x) for x in t.split(",")], default=[0.5, -1.0, 0.45])
    parser.add_argument("--no-pictures", action="store_true")
    parser.add_argument("--no-figures", action="store_true")
    parser.add_argument("--keep", action="store_true", help="write the pictures' pixels as .npy too")
    return parser.parse_args()


def main() -> None:
    args = arguments()
    import pointsplat_addon

    pointsplat_addon.register()
    args.output.mkdir(parents=True, exist_ok=True)
    rows: list[dict] = []
    against_cycles = []
    with tempfile.TemporaryDirectory() as folder:
        for item in args.models:
            model, _, texture = item.partition(",")
            name = Path(model).name.split(".")[0]
            shop = Studio(Path(model), Path(texture) if texture else None, args.size, Path(folder))
            if not args.no_pictures:
                against_cycles.append(show(name, shop, args))
            if not args.no_figures:
                rows += measure(name, shop, args)
    groups: dict[tuple, list[dict]] = {}
    for row in rows:
        groups.setdefault((row["model"], row["tolerance"], row["samples"]), []).append(row)
    keys = ("model", "tolerance", "samples")
    summary = [{**dict(zip(keys, key, strict=True)), **summarise(group)} for key, group in groups.items()]
    everything = {"summary": summary, "cycles": against_cycles, "views": rows}
    (args.output / "figures.json").write_text(json.dumps(everything, indent=1) + "\n", encoding="utf-8")
    (args.output / "figures.md").write_text(table(summary), encoding="utf-8")
    sys.stdout.write(table(summary) + json.dumps(against_cycles, indent=1) + "\n")


if __name__ == "__main__":
    run(main)
