"""Draw many scenes in many ways into a folder of pictures, and compare two such folders bit by bit.

    python -m tests.support.pictures draw DIR [--quick] [--only NAME ...] [--devices]
    python -m tests.support.pictures compare A B [--most N]
    python -m tests.support.pictures list

Run it in the root of a checkout: that checkout is drawn. A scene is named GROUP/NAME, and --only takes names of scenes
or patterns of them: `mixed`, `cases/mixed`, `rows/*`. --quick draws a dozen scenes for a first look. The groups are

    cases      all of the shared scenes of the tests
    rows       what docs/notes/leave_out.md counts: scenes with one feature more, or less, than another
    extremes   other sizes, distances, fields of view and broken values
    blends     the demo scenes, through Blender's own render operator, in a process of its own
    gpu        some of the above on Blender's gpu module, in a process of its own: only with --devices

DIR/GROUP/NAME.npz holds all arrays of a scene as WAY/PASS, DIR/GROUP/NAME.json the numbers of each report, and
DIR/about.json what drew them. Every picture starts with nothing prepared and uses no budget of time, so that it does
not depend on what was drawn before it or on what else the machine does. It may depend on the driver and the processor:
only compare folders from one machine.

`compare` exits with 1 where a picture or a number differs, or is missing from a scene that both folders have. Scenes
that only one folder has are named and are no error, so that a --quick folder can be compared with a full one.
"""

from __future__ import annotations

import argparse
import fnmatch
import importlib
import json
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

# NumPy 1.26 computes arctan2 and its like of a column of an array by other code, which rounds otherwise, where malloc
# happens to put the result right behind that array. Samples that lie on the edge between two cells of a shadow table
# then fall into either. Without these features of the processor there is only one code. Later versions of NumPy do not
# know their names, and have no need to. Processes that are started here inherit this.
os.environ["NPY_DISABLE_CPU_FEATURES"] = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL"

import numpy as np

from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.settings import DOF_METHODS, TECHNIQUES
from pointsplat_addon.render.passes.outputs import PASSES
from pointsplat_addon.render.plan.request import Result
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, clouds, drawing
from scripts.scenes.case import ALL_PASSES, Case
from scripts.scenes.cases import CASES
from scripts.scenes.store import STORE
from tests.support import extremes
from tests.support.leave_out.rows import ROWS, Row

ROOT = Path(__file__).resolve().parents[2]
DEVICE_MODULE = "pointsplat_addon.devices.blender_gpu"
EXR_MODULE, EXR_READER = "tests.support.files", "read_exr"
RENDER_SCRIPT = "scripts.render"
DEMO_SCRIPTS = {
    "demo": "scripts.demos.park",
    "translucent": "scripts.demos.translucent",
    "lens": "scripts.demos.depth_of_field",
    "towers": "scripts.demos.towers",
    "gallery": "scripts.studies.gallery",
    "media": "scripts.studies.media",
}

WIDTH = 96  # pixels
SAMPLES = 4
VOXELS = 24  # along the longest side of a demo scene's volumes
COMBINED = frozenset({"combined"})
EVERY = ALL_PASSES
SPLAT_TECHNIQUES = tuple(t for t in TECHNIQUES if t != "AUTO")

# Which cases are drawn in further ways.
WITH_SHADOWS = (
    "cube", "sphere", "mixed", "textured", "instances", "wide_balls", "holdout", "environment", "lights", "inside",
    "far_away", "parallel", "region", "culled", "foliage", "many_towers", "split_mesh",
)  # fmt: skip
LENSES = {  # radius and distance of what is in focus
    "sphere": (0.3, 3.0), "mixed": (0.15, 4.0), "textured": (0.3, 3.5), "instances": (0.2, 3.0),
    "wide_balls": (0.3, 2.5), "parallel_balls": (0.5, 10.0), "emission": (0.2, 5.0), "holdout": (0.15, 4.5),
    "environment": (0.02, 4.0), "lights": (0.2, 4.0), "inside": (0.1, 1.5), "moving": (0.2, 3.0), "smoke": (0.3, 3.0),
    "panes": (0.2, 4.5), "foliage": (0.3, 4.0), "many_towers": (1.0, 12.0), "strands": (0.2, 3.0),
}  # fmt: skip
BLADES = ("mixed", "foliage", "strands")
COARSE = ("sphere", "textured", "panes", "foliage", "many_towers", "split_mesh", "strands", "smoke")
FINE = ("textured", "instances", "foliage", "panes")
ADAPTIVE = ("mixed", "textured", "panes", "smoke", "foliage", "strands")
BELOW_ERROR = ("mixed", "textured", "smoke", "foliage", "strands")
WITHOUT_ATOMICS = ("sphere", "mixed", "instances", "wide_balls", "inside", "foliage", "panes", "split_mesh")
INTERACTIVE = ("mixed", "textured", "panes", "smoke", "strands", "moving")
KEPT = ("mixed", "textured", "panes", "smoke", "foliage", "many_towers", "split_mesh", "strands")

