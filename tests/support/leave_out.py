"""What scenes cost on the device, feature by feature: the rows of docs/notes/leave_out.md, and what is written there.

    python tests/support/leave_out.py [--write-docs]

Every row is drawn on the device that only records (devices/null.py).
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from scripts.scenes import (
    build,
    cameras,
    clouds,
    detailed_cases,
    drawing,
    lit_cases,
    meshes,
    solid_cases,
    translucent_cases,
)
from scripts.scenes.case import ALL_PASSES

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent))

from pointsplat_addon.core.material import expressions as ex
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.scene.camera import Aperture
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import HairTable
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from pointsplat_addon.shading import sources
from pointsplat_addon.shading.interface import Interface
from scripts.scenes.case import Case
from scripts.scenes.store import STORE

COMBINED = frozenset({"combined"})


@dataclass(frozen=True, eq=False)
class Row:
    """A scene with one thing more, or less, than another row."""

    case: Callable[[], Case]
    passes: frozenset[str] = COMBINED
    samples: int = 1
    interactive: bool = False


@dataclass(frozen=True, eq=False)
class Found:
    """What a picture took."""

    device: NullDevice
    ran: tuple[str, ...]  # passes, in order of first run
    skipped: dict[str, str]  # the others, and why
    bytes: int  # on the device while it was drawn
    report: dict


def _lit(case: Case, **more) -> Case:
    """The case with parts of its scene replaced."""
    return replace(case, scene=replace(case.scene, **more))


def _by(case: Case, **more) -> Case:
    """The case with other settings."""
    return replace(case, settings=replace(case.settings, **more))


def _alone(case: Case, kind: Callable) -> Case:
    """Only the geometries that `kind` is true of, each once."""
    of, at = case.scene.instances.geometry, case.scene.instances.world_from_object
    things = [(g, at[np.flatnonzero(of == i)[0]]) for i, g in enumerate(case.scene.geometries) if kind(g)]
    only = build.scene(*things, lights=case.scene.lights, world=case.scene.world, table=case.scene.materials)
    return replace(case, scene=only)


def _of(cloud: PointCloud, key: str, **more) -> Case:
    return Case(build.scene((build.points(key, cloud), build.moved()), **more), cameras.camera())


def _world_only() -> Case:
    return Case(build.scene(lights=(), world=World(np.array([0.2, 0.3, 0.4]))), cameras.camera())


def _picture_only() -> Case:
    image = np.ones((4, 8, 3), np.float32)
    return Case(build.scene(lights=(), world=World(np.zeros(3), image)), cameras.camera())


def _dense_mesh() -> Case:
    return Case(build.scene((build.mesh(meshes.sphere_mesh("leave out: dense", 96)), build.moved())),
                cameras.camera(resolution=(32, 32)))  # fmt: skip


def _painted_picture(primitive: str) -> Case:
    """A plane with a picture on it: only its colours vary."""
    graph = MaterialGraph(base_color=ex.Color(ex.ImageTexture(ex.UV(), build.picture())))
    plane = build.mesh(meshes.plane_mesh(f"leave out: picture, {primitive}", cells=16), primitive)
    return Case(build.scene((plane, build.moved()), table=build.materials(graphs=(graph,))), cameras.camera())


def _corner_colors() -> Case:
    """A cube whose colours do not repeat over its maps: from where its corners lie."""
    graph = MaterialGraph(base_color=ex.Color(ex.Coordinates("position")))
    block = build.mesh(meshes.cube_mesh("leave out: corners"), "POLYGONS")
    return Case(build.scene((block, build.moved()), table=build.materials(graphs=(graph,))), cameras.camera())


def _rough_picture(primitive: str) -> Case:
    """The same, but only its roughness varies."""
    red = ex.Gray(ex.ImageTexture(ex.UV(), build.picture()))
    plane = build.mesh(meshes.plane_mesh(f"leave out: rough, {primitive}", cells=16), primitive)
    graph = MaterialGraph(roughness=red)
    return Case(build.scene((plane, build.moved()), table=build.materials(graphs=(graph,))), cameras.camera())


def _glow() -> Case:
    """Points that only glow, under a lamp that they do not reflect."""
    cloud = clouds.sphere_cloud(emission=np.abs(clouds.sphere_points()).astype(np.float32))
    table = build.materials(base_color=np.zeros((1, 3)), specular=[0.0])
    case = _of(cloud, "leave out: glow", table=table)
    return _by(case, use_shadows=True, shadow_resolution=64)


def _panes(**more) -> Case:
    """One pane of clear glass, and nothing else."""
    table = build.materials(alpha=[0.5], translucent=np.array([True]), **more)
    pane = replace(meshes.plane_mesh("leave out: pane", 0.7), materials=(0,))
    return Case(build.scene((build.mesh(pane), build.moved()), table=table), cameras.camera())


def _two_smokes() -> Case:
    """Two instances of one cloud of smoke: none of them knows alone what light reaches it."""
    cloud = build.points("leave out: two smokes", clouds.smoke_cloud(8))
    case = Case(build.scene(*((cloud, build.moved((x, 0, 0))) for x in (-0.5, 0.5))), cameras.camera())
    return _by(case, use_shadows=True, shadow_resolution=64)


def _held_smoke() -> Case:
    """Smoke, of which another ball of smoke cuts a hole."""
    cloud = build.points("leave out: held smoke", clouds.smoke_cloud(8))
    things = ((cloud, build.moved()), (cloud, build.moved((0.5, -0.5, 0), 0.4)))
    return Case(build.scene(*things, holdout=(False, True)), cameras.camera())


def _mixed_materials() -> Case:
    """A plain cube, a metal one and one that glows."""
    table = build.materials(3, metallic=[0, 1, 0], emission=[[0, 0, 0], [0, 0, 0], [1, 2, 3]])
    things = []
    for row in range(3):
        block = replace(meshes.cube_mesh(f"leave out: material {row}", 0.4), materials=(row,),
                        material=np.full(12, row, np.uint16))  # fmt: skip
        things.append((build.mesh(block, "POLYGONS"), build.moved((row - 1.0, 0, 0))))
    return Case(build.scene(*things, table=table), cameras.camera())


def _many() -> Case:
    cloud = build.points("leave out: many", clouds.sphere_cloud(100))
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-1, 1, 6), np.linspace(-1, 1, 6)))
    return Case(build.scene(*((cloud, build.moved((a, 0, b), 0.1)) for a, b in zip(x, z, strict=True))),
                cameras.camera())  # fmt: skip


def _tube() -> Case:
    turn = np.linspace(0, 6, 20)
    way = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    return Case(build.scene((build.strand_lines("leave out: tube", [way], 0.2), build.moved())), cameras.camera())


def _ribbon() -> Case:
    u = np.linspace(-1.3, 1.3, 30)
    normal = np.stack([0 * u, np.cos(3 * u), np.sin(3 * u)], axis=1).astype(np.float32)
    lines = build.strand_lines("leave out: ribbon", [np.stack([u, 0 * u, 0 * u], axis=1)], 0.12, normal=normal)
    return Case(build.scene((lines, build.moved())), cameras.camera())


def _hair() -> Case:
    """Strands thinner than a pixel, of the Principled Hair BSDF."""
    table = build.materials()
    one = np.ones(1, np.float32)
    fibre = HairTable(np.array([True]), 0.3 * one, 0 * one, 0.03 * one, np.ones((1, 3), np.float32))
    case = _alone(detailed_cases.strands(), lambda g: g.name == "hair")
    return _lit(case, materials=replace(table, hair=fibre))


def _small_balls() -> Case:
    cloud = PointCloud(clouds.sphere_points().astype(np.float32), radii=np.full((400, 1), 0.02, np.float32))
    return _of(cloud, "leave out: small balls")


def _lamp(case: Case, radius: float) -> Case:
    lamp = Light("POINT", np.full(3, 20.0), np.array([1.0, -3, 2]), np.array([0.0, 0, -1]), radius)
    return _by(_lit(case, lights=(lamp,)), use_shadows=True, shadow_resolution=64)


def _normals() -> Case:
    """Points that are shaded by normals other than their own, once lit and once not."""
    return _of(clouds.sphere_cloud(shading_normal=clouds.sphere_points().astype(np.float32)), "leave out: bent")


def _aside(case: Case) -> Case:
    """The same from where nothing of it is in view."""
    return replace(case, camera=cameras.camera((0, -8, 0), (0, -16, 0)))


def _lamps(*lamps: Light) -> Case:
    """Points beneath a sun and further lamps, all with shadows."""
    return _by(_lit(solid_cases.plain_sphere(), lights=(build.sun(), *lamps)), use_shadows=True, shadow_resolution=64)


def _far_lamp() -> Light:
    return Light("POINT", np.full(3, 20.0), np.array([0.0, -3e4, 0]), np.array([0.0, 1, 0]), 0.3)


def _through_a_lens(method: str) -> Case:
    case = solid_cases.mixed()
    return _by(replace(case, camera=replace(case.camera, aperture=Aperture(0.3, 3.0))), dof_method=method)


def _before_a_picture() -> Case:
    """Points in focus before a picture of the world that is not."""
    case = lit_cases.environment()
    return replace(case, camera=replace(case.camera, aperture=Aperture(0.02, 4.0)))


def _clear_smoke() -> Case:
    """Smoke without density before a sphere."""
    clear, ball = clouds.smoke_cloud(8, 0.0), build.points("leave out: behind", clouds.sphere_cloud())
    return Case(build.scene((build.points("leave out: clear", clear), build.moved((0, -2, 0))),
                             (ball, build.moved())), cameras.camera((0, -6, 0)))  # fmt: skip


def _dark(case: Case) -> Case:
    return _lit(case, lights=(), world=World())


ROWS: dict[str, Row] = {
    "nothing": Row(solid_cases.empty),
    "world of one colour": Row(_world_only),
    "environment picture": Row(_picture_only),
    "environment picture, 16 samples": Row(_picture_only, samples=16),
    "environment picture, transparent film": Row(lambda: _lit(_picture_only(), transparent=True)),
    "one cube": Row(solid_cases.cube),
    "one cube, unlit": Row(lambda: _dark(solid_cases.cube())),
    "one cube, shadows": Row(lambda: _by(solid_cases.cube(), use_shadows=True, shadow_resolution=64)),
    "one cube, shadows of a wide lamp": Row(lambda: _lamp(solid_cases.cube(), 0.3)),
    "one cube, transparent film": Row(lambda: _lit(solid_cases.cube(), transparent=True)),
    "dense mesh": Row(_dense_mesh),
    "mesh of points and polygons": Row(detailed_cases.split_mesh),
    "polygons, colours from a picture": Row(lambda: _painted_picture("POLYGONS")),
    "points, colours from a picture": Row(lambda: _painted_picture("POINTS")),
    "polygons, roughness from a picture": Row(lambda: _rough_picture("POLYGONS")),
    "points, roughness from a picture": Row(lambda: _rough_picture("POINTS")),
    "polygons, colours from a picture, depth": Row(lambda: _painted_picture("POLYGONS"), COMBINED | {"depth"}),
    "polygons, colours at corners": Row(_corner_colors),
    "polygons, colours at corners, depth": Row(_corner_colors, COMBINED | {"depth"}),
    "points": Row(solid_cases.plain_sphere),
    "points, unlit": Row(lambda: _dark(solid_cases.plain_sphere())),
    "points, colours": Row(solid_cases.sphere),
    "points, shading normals": Row(_normals),
    "points, shading normals, unlit": Row(lambda: _dark(_normals())),
    "points, shadows of a sun": Row(lambda: _by(solid_cases.plain_sphere(), use_shadows=True, shadow_resolution=64)),
    "points, shadows of a wide lamp": Row(lambda: _lamp(solid_cases.plain_sphere(), 0.3)),
    "points that only glow": Row(_glow),
    "points and polygons, backs culled": Row(solid_cases.culled),
    "leaves": Row(detailed_cases.foliage),
    "small balls": Row(_small_balls),
    "wide balls": Row(solid_cases.wide_balls),
    "many instances": Row(_many),
    "many instances that share levels": Row(detailed_cases.many_towers),
    "points and polygons": Row(solid_cases.mixed),
    "points and polygons, unlit": Row(solid_cases.unlit),
    "points and polygons, border": Row(solid_cases.region),
    "points and polygons, parallel camera": Row(solid_cases.parallel),
    "points and polygons, interactive": Row(solid_cases.mixed, interactive=True),
    "points and polygons, adaptive": Row(solid_cases.mixed, samples=16),
    "emission of points and polygons": Row(lit_cases.emission),
    "mixed materials": Row(_mixed_materials),
    "holdouts": Row(solid_cases.holdout),
    "every kind of lamp": Row(lit_cases.lights),
    "points in an environment picture": Row(lit_cases.environment),
    "pane": Row(_panes),
    "panes and a cube": Row(translucent_cases.panes),
    "smoke": Row(translucent_cases.in_smoke),
    "smoke, transparent film": Row(lambda: _lit(translucent_cases.in_smoke(), transparent=True)),
    "smoke, interactive": Row(translucent_cases.in_smoke, interactive=True),
    "smoke twice, shadows": Row(_two_smokes),
    "smoke among points and polygons, shadows": Row(translucent_cases.smoke),
    "coloured smoke, shadows": Row(translucent_cases.tinted_smoke),
    "smoke that is held out": Row(_held_smoke),
    "tube": Row(_tube),
    "ribbon": Row(_ribbon),
    "hair, shadows": Row(_hair, samples=8),
    "strands and a cube, shadows": Row(detailed_cases.strands, samples=4),
    "EWA": Row(lambda: _by(solid_cases.sphere(), technique="EWA")),
    "EWA, adaptive": Row(lambda: _by(solid_cases.sphere(), technique="EWA"), samples=16),
    "EWA among polygons": Row(lambda: _by(solid_cases.mixed(), technique="EWA")),
    "painter": Row(lambda: _by(solid_cases.sphere(), technique="PAINTER")),
    "painter among polygons": Row(lambda: _by(solid_cases.mixed(), technique="PAINTER")),
    "painter among polygons, normal and depth": Row(
        lambda: _by(solid_cases.mixed(), technique="PAINTER"), COMBINED | {"normal", "depth"}
    ),
    "points, depth and position": Row(solid_cases.plain_sphere, COMBINED | {"depth", "position"}),
    "points, normal and colour": Row(solid_cases.plain_sphere, COMBINED | {"normal", "albedo"}),
    "points, mist": Row(solid_cases.plain_sphere, COMBINED | {"mist"}),
    "points, mist, transparent film": Row(
        lambda: _lit(solid_cases.plain_sphere(), transparent=True), COMBINED | {"mist"}
    ),
    "points, indices": Row(solid_cases.plain_sphere, COMBINED | {"object_index", "material_index"}),
    "points, Cryptomatte": Row(solid_cases.plain_sphere, COMBINED | {"crypto_object"}, samples=4),
    "points and polygons, motion": Row(solid_cases.moving, COMBINED | {"vector"}),
    "smoke, depth and motion": Row(translucent_cases.in_smoke, COMBINED | {"depth", "vector"}),
    "a lamp that is off": Row(lambda: _lamps(replace(_far_lamp(), color=np.zeros(3)))),
    "a lamp too far to matter": Row(lambda: _lamps(_far_lamp())),
    "a world too dark to matter": Row(lambda: _lit(solid_cases.plain_sphere(), world=World(np.full(3, 1e-5)))),
    "a black environment picture": Row(
        lambda: _lit(solid_cases.plain_sphere(), world=World(np.zeros(3), np.zeros((4, 8, 3), np.float32)))
    ),
    "an emission too weak to matter": Row(
        lambda: _lit(solid_cases.plain_sphere(), materials=build.materials(emission=np.full((1, 3), 1e-4)))
    ),
    "points and polygons out of view": Row(lambda: _aside(solid_cases.mixed())),
    "smoke out of view": Row(lambda: _aside(_two_smokes())),
    "smoke without density": Row(_clear_smoke),
    "points and polygons, out of focus": Row(lambda: _through_a_lens("SPLAT"), samples=4),
    "points and polygons, out of focus, depth": Row(lambda: _through_a_lens("SPLAT"), COMBINED | {"depth"}, samples=4),
    "points and polygons, samples of the lens": Row(lambda: _through_a_lens("LENS_SAMPLES"), samples=4),
    "environment picture, out of focus": Row(
        lambda: replace(_picture_only(), camera=replace(cameras.camera(), aperture=Aperture(0.3, 3.0))), samples=4
    ),
    "points in focus in an environment picture": Row(_before_a_picture, samples=4),
    "nothing, every pass": Row(solid_cases.empty, ALL_PASSES),
    "points and polygons, every pass": Row(solid_cases.mixed, ALL_PASSES),
}  # fmt: skip


def draw(row: Row, device: NullDevice | None = None) -> Found:
    """The row's picture, recorded, with nothing kept from others."""
    STORE.clear()
    device = device or NullDevice()
    case = row.case()
    request = Request(case.camera, case.settings, row.passes, row.samples, interactive=row.interactive)
    renderer = Renderer(device, STORE)
    renderer.costs = drawing.FREE_POINTS
    report = renderer.render(case.scene, request).report
    size = device.peak_bytes
    renderer.release()
    ran = tuple(entry["name"] for entry in report["passes"])
    return Found(device, ran, {entry["name"]: entry["because"] for entry in report["skipped"]}, size, report)


