"""Compare translucency with closed forms, with ray marching in float64, and with Cycles.

    python -m scripts.studies.media --output DIR [--checks sphere,slab,shadow,planes] [--size 96] [--voxels 64]
        [--cycles-samples 256] [--no-cycles] [--no-pointsplat]

Scenes are made by this script and drawn from one file by both engines.
  sphere  a uniform ball of smoke, lit by a lamp outside and by one inside: absorbing over a floor that the lamp lights,
          and scattering once. Truth: scripts/common/media_truth.py. The RMSE leaves out rays that pass a lamp in
          scattering smoke at less than 0.1 of the ball's radius.
  slab    what a uniform slab lets through of a bright background, by angle, extinction and voxel size: exp(-s d).
  shadow  the same for the light of a sun that falls through the slab on a floor.
  planes  three coloured translucent planes in all orders: `over`.

DIR receives media.md (figures), media.json and a .png for each sphere: PointSplat, the truth, Cycles; below it the
differences of PointSplat and Cycles from the truth, times GAIN.
"""

import argparse
import itertools
import json
import math
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from scripts.common import media_truth as ref
from scripts.common.images import displayed
from scripts.common.process import run
from scripts.common.volume_objects import (
    ball,
    medium,
    surface,
    volume_object,
    volumes_last,
    write_vdb,
)

GAIN = 8.0  # of the difference pictures
FLOOR = -1.5  # height of the floor below a ball of radius 1
ALBEDO = 0.8  # of the floor
LAMPS = {"outside": (1.6, -1.2, 2.4), "inside": (0.25, -0.2, 0.3)}
# Name: density, colour, absorption colour, anisotropy, whether there is a floor.
SMOKES = {
    "absorbing": (1.5, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, True),
    "tinted": (3.0, (0.0, 0.0, 0.0), (0.8, 0.4, 0.1), 0.0, True),
    "scattering": (1.5, (0.9, 0.9, 0.9), (0.0, 0.0, 0.0), 0.0, False),
    "forward": (1.5, (0.9, 0.6, 0.3), (0.0, 0.0, 0.0), 0.6, False),
}
ANGLES = (0.0, 35.0, 60.0)
DEPTHS = (0.01, 0.1, 1.0, 5.0, 10.0, 20.0)
STEPS = (6, 12, 24)  # voxels across the slab
SLAB = 4.5  # width of the slab of thickness 1
PLANES = (((0.9, 0.1, 0.2), 0.3), ((0.1, 0.8, 0.3), 0.5), ((0.2, 0.3, 0.9), 0.7))  # emitted radiance, alpha


# ---------------------------------------------------------------------------- scenes


def studio(size: int) -> bpy.types.Scene:
    """An empty scene that shines nowhere, and a camera; both engines without bounces."""
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
    cycles = scene.cycles
    cycles.device, cycles.max_bounces, cycles.volume_bounces, cycles.transparent_max_bounces = "CPU", 0, 0, 16
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    cycles.pixel_filter_type = "BOX"
    cycles.filter_width = 1.0
    scene.pointsplat.use_indirect = False
    return scene


def look(item: bpy.types.Object, location, target) -> None:
    item.location = location
    item.rotation_euler = (Vector(target) - Vector(location)).to_track_quat("-Z", "Y").to_euler()


def lamp(scene: bpy.types.Scene, kind: str, energy: float, location, target=(0, 0, 0)) -> None:
    """Without size, so that shadows are hard."""
    data = bpy.data.lights.new("Lamp", kind)
    data.energy = energy
    if kind == "SUN":
        data.angle = 0.0
    else:
        data.shadow_soft_size = 0.0
    made = bpy.data.objects.new("Lamp", data)
    look(made, location, target)
    scene.collection.objects.link(made)


def sky(scene: bpy.types.Scene, radiance: float) -> None:
    scene.render.film_transparent = False
    scene.world = bpy.data.worlds.new("Sky")
    if not scene.world.node_tree:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1, 1, 1, 1)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = radiance