QUICK = (
    "cases/mixed", "cases/textured", "cases/wide_balls", "cases/holdout", "cases/lights", "cases/moving",
    "cases/smoke", "cases/panes", "cases/foliage", "cases/strands", "rows/smoke_twice_shadows", "rows/dense_mesh",
    "extremes/film",
)  # fmt: skip
ON_BLENDERS_GPU = (
    "cases/cube", "cases/sphere", "cases/mixed", "cases/textured", "cases/instances", "cases/wide_balls",
    "cases/holdout", "cases/environment", "cases/lights", "cases/moving", "cases/smoke", "cases/panes",
    "cases/foliage", "cases/strands", "cases/split_mesh", "extremes/all_kinds", "blends/glow", "blends/depth_of_field",
    "blends/demo",
)  # fmt: skip


# What is drawn


@dataclass(frozen=True)
class Way:
    """One way to draw a scene."""

    settings: dict[str, Any] = field(default_factory=dict)  # that replace those of the case
    passes: frozenset[str] = COMBINED
    samples: int = SAMPLES
    aperture: Any = None  # None: that of the case, which may have none
    interactive: bool = False
    atomics: bool = True  # whether the device may use image atomics
    kept: bool = False  # a coarser picture is drawn first, of which points and uploads are kept


@dataclass(frozen=True)
class Subject:
    """A scene and all the ways to draw it."""

    case: Callable[[], Case]
    ways: dict[str, Way]


def technique_ways(passes: frozenset[str] = COMBINED) -> dict[str, Way]:
    """Each technique once."""
    return {technique: Way({"technique": technique}, passes) for technique in TECHNIQUES}


def further_ways(name: str) -> Iterator[tuple[str, Way]]:
    """The ways to draw a case besides its techniques, chosen by the tables above."""
    yield "AUTO, combined", Way()
    for technique in SPLAT_TECHNIQUES:
        by = {"technique": technique}
        if name in WITH_SHADOWS:
            yield f"{technique}, shadows", Way({**by, "use_shadows": True, "shadow_resolution": 256})
        if name in LENSES:
            for method in DOF_METHODS:
                yield f"{technique}, {method}", Way({**by, "dof_method": method}, aperture=Aperture(*LENSES[name]))
        if name in COARSE:
            yield f"{technique}, coarse", Way({**by, "tolerance": 4.0})
    if name in LENSES:
        yield "AUTO, lens, every pass", Way(passes=EVERY, aperture=Aperture(*LENSES[name]))
    if name in BLADES:
        blades = Aperture(*LENSES[name], 5, 0.3)
        yield "AUTO, blades", Way({"dof_method": "LENS_SAMPLES"}, aperture=blades)
    if name in FINE:
        yield "AUTO, fine", Way({"tolerance": 0.25})
    if name in ADAPTIVE:
        yield "AUTO, adaptive", Way(samples=32)
    if name in BELOW_ERROR:
        yield "AUTO, below an error", Way({"budget": "ERROR", "error_budget": 0.02})
    if name in WITHOUT_ATOMICS:
        yield "IMAGE_SPACE, without atomics", Way({"technique": "IMAGE_SPACE"}, EVERY, atomics=False)
    if name in INTERACTIVE:
        yield "AUTO, interactive", Way(interactive=True)
    if name in KEPT:
        yield "AUTO, kept", Way(kept=True)


def row_ways(row: Row, is_new: bool) -> dict[str, Way]:
    """The row as it is, and by all techniques where no other scene has what it has."""
    ways = {"row": Way({}, row.passes, row.samples, interactive=row.interactive)}
    return ways | technique_ways() if is_new else ways