@cache
def found(name: str) -> Found:
    """The picture of ROWS[name]; drawn once in a process."""
    return draw(ROWS[name])


# What shaders use


DIRECTIVE = re.compile(r"^\s*#\s*(ifdef|ifndef|if|elif|else|endif|define|undef)\b\s*(.*?)\s*(?://.*)?$")
WORD = re.compile(r"\w+")


def active(text: str, defines: dict[str, str]) -> str:
    """GLSL without comments and without what its conditionals leave out."""
    names, kept = dict(defines), []
    open_: list[tuple[bool, bool]] = []  # of each conditional: this branch is taken, some branch has been
    for line in text.splitlines():
        found = DIRECTIVE.match(line)
        on = all(taken for taken, _ in open_)
        if not found:
            if on:
                kept.append(line.split("//")[0])
            continue
        kind, rest = found.groups()
        if kind in ("ifdef", "ifndef", "if"):
            true = (rest.split()[0] in names) == (kind == "ifdef") if kind != "if" else _true(rest, names)
            open_.append((true, true))
        elif kind in ("elif", "else"):
            _, before = open_.pop()
            true = not before and (kind == "else" or _true(rest, names))
            open_.append((true, before or true))
        elif kind == "endif":
            open_.pop()
        elif on and kind == "define":
            name, _, value = rest.partition(" ")
            names[name] = value
            kept.append(value)
        elif on:
            names.pop(rest, None)
    return "\n".join(kept)