def plane(size: float, height: float, look_like: bpy.types.Material) -> bpy.types.Object:
    bpy.ops.mesh.primitive_plane_add(size=size, location=(0, 0, height))
    bpy.context.object.data.materials.append(look_like)
    return bpy.context.object


def sphere_scene(folder: Path, smoke: str, where: str, size: int, voxels: int) -> bpy.types.Scene:
    """A ball of radius 1 about the origin."""
    density, color, absorption, anisotropy, floor = SMOKES[smoke]
    scene = studio(size)
    path = folder / f"ball_{voxels}.vdb"
    write_vdb(path, {"density": ball(voxels)}, (-1, -1, -1), 2 / voxels)
    volume_object("Smoke", path, medium("Smoke", density, color, Absorption_Color=absorption, Anisotropy=anisotropy))
    lamp(scene, "POINT", 200.0, LAMPS[where])
    if floor:
        plane(8.0, FLOOR, surface("Floor", (ALBEDO,) * 3, Roughness=1.0, Specular_IOR_Level=0.0))
    look(scene.camera, (2.2, -4.4, 3.2), (0.0, 0.0, -0.3 if floor else 0.0))
    scene.camera.data.angle = math.radians(34 if floor else 26)
    return scene


def slab_scene(folder: Path, steps: int, depth: float, size: int) -> bpy.types.Scene:
    """A slab from height 0 to 1 whose depth along its normal is `depth`."""
    scene = studio(size)
    path = folder / f"slab_{steps}.vdb"
    wide = round(SLAB * steps)
    write_vdb(path, {"density": np.ones((wide, wide, steps), np.float32)}, (-SLAB / 2, -SLAB / 2, 0), 1 / steps)
    volume_object("Slab", path, medium("Slab", depth, (0.0, 0.0, 0.0)))
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 0.4
    return scene


def tilted(angle: float, distance: float, height: float = 0.5) -> Vector:
    """A place from which (0, 0, height) is seen at an angle from the vertical, in degrees."""
    turn, azimuth = math.radians(angle), math.radians(20)
    across = math.sin(turn)
    return Vector((across * math.cos(azimuth), across * math.sin(azimuth), math.cos(turn))) * distance + Vector(
        (0, 0, height)
    )


def planes_scene(order: tuple[int, ...], angle: float, size: int) -> bpy.types.Scene:
    """Planes, the first of `order` nearest to the camera above."""
    scene = studio(size)
    for rank, which in enumerate(order):
        color, alpha = PLANES[which]
        shine = surface(
            f"Plane {which}",
            (0.0, 0.0, 0.0),
            Specular_IOR_Level=0.0,
            Emission_Color=color,
            Emission_Strength=1.0,
            Alpha=alpha,
        )
        plane(4.0, -0.3 * rank, shine)
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 0.5
    look(scene.camera, tilted(angle, 4.0, -0.3), (0, 0, -0.3))
    return scene


# ---------------------------------------------------------------------------- pictures


def draw(scene: bpy.types.Scene, folder: Path, engine: str, samples: int) -> np.ndarray:
    """(H, W, 4) float64, premultiplied, scene-linear, bottom row first."""
    volumes_last(scene)
    scene.render.engine = engine
    scene.cycles.samples = samples
    if engine == "POINTSPLAT":
        scene.pointsplat.samples = samples
    scene.render.filepath = str(folder / "frame.exr")
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4).astype(float)


