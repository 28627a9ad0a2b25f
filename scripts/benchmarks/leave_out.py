"""What the empty, the opaque, the translucent and the full scene take: programs, bytes on the GPU and time.

    python -m scripts.benchmarks.leave_out [--quick]

The scenes take turns in one process; software renderers work on the process's own threads, so that its processor time
is what drawing cost, whatever else the machine does.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.hierarchy import row
from scripts.scenes import build, cameras, case, clouds, meshes, solid_cases

SIZE, TIMES = 512, 5
POINTS, CELLS = 100_000, 40  # of each sphere of points; voxels along a side of the smoke
SETTINGS = Settings(technique="IMAGE_SPACE", use_adaptive_sampling=False, shadow_resolution=256)
FAINT_LAMPS = 8
COMBINED = frozenset({"combined"})


def opaque(points: int) -> tuple[list, dict]:
    """A sphere of coloured points, a cube of triangles, a plane with a picture on it; a sun and a dim world."""
    color = (0.5 + 0.4 * clouds.sphere_points(points)).astype(np.float32)
    ball = build.points("bench: ball", clouds.sphere_cloud(points, color=color))
    graph = MaterialGraph(
        base_color=color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), build.picture(512, 256)))
    )
    wall = replace(meshes.plane_mesh("bench: wall", 2.5), materials=(1,))
    things = [
        (ball, build.moved((-0.8, 0, 0), 0.7)),
        (build.mesh(meshes.cube_mesh("bench: cube", 0.5), "POLYGONS"), build.moved((0.8, 0, 0.6))),
        (build.mesh(wall, "POLYGONS"), build.moved((0, 1.5, 0))),
    ]
    return things, {"table": build.materials(2, graphs=(None, graph))}


def translucent(cells: int) -> tuple[list, dict]:
    """A ball of smoke."""
    return [(build.points("bench: smoke", clouds.smoke_cloud(cells)), build.moved())], {}


def full(points: int, cells: int) -> tuple[list, dict]:
    """All of that, and coloured smoke, a pane, wide balls, strands, what glows, a holdout, a wide lamp and a picture of
    the environment."""
    things, more = opaque(points)
    (smoke, _), *_ = translucent(cells)[0]
    turn = np.linspace(0, 6 * np.pi, 60)
    spring = np.stack([0.4 * np.cos(turn), 0.4 * np.sin(turn), 0.05 * turn - 0.5], axis=1)
    glow = clouds.sphere_cloud(2000, emission=np.abs(clouds.sphere_points(2000)).astype(np.float32))
    pane = replace(meshes.plane_mesh("bench: pane", 0.5), materials=(2,))
    wide = solid_cases.balls().scene.geometries[0]
    tinted = build.points("bench: tinted", clouds.smoke_cloud(cells // 2, (0.5, 1.0, 3.0)))
    things += [
        (smoke, build.moved((0.6, -0.5, -0.6), 0.5)),
        (tinted, build.moved((-0.6, -0.5, -0.8), 0.4)),
        (build.mesh(pane), build.moved((0.2, -1, 0.3))),
        (wide, build.moved((0, 0.5, 1.2), 0.4)),
        (build.strand_lines("bench: spring", [spring], 0.03), build.moved((1.3, 0.4, -0.6))),
        (build.points("bench: glow", glow), build.moved((-1.5, 0.5, 0.9), 0.3)),
        (build.points("bench: cut", clouds.sphere_cloud(2000)), build.moved((1.4, 0, -1.2), 0.3)),
    ]
    table = build.materials(3, graphs=(*more["table"].graphs, None), alpha=[1, 1, 0.4],
                             translucent=np.array([False, False, True]))  # fmt: skip
    lamp = Light("POINT", np.full(3, 30.0), np.array([1.0, -3, 3]), np.array([0.0, 0, -1]), 0.3)
    image = np.linspace(0.1, 0.6, 64 * 32 * 3).reshape(32, 64, 3).astype(np.float32)
    held = [False] * (len(things) - 1) + [True]
    return things, {"table": table, "lights": (build.sun(), lamp), "world": World(np.zeros(3), image), "holdout": held}


def cases(quick: bool) -> dict[str, tuple[Scene, frozenset[str]]]:
    """Scenes and the passes that are asked for."""
    points, cells = POINTS // (10 if quick else 1), CELLS // (2 if quick else 1)
    made: dict[str, tuple[list, dict]] = {
        "empty": ([], {}),
        "opaque": opaque(points),
        "translucent": translucent(cells),
        "full": full(points, cells),
        "full, every pass": full(points, cells),
    }
    return {
        name: (build.scene(*things, **more), case.ALL_PASSES if "every" in name else COMBINED)
        for name, (things, more) in made.items()
    }


def timed(call: Callable[[], Any]) -> float:
    """Seconds of processor time, of all threads."""
    before = time.process_time()
    call()
    return time.process_time() - before


def run(quick: bool = False) -> tuple[list[dict], dict[str, list[list[str]]]]:
    """Rows of the benchmark, and its table."""
    side = SIZE // (4 if quick else 1)
    camera = cameras.camera((0, -5, 0), resolution=(side, side), field_of_view=45)
    found = cases(quick)
    requests = {name: Request(camera, SETTINGS, passes, 1) for name, (_, passes) in found.items()}
    device = OpenGLDevice()
    # What is kept for the next picture, such as an order, is each scene's own.
    store = Store()
    renderers = {name: Renderer(device, store) for name in found}
    first, counted = {}, {}
    for name, (scene, _) in found.items():
        # Each picture's own first one: nothing of another is on the device, or on the processor.
        store.clear()
        recorded = NullDevice()
        report = Renderer(recorded, store).render(scene, requests[name]).report
        store.clear()
        alone = Renderer(OpenGLDevice(), store)
        first[name] = timed(lambda scene=scene, name=name, alone=alone: alone.render(scene, requests[name]))
        alone.release()
        alone.device.release()
        counted[name] = (len(report["passes"]), len(recorded.interfaces), recorded.peak_bytes)
    for name, (scene, _) in found.items():
        renderers[name].render(scene, requests[name])
    turns = [{name: timed(lambda name=name, scene=scene: renderers[name].render(scene, requests[name]))
              for name, (scene, _) in found.items()} for _ in range(TIMES)]  # fmt: skip
    again = {name: float(np.median([turn[name] for turn in turns])) for name in found}
    table = [["scene", "passes", "programs", "on the GPU", "first picture", "further ones", "over the opaque one"]]
    for name, (passes, programs, size) in counted.items():
        cells = [name, str(passes), str(programs), f"{size / 1e6:.1f} MB", f"{first[name]:.2f} s"]
        table.append([*cells, f"{1000 * again[name]:.1f} ms", f"{again[name] / again['opaque']:.3f} x"])
    none = counted["empty"]
    size = f"{side} x {side}, 1 sample"
    rows = [
        row("programs of the empty scene", none[1], "", "<= 0", size),
        row("bytes on the GPU of the empty scene", none[2], "", "<= 0", size),
        row("empty / opaque", again["empty"] / again["opaque"], "x", "<= 0.05",
            f"{size}; {1000 * again['empty']:.2f} ms against {1000 * again['opaque']:.1f} ms"),
        faint_lamps(renderers["opaque"], found["opaque"][0], requests["opaque"]),
    ]  # fmt: skip
    for renderer in renderers.values():
        renderer.release()
    device.release()
    return rows, {f"What scenes take, {size}, processor time of all threads": table}


def faint_lamps(renderer: Renderer, scene: Scene, request: Request) -> dict:
    """Lamps too far away to matter, with shadows, against none."""
    # A picture's colours have no bound that is known beforehand: the same scene without it.
    plain = replace(scene, materials=replace(scene.materials, graphs=(None, None)))
    far = [
        Light("POINT", np.full(3, 5.0), np.array([1e5 * (i + 1.0), 0, 0]), np.array([-1.0, 0, 0]), 0.2)
        for i in range(FAINT_LAMPS)
    ]
    both = plain, replace(plain, lights=(*plain.lights, *far))
    for one in both:
        renderer.render(one, request)
    pairs = [[timed(lambda one=one: renderer.render(one, request)) for one in both] for _ in range(TIMES)]
    without, with_them = np.median(pairs, axis=0)
    note = f"{1000 * with_them:.1f} ms against {1000 * without:.1f} ms"
    return row(f"{FAINT_LAMPS} lamps too far to matter / none", with_them / without, "x", "<= 1.05", note)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer points and pixels")
    rows, found = run(parser.parse_args().quick)
    for entry in rows:
        sys.stdout.write("{name:48} {value:10.3f} {unit:4} {target:8} {note}\n".format(**entry))
    for title, table in found.items():
        sys.stdout.write(
            f"\n{title}\n" + "\n".join("  ".join(cell.rjust(14) for cell in line) for line in table) + "\n"
        )


if __name__ == "__main__":
    main()