def _true(condition: str, names: dict[str, str]) -> bool:
    text = re.sub(r"defined\s*\(?\s*(\w+)\s*\)?", lambda m: str(int(m[1] in names)), condition)
    text = re.sub(r"[A-Za-z_]\w*", lambda m: names.get(m[0]) or "0", text)
    return bool(eval(text.replace("&&", " and ").replace("||", " or ").replace("!", " not ")))


def stages(interface: Interface) -> list[str]:
    """The texts of a program, with their includes."""
    files = (interface.compute,) if interface.compute else (interface.vertex, interface.fragment)
    return [sources.load(file).text for file in files]


def words(interface: Interface) -> set[str]:
    """All words of the code that a program compiles."""
    return {word for text in stages(interface) for word in WORD.findall(active(text, dict(interface.defines)))}


def idle_defines(interface: Interface) -> set[str]:
    """Names that a program is told and that change nothing in it."""
    idle = set()
    for name, value in interface.defines:
        rest = {n: v for n, v in interface.defines if n != name}
        texts = [active(text, rest | {name: value}) for text in stages(interface)]
        same = texts == [active(text, rest) for text in stages(interface)]
        if same and not any(name in WORD.findall(text) for text in texts):
            idle.add(name)
    return idle


def read(device: NullDevice) -> set[int]:
    """Ids of the textures that shaders or the host read."""
    ids = set(device.seen)
    for call in device.calls:
        ids |= {id(call.textures[name]) for _, name in call.interface.samplers}
        ids |= {id(image) for image in call.images.values()}
    return ids