def row_subjects() -> Iterator[tuple[str, Subject]]:
    """The rows of docs/notes/leave_out.md. Those that only ask for something else are drawn once, as they are."""
    known = {getattr(case, "__wrapped__", case) for case in CASES.values()}
    for name, row in ROWS.items():
        is_new = row.case not in known and row.passes == COMBINED and row.case().settings.technique == "AUTO"
        known.add(row.case)
        yield f"rows/{slug(name)}", Subject(cache(row.case), row_ways(row, is_new))


def slug(name: str) -> str:
    """A name as a file's, in the words of today: what was a lamp is a light."""
    return re.sub(r"\W+", "_", name.lower().replace("lamp", "light")).strip("_")


def extreme_subjects() -> Iterator[tuple[str, Subject]]:
    """All kinds of geometry at other sizes, at other places and in other views, and values that are no numbers."""

    def kinds() -> Case:
        return extremes.all_kinds("pictures")

    def seen(**more: Any) -> Case:
        """By another camera from the same place."""
        return replace(kinds(), camera=cameras.camera((0.5, -4, 0.7), **{"resolution": extremes.FEW, **more}))

    def in_angle(angle: float) -> Case:
        """The block by a lens of this angle, without the mesh of points, which the near plane cuts."""
        distance = 0.6 + 0.6 / np.tan(np.radians(angle) / 2)
        near, far = distance / 1e3, distance * 1e2
        eye = cameras.camera((0.7, 0.2 - distance, 0), (0.7, 0.2, 0), extremes.FEW, angle, near, far)
        return extremes.without(replace(kinds(), camera=eye), [2])

    makers: dict[str, Callable[[], Case]] = {
        "scaled_to_a_thousandth": lambda: extremes.scaled(kinds(), 1e-3),
        "scaled_by_a_thousand": lambda: extremes.scaled(kinds(), 1e3),
        "a_million_off": lambda: extremes.shifted(kinds(), np.array([1e6, -2e6, 1e6])),
        "near_over_far": lambda: seen(near=1e-9, far=1e9),
        "parallel": lambda: seen(parallel=4.0, shift=(0.05, -0.1)),
        "wide_angle": lambda: in_angle(150.0),
        "narrow_angle": lambda: in_angle(0.1),
        "flat_picture": lambda: seen(resolution=(WIDTH, 5)),
        "border": lambda: seen(region=(3, 2, 17, 19)),
        "film": lambda: replace(kinds(), scene=replace(kinds().scene, transparent=True)),
        "odd_values": odd_values,
    }
    yield "extremes/all_kinds", Subject(cache(kinds), technique_ways(EVERY) | {
        "AUTO, combined": Way(),
        **{
            f"{t}, {method}": Way({"technique": t, "dof_method": method}, aperture=Aperture(0.2, 3.5))
            for t in SPLAT_TECHNIQUES for method in DOF_METHODS
        },
        **{f"{t}, no shadows": Way({"technique": t, "use_shadows": False}) for t in SPLAT_TECHNIQUES},
        "AUTO, adaptive": Way(samples=32),
        "AUTO, without atomics": Way(passes=EVERY, atomics=False),
        "AUTO, kept": Way(kept=True),
    })  # fmt: skip
    for name, make in makers.items():
        yield f"extremes/{name}", Subject(cache(make), technique_ways())


def odd_values() -> Case:
    """Planes of points, of which each third has a value that is no number or too large for one."""
    things = []
    for i, odd in enumerate((np.nan, np.inf, -np.inf, 1e-42, -1e30, 3e38)):
        for j, name in enumerate(("position", "normal", "radii", "color")):
            cloud = clouds.plane_cloud(8, 0.8)
            cloud = replace(cloud, color=np.full((len(cloud), 3), 0.5, np.float32))
            values = getattr(cloud, name).copy()
            values[::3] = odd
            geometry = build.points(f"pictures: {name} {odd}", replace(cloud, **{name: values}))
            things.append((geometry, build.moved((0.5 * i - 1.25, 0, 0.5 * j - 0.75), 0.25)))
    return Case(build.scene(*things), cameras.camera((0.3, -4, 0.4)))


@cache
def subjects() -> dict[str, Subject]:
    """All scenes that need no Blender."""
    cases = {
        f"cases/{name}": Subject(make, technique_ways(EVERY) | dict(further_ways(name))) for name, make in CASES.items()
    }
    return cases | dict(row_subjects()) | dict(extreme_subjects())


# Drawing