def rays(scene: bpy.types.Scene, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Origins and unit directions (H * W * samples^2, 3) of camera rays in world space, pixel by pixel."""
    from pointsplat_addon.host.convert.camera import from_camera_object

    width, height = scene.render.resolution_x, scene.render.resolution_y
    camera = from_camera_object(scene.camera, bpy.context.evaluated_depsgraph_get(), width, height)
    fx, fy, cx, cy = camera.pixel_from_view()
    part = (np.arange(samples) + 0.5) / samples
    y, x, v, u = (a.ravel() for a in np.meshgrid(np.arange(height), np.arange(width), part, part, indexing="ij"))
    direction = np.stack([(x + u - cx) / fx, (y + v - cy) / fy, np.full(len(x), -1.0)], axis=1)
    world_from_view = np.linalg.inv(camera.view_from_world)
    direction = direction @ world_from_view[:3, :3].T
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    return np.broadcast_to(world_from_view[:3, 3], direction.shape), direction


def sphere_truth(scene: bpy.types.Scene, smoke: str, samples: int = 3) -> np.ndarray:
    """What `sphere_scene` looks like, (H, W, 4), marched."""
    from pointsplat_addon.host.convert.light.lights import convert_lights

    density, color, absorption, anisotropy, floor = SMOKES[smoke]
    scattering = density * np.array(color)
    extinction = scattering + density * (1 - np.array(color)) * (1 - np.sqrt(absorption))
    field = ref.sphere((0, 0, 0), 1.0, extinction, albedo=scattering / extinction, anisotropy=anisotropy)
    light = convert_lights(bpy.context.evaluated_depsgraph_get())[0][0]
    origins, directions = rays(scene, samples)

    ground = np.full(len(origins), np.inf)
    behind = np.zeros((len(origins), 4))
    if floor:
        ground = (FLOOR - origins[:, 2]) / directions[:, 2]
        p = origins + ground[:, None] * directions
        hit = (ground > 0) & (np.abs(p[:, :2]).max(axis=1) < 4)
        to_lamp = light.position - p
        distance = np.linalg.norm(to_lamp, axis=1)
        to_lamp /= distance[:, None]
        lit = np.exp(-ref.optical_depth(field, p, to_lamp, distance)) * light.color * ALBEDO / math.pi
        behind[hit] = np.column_stack([lit * (to_lamp[:, 2:] / distance[:, None] ** 2), np.ones(len(p))])[hit]
        ground = np.where(hit, ground, np.inf)
    seen = ref.march(field, origins, directions, [light] if scattering.any() else [], ground, tolerance=1e-4)
    rgb = seen.radiance + seen.transmittance * behind[:, :3]
    through = seen.transmittance.mean(axis=1)
    alpha = 1 - through * (1 - behind[:, 3])
    side = scene.render.resolution_x
    return np.column_stack([rgb, alpha]).reshape(side, side, samples**2, 4).mean(axis=2)


def beside_lamp(scene: bpy.types.Scene, distance: float) -> np.ndarray:
    """(H, W) bool: pixels whose rays pass the lamp at no less than a distance. Nearer to it the radiance of what
    scatters grows beyond all bounds, where voxels are even."""
    origins, directions = rays(scene, 1)
    to_lamp = np.array(bpy.data.objects["Lamp"].location) - origins
    side = scene.render.resolution_x
    return (np.linalg.norm(np.cross(to_lamp, directions), axis=1) >= distance).reshape(side, side)


def middle(pixels: np.ndarray) -> np.ndarray:
    """(3,) mean colour of the middle ninth."""
    third = len(pixels) // 3
    return pixels[third:-third, third:-third, :3].mean(axis=(0, 1))


def save(rows: list[list[np.ndarray]], path: Path) -> None:
    """Rows of displayed pictures (H, W, 3), bottom row first, as one .png."""
    sheet = np.concatenate([np.concatenate(row, axis=1) for row in rows[::-1]], axis=0)
    height, width, _ = sheet.shape
    image = bpy.data.images.new("sheet", width, height)
    image.pixels.foreach_set(np.dstack([sheet, np.ones((height, width))]).astype(np.float32).ravel())
    image.file_format = "PNG"
    image.save(filepath=str(path))
    bpy.data.images.remove(image)


# ---------------------------------------------------------------------------- checks


def row(check: str, case: str, engine: str, measure: str, value: float, limit: float) -> dict:
    return {"check": check, "case": case, "engine": engine, "measure": measure, "value": float(value), "limit": limit}


def difference(picture: np.ndarray, truth: np.ndarray, kept: np.ndarray | None = None) -> tuple[float, float]:
    """RMSE of the colours over the greatest one in the truth, but for a thousandth, of pixels `kept` (H, W) bool; and
    the relative error of the mean of all."""
    where = np.ones(truth.shape[:2], bool) if kept is None else kept
    rmse = math.sqrt(((picture - truth)[where, :3] ** 2).mean()) / np.quantile(truth[where, :3], 0.999)
    return float(rmse), float(picture[..., :3].mean() / truth[..., :3].mean() - 1)


def check_sphere(args: argparse.Namespace, folder: Path) -> list[dict]:
    found = []
    for smoke, where in itertools.product(SMOKES, LAMPS):
        scene = sphere_scene(folder, smoke, where, args.size, args.voxels)
        truth, case = sphere_truth(scene, smoke), f"{smoke}, lamp {where}"
        kept = beside_lamp(scene, 0.0 if SMOKES[smoke][-1] else 0.1)
        pictures = {}
        for engine in args.engines:
            pixels = draw(scene, folder, engine, args.cycles_samples if engine == "CYCLES" else args.samples)
            pictures[engine] = pixels
            rmse, mean = difference(pixels, truth, kept)
            found.append(row("sphere", case, engine, "RMSE / peak", rmse, 0.01))
            found.append(row("sphere", case, engine, "mean", mean, 0.05))
        if len(pictures) == 2:
            mean = pictures["POINTSPLAT"][..., :3].mean() / pictures["CYCLES"][..., :3].mean() - 1
            found.append(row("sphere", case, "POINTSPLAT / CYCLES", "mean", mean, 0.05))
        scale = 0.8 / np.quantile(truth[..., :3], 0.99)
        shown = {name: displayed(p * scale) for name, p in {"TRUTH": truth, **pictures}.items()}
        blank = np.zeros_like(shown["TRUTH"])
        errors = {e: np.clip(GAIN * np.abs(shown[e] - shown["TRUTH"]), 0, 1) for e in pictures}
        top = [shown.get("POINTSPLAT", blank), shown["TRUTH"], shown.get("CYCLES", blank)]
        save(
            [top, [errors.get("POINTSPLAT", blank), blank, errors.get("CYCLES", blank)]],
            args.output / f"{smoke}_{where}.png",
        )
    return found


def transmittance_error(pixels: np.ndarray, truth: float) -> float:
    """Relative error of T up to a depth of 5, of -ln T beyond."""
    measured = float(np.mean(pixels))
    if truth <= 5:
        return measured / math.exp(-truth) - 1
    return -math.log(max(measured, 1e-300)) / truth - 1


def check_slab(args: argparse.Namespace, folder: Path) -> list[dict]:
    """Camera rays against a sky of radiance 1."""
    found = []
    for steps, depth, angle in itertools.product(STEPS, DEPTHS, ANGLES):
        scene = slab_scene(folder, steps, depth / math.cos(0), 48)
        sky(scene, 1.0)
        look(scene.camera, tilted(angle, 4.0), (0, 0, 0.5))
        along = depth / math.cos(math.radians(angle))
        for engine in args.engines:
            if engine == "CYCLES" and (steps != STEPS[0] or depth > 1):
                continue
            error = transmittance_error(middle(draw(scene, folder, engine, args.samples)), along)
            case = f"s d = {along:.4g}, {angle:g} degrees, {steps} voxels"
            found.append(row("slab", case, engine, "T" if along <= 5 else "-ln T", error, 0.005))
    return found


def check_shadow(args: argparse.Namespace, folder: Path) -> list[dict]:
    """Light of a sun through the slab, seen on a floor by a camera below the slab."""
    found = []
    for steps, depth, angle in itertools.product(STEPS, DEPTHS, ANGLES):
        scene = slab_scene(folder, steps, depth, 48)
        plane(2.0, -0.5, surface("Floor", (ALBEDO,) * 3, Roughness=1.0, Specular_IOR_Level=0.0))
        lamp(scene, "SUN", 1.0, tilted(angle, 4.0), (0, 0, 0.5))
        look(scene.camera, (0, 0, -0.1), (0, 0, -0.5))
        # Where the sun's middle ray meets the floor.
        shift = tilted(angle, 1.0) - Vector((0, 0, 0.5))
        spot = Vector((0, 0, 0.5)) - shift / shift.z
        scene.camera.location.xy, bpy.data.objects["Plane"].location.xy = spot.xy, spot.xy
        along = depth / math.cos(math.radians(angle))
        unshadowed = ALBEDO / math.pi * math.cos(math.radians(angle))
        for engine in args.engines:
            if engine == "CYCLES" and (steps != STEPS[0] or depth > 1):
                continue
            error = transmittance_error(middle(draw(scene, folder, engine, args.samples)) / unshadowed, along)
            case = f"s d = {along:.4g}, {angle:g} degrees, {steps} voxels"
            found.append(row("shadow", case, engine, "T" if along <= 5 else "-ln T", error, 0.005))
    return found


def check_planes(args: argparse.Namespace, folder: Path) -> list[dict]:
    found = []
    for order, angle in itertools.product(itertools.permutations(range(len(PLANES))), (0.0, 50.0)):
        scene = planes_scene(order, angle, 48)
        truth = np.zeros(3)
        for which in reversed(order):
            color, alpha = PLANES[which]
            truth = alpha * np.array(color) + (1 - alpha) * truth
        for engine in args.engines:
            pixels = draw(scene, folder, engine, args.cycles_samples if engine == "CYCLES" else args.samples)
            third = len(pixels) // 3
            error = pixels[third:-third, third:-third, :3] - truth
            case = f"{order}, {angle:g} degrees"
            found.append(row("planes", case, engine, "mean, of 1", np.abs(error.mean(axis=(0, 1))).max(), 1 / 255))
            if engine == "POINTSPLAT":
                found.append(row("planes", case, engine, "any pixel, of 1", np.abs(error).max(), 1 / 255))
    return found


CHECKS = {"sphere": check_sphere, "slab": check_slab, "shadow": check_shadow, "planes": check_planes}


def table(found: list[dict]) -> str:
    """The worst case of each check, engine and measure, as Markdown; then all that exceed their limit."""
    groups: dict[tuple, list[dict]] = {}
    for item in found:
        name = item["case"] if item["check"] == "sphere" else ""
        groups.setdefault((item["check"], name, item["engine"], item["measure"]), []).append(item)
    lines = ["| check | case | engine | measure | cases | worst error | limit |", "|---|---|---|---|---|---|---|"]
    for (check, _, engine, measure), group in groups.items():
        worst = max(group, key=lambda item: abs(item["value"]))
        lines.append(
            f"| {check} | {worst['case']} | {engine} | {measure} | {len(group)} | {100 * worst['value']:+.3f} % "
            f"| {100 * worst['limit']:.2g} % |"
        )
    return "\n".join(lines) + "\n"


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--checks", type=lambda t: t.split(","), default=list(CHECKS))
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--voxels", type=int, default=128)
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--cycles-samples", type=int, default=256)
    parser.add_argument("--no-cycles", action="store_true")
    parser.add_argument("--no-pointsplat", action="store_true")
    args = parser.parse_args()
    args.engines = ([] if args.no_pointsplat else ["POINTSPLAT"]) + ([] if args.no_cycles else ["CYCLES"])
    return args


def main() -> None:
    args = arguments()
    import pointsplat_addon

    pointsplat_addon.register()
    args.output = args.output.resolve()
    args.output.mkdir(parents=True, exist_ok=True)
    found: list[dict] = []
    with tempfile.TemporaryDirectory() as folder:
        for name in args.checks:
            found += CHECKS[name](args, Path(folder))
    (args.output / "media.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    (args.output / "media.md").write_text(table(found), encoding="utf-8")
    sys.stdout.write(table(found))


if __name__ == "__main__":
    run(main)