def written(device: NullDevice) -> set[int]:
    """Ids of the textures that shaders write."""
    ids = {id(image) for call in device.calls for image in call.images.values()}
    return ids | {id(texture) for call in device.calls if call.target for texture in call.target.colors}


# docs/notes/leave_out.md


DOCS = Path(__file__).resolve().parent.parent.parent / "docs" / "notes" / "leave_out.md"
BEGIN, END = "<!-- tables: tests/support/leave_out.py -->", "<!-- end of tables -->"


def _plain(name: str) -> str:
    return re.sub("^(ps|out|PS)_", "", name).replace("_", " ")


def _counted(names: list[str]) -> str:
    return ", ".join(name if n == 1 else f"{n} × {name}" for name, n in sorted(Counter(names).items()))


def drawn_textures(device: NullDevice) -> str:
    """Formats and numbers of the textures that shaders write, by what they hold."""
    names: dict[int, str] = {}
    for call in device.calls:
        if call.target is not None:
            for (_, output), texture in zip(call.interface.outputs, call.target.colors, strict=True):
                names.setdefault(id(texture), _plain(output))
        for image, texture in call.images.items():
            names.setdefault(id(texture), _plain(image))
    drawn = [f"{names[id(t)]} {t.format}" for t in device.textures if id(t) in names]
    return _counted([*drawn, *(["depth buffer"] * sum(target.depth for target in device.targets))])