@dataclass(frozen=True)
class Drawn:
    """The arrays of a scene as WAY/PASS, and the numbers of each way's report."""

    pixels: dict[str, np.ndarray]
    numbers: dict[str, dict[str, Any]]


def sized(camera: Any) -> Any:
    """The camera with pictures WIDTH pixels wide. The projection has no pixels in it, so it stays as it is."""
    width, height = camera.resolution
    scale = WIDTH / width
    region = camera.region and tuple(max(round(side * scale), i // 2) for i, side in enumerate(camera.region))
    return replace(camera, resolution=(WIDTH, max(round(height * scale), 1)), region=region)


def forget() -> None:
    """Clear all stores of prepared points: that of the scenes here, and that of Blender's host where it is loaded."""
    host = sys.modules.get("pointsplat_addon.host.shared_store")
    for store in (STORE, *((host.STORE,) if host else ())):
        store.clear()


def draw_way(renderer: Renderer, subject: Subject, way: Way) -> Result:
    """One picture, with nothing prepared and nothing on the device beforehand."""
    case = subject.case()
    camera = sized(case.camera)
    if way.aperture is not None:
        camera = replace(camera, aperture=way.aperture)
    case = replace(case, camera=camera, settings=replace(case.settings, **way.settings))
    request = replace(case.request(way.passes, way.samples), interactive=way.interactive)
    device, limits = renderer.device, renderer.device.limits
    forget()
    renderer.release()
    device.limits = replace(limits, image_atomics=limits.image_atomics and way.atomics)
    try:
        if way.kept:
            coarse = replace(case.settings, tolerance=4 * case.settings.tolerance)
            renderer.render(case.scene, replace(request, settings=coarse, samples=1))
        return renderer.render(case.scene, request)
    finally:
        device.limits = limits


def numbers(report: dict[str, Any]) -> dict[str, Any]:
    """What the report says of the picture, without times, bytes and reasons."""
    return {
        "technique": report["technique"]["name"],
        "points": report["points"],
        "triangles": report["triangles"],
        "lines": report["lines"],
        "passes": [entry["name"] for entry in report["passes"]],
        "skipped": [entry["name"] for entry in report["skipped"]],
        "warnings": report["warnings"],
    }


def draw_subject(renderer: Renderer, subject: Subject) -> Drawn:
    """All ways of a scene."""
    drawn = Drawn({}, {})
    for name, way in subject.ways.items():
        result = draw_way(renderer, subject, way)
        drawn.pixels.update({f"{name}/{key}": pixels for key, pixels in result.pixels.items()})
        drawn.numbers[name] = numbers(result.report)
    return drawn


def save(folder: Path, name: str, drawn: Drawn) -> None:
    """Write the files of a scene."""
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path.with_suffix(".npz"), **drawn.pixels)
    path.with_suffix(".json").write_text(json.dumps(drawn.numbers, indent=1) + "\n", encoding="utf-8")


def draw_all(folder: Path, names: Iterable[str], drawers: Callable[[str], Drawn]) -> int:
    """Draw and save scenes; how many failed."""
    failed = 0
    for name in names:
        before = time.process_time()
        try:
            drawn = drawers(name)
        except Exception:
            failed += 1
            say(f"{name} failed:\n{traceback.format_exc()}")
            continue
        save(folder, name, drawn)
        say(f"{name}: {len(drawn.numbers)} pictures, {time.process_time() - before:.1f} s")
    return failed


def say(text: str) -> None:
    """To the error stream: Blender writes on the other one."""
    print(text, file=sys.stderr, flush=True)


# Blender


def demo_script(key: str) -> Any:
    """One of the scripts that build scenes in Blender."""
    return importlib.import_module(DEMO_SCRIPTS[key])


@dataclass(frozen=True)
class Blend:
    """A scene that a script builds in Blender's open file, and what is chosen in it."""

    build: Callable[[Path], None]  # given a folder for volumes
    ways: dict[str, dict[str, Any]]  # values of scene.pointsplat; "every pass" asks for passes


BLEND_WAYS: dict[str, dict[str, Any]] = {
    "AUTO, every pass": {"technique": "AUTO", "every pass": True},
    **{technique: {"technique": technique} for technique in TECHNIQUES},
}


def build_demo(folder: Path) -> None:
    scene = demo_script("demo").build()
    for name in ("Spot", "Bear"):
        scene.objects[name].pointsplat.primitive = "POINTS"


def build_translucent(name: str, folder: Path) -> None:
    demo_script("translucent").build(name, folder / f"{name}.blend", VOXELS)


def build_lens(folder: Path) -> None:
    demo_script("lens").build()


def build_gallery(primitive: str, folder: Path) -> None:
    assets = ROOT / "assets" / "spot"
    gallery = demo_script("gallery")
    scene = gallery.studio(WIDTH)
    model = gallery.load(assets / "spot_triangulated.obj.gz", assets / "spot_texture.png")
    gallery.look_from(scene, np.array([0.5, -1.0, 0.45]) / np.linalg.norm([0.5, -1.0, 0.45]))
    model.pointsplat.primitive = primitive


def build_towers(folder: Path) -> None:
    demo_script("towers").build(2)


def build_media(smoke: str, folder: Path) -> None:
    demo_script("media").sphere_scene(folder, smoke, "inside", WIDTH, VOXELS)


TRANSLUCENT = (
    "glow", "cloud_light", "fountain", "opaque", "translucent_first", "opaque_first", "light_inside", "eye", "ct_head",
    "outdoor",
)  # fmt: skip
BLENDS: dict[str, Blend] = {
    "blends/demo": Blend(build_demo, BLEND_WAYS),
    **{f"blends/{name}": Blend(partial(build_translucent, name), BLEND_WAYS) for name in TRANSLUCENT},
    "blends/depth_of_field": Blend(
        build_lens,
        {
            **{f"{t}, {m}": {"technique": t, "dof_method": m} for t in SPLAT_TECHNIQUES for m in DOF_METHODS},
            "AUTO, SPLAT, every pass": {"technique": "AUTO", "dof_method": "SPLAT", "every pass": True},
        },
    ),
    "blends/gallery_points": Blend(partial(build_gallery, "POINTS"), BLEND_WAYS),
    "blends/gallery_polygons": Blend(partial(build_gallery, "POLYGONS"), {"AUTO": {"technique": "AUTO"}}),
    "blends/towers": Blend(build_towers, {t: {"technique": t} for t in TECHNIQUES}),
    "blends/smoke": Blend(partial(build_media, "scattering"), BLEND_WAYS),
}


def draw_blend(name: str, device: str) -> Drawn:
    """All ways of a scene of Blender's, by its own render operator. `device`: one of scene.pointsplat.device."""
    import bpy

    render = importlib.import_module(RENDER_SCRIPT)
    engine = render.engine_class()
    drawn, blend = Drawn({}, {}), BLENDS[name]
    with tempfile.TemporaryDirectory() as folder:
        bpy.ops.wm.read_factory_settings(use_empty=True)  # frees what the device keeps, too
        render.engine_class()
        blend.build(Path(folder))
        for mesh in bpy.data.meshes:
            if mesh.name.startswith("Sphere"):
                put_in_order(mesh)
        scene = bpy.context.scene
        set_up(scene, device)
        scene.render.filepath = str(Path(folder) / "picture.exr")
        for way, chosen in blend.ways.items():
            for key, value in chosen.items():
                if key != "every pass":
                    setattr(scene.pointsplat, key, value)
            for render_pass in PASSES:
                if render_pass.switch:
                    setattr(scene.view_layers[0], render_pass.switch, "every pass" in chosen)
            forget()
            bpy.ops.render.render(write_still=True)
            read = getattr(importlib.import_module(EXR_MODULE), EXR_READER)
            layers = read(Path(scene.render.filepath))
            drawn.pixels.update({f"{way}/{key.rpartition('.')[2]}": pixels for key, pixels in layers.items()})
            report = dict(sys.modules[engine.__module__].last_report)
            is_blenders = report["device"].lower().startswith("blender")
            if is_blenders != (device == "BLENDER_GPU"):
                raise RuntimeError(f"{report['device']} drew instead of {device}")
            drawn.numbers[way] = numbers(report)
    return drawn


def put_in_order(mesh: Any) -> None:
    """Sort the faces of a mesh and let each begin with its first vertex: Blender's operator for spheres makes the same
    faces in another order each time, and sums over the faces of a vertex, such as its normal, are rounded otherwise."""
    [layer] = mesh.uv_layers
    uv = np.empty((len(mesh.loops), 2), np.float32)
    layer.data.foreach_get("uv", uv.reshape(-1))
    faces = []
    for polygon in mesh.polygons:
        vertices, loops = list(polygon.vertices), list(polygon.loop_indices)
        first = vertices.index(min(vertices))
        faces.append((vertices[first:] + vertices[:first], loops[first:] + loops[:first]))
    faces.sort()
    is_smooth, positions = mesh.polygons[0].use_smooth, [tuple(vertex.co) for vertex in mesh.vertices]
    mesh.clear_geometry()
    mesh.from_pydata(positions, [], [vertices for vertices, _ in faces])
    made = mesh.uv_layers.new(name="UVMap")
    made.data.foreach_set("uv", uv[np.concatenate([loops for _, loops in faces])].reshape(-1))
    _ = mesh.shade_smooth() if is_smooth else mesh.shade_flat()
    mesh.update()


def set_up(scene: Any, device: str) -> None:
    """The size and the format of pictures, with all passes in one file of floats."""
    width, height = scene.render.resolution_x, scene.render.resolution_y
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, round(WIDTH * height / width)
    scene.render.resolution_percentage = 100
    scene.render.engine, scene.render.use_file_extension = "POINTSPLAT", False
    image = scene.render.image_settings
    if hasattr(image, "media_type"):  # since Blender 5.0 the format's kind comes first
        image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "32", "NONE"
    scene.pointsplat.samples, scene.pointsplat.device, scene.pointsplat.budget = SAMPLES, device, "NONE"
    scene.pointsplat.use_indirect = False  # unless a way has it


def draw_on_blenders_gpu(folder: Path, names: list[str]) -> int:
    """Scenes of the group gpu, each named as the one that it repeats; how many failed."""
    import bpy  # noqa: F401 - gpu is there once Blender is
    import gpu

    gpu.init()
    renderer = Renderer(importlib.import_module(DEVICE_MODULE).BlenderDevice())
    renderer.costs = drawing.CHEAP_POINTS
    repeated = {gpu_name(name): name for name in ON_BLENDERS_GPU}

    def draw(name: str) -> Drawn:
        if repeated[name] in BLENDS:
            return draw_blend(repeated[name], "BLENDER_GPU")
        return draw_subject(renderer, subjects()[repeated[name]])

    return draw_all(folder, names, draw)


def gpu_name(name: str) -> str:
    return "gpu/" + name.replace("/", "_")


# Commands


def all_names() -> list[str]:
    """Every scene of every group."""
    return [*subjects(), *BLENDS, *map(gpu_name, ON_BLENDERS_GPU)]


def chosen_names(arguments: argparse.Namespace) -> list[str]:
    """The scenes that the arguments ask for. SystemExit: there is none of a name."""
    names = all_names()
    if not arguments.devices:
        names = [name for name in names if not name.startswith("gpu/")]
    if arguments.quick:
        names = [name for name in names if name in QUICK]
    if arguments.only:
        for pattern in arguments.only:
            if not any(matches(name, pattern) for name in names):
                raise SystemExit(f"pictures: no scene is named {pattern}; the command list names them")
        names = [name for name in names if any(matches(name, pattern) for pattern in arguments.only)]
    return names


def matches(name: str, pattern: str) -> bool:
    return fnmatch.fnmatchcase(name, pattern) or fnmatch.fnmatchcase(name.partition("/")[2], pattern)


def draw(arguments: argparse.Namespace) -> int:
    """Draw the scenes here, and those that need Blender in processes of their own. 1: some could not be drawn."""
    names, folder = chosen_names(arguments), arguments.folder.resolve()
    if arguments.group:  # this is one of those processes
        here = [name for name in names if name.startswith(f"{arguments.group}/")]
        if arguments.group == "gpu":
            return int(draw_on_blenders_gpu(folder, here) > 0)
        return int(draw_all(folder, here, partial(draw_blend, device="OPENGL")) > 0)

    for name in names:
        for suffix in (".npz", ".json"):
            (folder / name).with_suffix(suffix).unlink(missing_ok=True)
    folder.mkdir(parents=True, exist_ok=True)
    here = [name for name in names if name in subjects()]
    renderer = drawing.opengl()
    failed = draw_all(folder, here, lambda name: draw_subject(renderer, subjects()[name]))
    forget()
    pythons = {"blends": Path(sys.executable), "gpu": arguments.gpu_python}
    used = {}
    for group, python in pythons.items():
        if any(name.startswith(f"{group}/") for name in names):
            failed += draw_elsewhere(python, folder, group, names)
            used[group] = said_by(python)
    about = {
        "commit": subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True).stdout.strip(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "device": renderer.device.limits.renderer,
        "groups": used,
        "without": os.environ["NPY_DISABLE_CPU_FEATURES"],
    }
    (folder / "about.json").write_text(json.dumps(about, indent=1) + "\n", encoding="utf-8")
    times = os.times()
    say(f"{len(names)} scenes, {times.user + times.system:.0f} s of processor time here and "
        f"{times.children_user + times.children_system:.0f} s in Blender; {failed} failed")  # fmt: skip
    return int(failed > 0)


def draw_elsewhere(python: Path, folder: Path, group: str, names: list[str]) -> int:
    """Draw a group in a process of its own; 1 where that failed."""
    wanted = [name for name in names if name.startswith(f"{group}/")]
    command = [
        str(python),
        "-m",
        "tests.support.pictures",
        "draw",
        str(folder.resolve()),
        "--devices",
        "--group",
        group,
    ]
    return int(subprocess.run([*command, "--only", *wanted], stdout=subprocess.DEVNULL, cwd=ROOT).returncode != 0)


def said_by(python: Path) -> str:
    """The version of a Python."""
    return subprocess.run([str(python), "--version"], capture_output=True, text=True).stdout.strip()


@dataclass
class Comparison:
    """What was found between two folders."""

    equal: int = 0  # pictures
    different: list[tuple[float, str]] = field(default_factory=list)  # largest difference, and what is said of it
    missing: list[str] = field(default_factory=list)  # pictures of scenes that both folders have
    numbers: list[str] = field(default_factory=list)
    words: list[str] = field(default_factory=list)  # names of passes and warnings: told, but no error

    @property
    def is_equal(self) -> bool:
        return self.equal > 0 and not (self.different or self.missing or self.numbers)


def scene_files(folder: Path) -> dict[str, Path]:
    """The .npz file of each scene."""
    return {str(path.relative_to(folder).with_suffix("")): path for path in sorted(folder.glob("*/*.npz"))}


def difference(a: np.ndarray, b: np.ndarray) -> tuple[float, str]:
    """The largest difference of two arrays, and what is said of it; NaN where they cannot be subtracted."""
    if a.shape != b.shape or a.dtype != b.dtype:
        return np.inf, f"{a.dtype} {a.shape} against {b.dtype} {b.shape}"
    off = a.view(f"u{a.itemsize}") != b.view(f"u{a.itemsize}")
    pixels = off.any(axis=-1)
    with np.errstate(all="ignore"):
        apart = np.abs(a.astype(np.float64) - b.astype(np.float64))
    finite = apart[np.isfinite(apart)]
    largest = float(finite.max(initial=0))
    said = f"max {largest:.3g}, RMSE {np.sqrt(np.mean(finite**2)) if finite.size else 0:.3g}, "
    said += f"{np.count_nonzero(pixels):,} of {pixels.size:,} pixels"
    strange = np.count_nonzero(off & ~np.isfinite(apart))
    return largest, said + (f", {strange:,} values not finite" if strange else "")


def compare_scene(name: str, a: Path, b: Path, found: Comparison) -> None:
    """Add what there is between the pictures of one scene."""
    with np.load(a) as here, np.load(b) as there:
        ways = list(dict.fromkeys(key.rpartition("/")[0] for key in (*here.files, *there.files)))
        for way in ways:
            keys = sorted({k for k in (*here.files, *there.files) if k.rpartition("/")[0] == way})
            for file, side in ((here, a), (there, b)):
                lost = [key.rpartition("/")[2] for key in keys if key not in file.files]
                if lost:
                    found.missing.append(f"{name}, {way}: {side} lacks {', '.join(lost)}")
            differences = []
            for key in keys:
                if key in here.files and key in there.files:
                    one, other = here[key], there[key]
                    if one.shape != other.shape or one.dtype != other.dtype or one.tobytes() != other.tobytes():
                        differences.append((key.rpartition("/")[2], *difference(one, other)))
            for key, largest, said in differences:
                found.different.append((largest, f"{name}, {way}: {key}: {said}"))
            found.equal += not differences and all(key in here.files and key in there.files for key in keys)
    one, other = (json.loads(path.with_suffix(".json").read_text(encoding="utf-8")) for path in (a, b))
    for way in one.keys() & other.keys():
        for key in one[way].keys() | other[way].keys():
            before, after = one[way].get(key), other[way].get(key)
            if isinstance(before, list) and isinstance(after, list):  # of names, whose order does not matter
                lost, new = sorted(set(before) - set(after)), sorted(set(after) - set(before))
                if lost or new:
                    found.words.append(f"{name}, {way}: {key}: no more {lost}, but {new}")
            elif before != after:
                found.numbers.append(f"{name}, {way}: {key}: {before} against {after}")


def compare(arguments: argparse.Namespace) -> int:
    """Print what differs. 1: something does."""
    a, b = arguments.a, arguments.b
    here, there = scene_files(a), scene_files(b)
    found = Comparison()
    for name in here:
        if name in there:
            compare_scene(name, here[name], there[name], found)

    def show(title: str, lines: list[str]) -> None:
        if lines:
            print(f"{title}: {len(lines)}")
            for line in lines[: arguments.most]:
                print(f"  {line}")
            if len(lines) > arguments.most:
                print(f"  ... {len(lines) - arguments.most} more: see --most")

    about = [json.loads(f.read_text()) if (f := side / "about.json").is_file() else {} for side in (a, b)]
    for side in about:
        side.update(side.pop("groups", {}))
    for key in (about[0].keys() & about[1].keys()) - {"commit"}:
        if about[0][key] != about[1][key]:
            print(f"note: drawn otherwise: {key}: {about[0][key]} against {about[1][key]}")
    ordered = sorted(found.different, key=lambda item: -item[0])
    show("arrays that differ, largest difference first", [said for _, said in ordered])
    show("numbers of reports that differ", sorted(found.numbers))
    show("pictures that are missing", found.missing)
    show("only told: passes and warnings of reports", sorted(found.words))
    for side, names in ((b, here.keys() - there.keys()), (a, there.keys() - here.keys())):
        if names:
            groups = sorted({name.partition("/")[0] for name in names})
            print(f"scenes that {side} lacks: {len(names)}, of {', '.join(groups)}")
    different, both = len({said.split(": ")[0] for _, said in found.different}), len(here.keys() & there.keys())
    print(f"{found.equal} pictures of {both} scenes are equal to the bit, {different} differ")
    return int(not found.is_equal)


def show_list(arguments: argparse.Namespace) -> int:
    """Name all scenes with their ways."""
    known: dict[str, Any] = {**subjects(), **BLENDS}
    known |= {gpu_name(name): known[name] for name in ON_BLENDERS_GPU}
    for name, subject in known.items():
        print(f"{name}: {'; '.join(subject.ways)}")
    print(f"{len(known)} scenes, {sum(len(subject.ways) for subject in known.values())} pictures")
    return 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    drawing = commands.add_parser("draw", help="draw scenes into a folder")
    drawing.add_argument("folder", type=Path, metavar="DIR")
    drawing.add_argument("--only", nargs="+", metavar="NAME", help="names or patterns of scenes")
    drawing.add_argument("--quick", action="store_true", help="a dozen scenes")
    drawing.add_argument("--devices", action="store_true", help="some scenes on Blender's gpu module, too")
    drawing.add_argument("--gpu-python", type=Path, default=ROOT / ".venv" / "py313" / "bin" / "python",
                         help="the Python whose Blender does that (default: %(default)s)")  # fmt: skip
    drawing.add_argument("--group", help=argparse.SUPPRESS)
    drawing.set_defaults(run=draw)
    comparing = commands.add_parser("compare", help="compare two folders bit by bit")
    comparing.add_argument("a", type=Path, metavar="A")
    comparing.add_argument("b", type=Path, metavar="B")
    comparing.add_argument("--most", type=int, default=40, help="lines of each kind (default: %(default)s)")
    comparing.set_defaults(run=compare)
    commands.add_parser("list", help="name all scenes").set_defaults(run=show_list)
    arguments = parser.parse_args()
    return arguments.run(arguments)


def leave(status: int) -> None:
    """End without the interpreter's own shutdown where Blender is loaded: it does not come back from it."""
    sys.stdout.flush()
    sys.stderr.flush()
    if "bpy" in sys.modules:
        os._exit(status)
    sys.exit(status)


if __name__ == "__main__":
    try:
        code = main()
    except Exception:
        traceback.print_exc()
        code = 1
    leave(code)