def uploaded_textures(device: NullDevice) -> str:
    """Formats and numbers of the textures that are sent, by the names by which shaders read them."""
    names: dict[int, str] = {}
    for call in device.calls:
        for _, sampler in call.interface.samplers:
            names.setdefault(id(call.textures[sampler]), _plain(sampler))
    return _counted([f"{names[id(t)]} {t.format}" for t in device.textures if t.uploaded and id(t) in names])


def programs(device: NullDevice) -> str:
    """The programs that are compiled, with their variants."""
    said = []
    for interface in device.interfaces:
        kept = [f"{_plain(name).lower()}{'' if value == '1' else ' ' + value}" for name, value in interface.defines]
        said.append(f"{interface.name} ({', '.join(kept)})" if kept else interface.name)
    return "; ".join(said)


def tables() -> str:
    """All rows, as Markdown."""
    kinds = {
        "Passes": ("passes that run", lambda found: ", ".join(found.ran)),
        "Textures that are drawn into": ("textures", lambda found: drawn_textures(found.device)),
        "Tables and attributes that are sent": ("textures", lambda found: uploaded_textures(found.device)),
        "Programs": (
            "programs, and how they are told apart",
            lambda found: f"{len(found.device.interfaces)}: {programs(found.device)}",
        ),
    }
    text = [BEGIN, ""]
    for title, (head, of) in kinds.items():
        text += [f"## {title}", "", f"| scene | {head} |", "|---|---|"]
        text += [f"| {name} | {of(found(name))} |".replace("  |", " |") for name in ROWS]
        text.append("")
    return "\n".join([*text, END])


def with_tables(text: str) -> str:
    """The page with its tables as they are now."""
    return text[: text.index(BEGIN)] + tables() + text[text.index(END) + len(END) :]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write-docs", action="store_true", help="replace the tables in docs/notes/leave_out.md")
    if parser.parse_args().write_docs:
        DOCS.write_text(with_tables(DOCS.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        sys.stdout.write(tables() + "\n")


if __name__ == "__main__":
    main()
