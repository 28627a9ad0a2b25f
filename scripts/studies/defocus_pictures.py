"""What is out of focus, by splats and by samples through the lens: the pictures of docs/notes/depth_of_field.md.

python -m scripts.studies.defocus_pictures --output docs/notes/images/defocus.jpg [--lens 256] [--scan FILE.ply[.gz]]

Rows: balls on a floor of triangles; a translucent shell out of focus before a body in focus, and behind one; hair and
tubes; a ball in focus before a picture of the world; the points of a scan, if one is given. From the left: without a
lens, splats (16 samples), samples through the lens, four times the difference.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from pointsplat_addon.core.light import environment
from pointsplat_addon.core.scene.camera import Aperture, Camera
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.benchmarks.defocus import scan
from scripts.common.images import displayed
from scripts.scenes import build, cameras, cases, clouds, meshes

WIDTH, HEIGHT, GAP = 320, 220, 4
COLORS = [[0.75, 0.73, 0.7], [0.2, 0.22, 0.28], [0.75, 0.2, 0.15], [0.15, 0.5, 0.2], [0.15, 0.3, 0.75], [0.8, 0.6, 0.1]]


def floor() -> tuple[Scene, Camera]:
    cells = 24
    row = np.arange(2 * cells * cells, dtype=np.uint16) // 2
    board = replace(meshes.plane_mesh("board", 4.0, cells), material=(row + row // cells) % 2, materials=(0, 1))
    flat = build.moved()
    flat[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    ball = meshes.sphere_mesh("ball", 48)
    things = [(build.mesh(board), flat)]
    for i, (x, y) in enumerate([(-0.9, -2.2), (-0.3, -0.8), (0.1, 0.4), (0.7, 1.7), (1.2, 3.2)]):
        of = build.mesh(replace(ball, key=f"ball {i}", materials=(2 + i % 4,)))
        things.append((of, build.moved((x, y, 0.4), 0.4)))
    table = build.materials(len(COLORS), base_color=COLORS)
    seen = cameras.camera((0, -4.6, 1.6), (0, 0.2, 0.3), (WIDTH, HEIGHT), field_of_view=64.0)
    return build.scene(*things, table=table), replace(seen, aperture=Aperture(0.3, 4.2))


def shell(behind: bool) -> tuple[Scene, Camera]:
    """A shell of coloured glass before a body of points, or the other way about."""
    table = build.materials(
        2, base_color=[[0.8, 0.5, 0.2], [0.2, 0.45, 0.9]], alpha=[1.0, 0.45], translucent=np.array([False, True])
    )
    name = "behind" if behind else "before"
    glass = replace(meshes.sphere_mesh(f"glass {name}", 40), materials=(1,))
    body = build.points(f"body {name}", clouds.sphere_cloud(20000))
    place = (0.6, 1.8, 0.2) if behind else (0.35, -2.0, 0.1)
    size = 1.0 if behind else 0.5
    things = ((build.mesh(glass), build.moved(place, size)), (body, build.moved((-0.2, 0, 0), 0.8)))
    seen = cameras.camera((0, -4.5, 0.6), (0, 0, 0), (WIDTH, HEIGHT))
    return build.scene(*things, table=table), replace(seen, aperture=Aperture(0.25, 3.8))


def strands() -> tuple[Scene, Camera]:
    case = cases.CASES["strands"]()
    return case.scene, replace(case.camera, resolution=(WIDTH, HEIGHT), aperture=Aperture(0.25, 3.2))


def landscape() -> tuple[Scene, Camera]:
    """A ball between hills at dusk, with the sun and the lamps of a village behind it."""
    x, y, z = np.moveaxis(environment.texel_directions(1024, 512), -1, 0)
    azimuth = np.arctan2(y, x)
    ridge = 0.05 + 0.03 * np.sin(9 * azimuth) + 0.012 * np.sin(31 * azimuth + 1) + 0.006 * np.sin(83 * azimuth)
    dusk = np.exp(-6 * np.abs(z))[..., None]
    image = [0.12, 0.2, 0.42] + dusk * np.array([0.85, 0.35, 0.02])
    image = np.where((z < ridge)[..., None], [0.05, 0.07, 0.06] + 0.3 * np.minimum(np.abs(z), 0.4)[..., None], image)
    image[np.hypot(azimuth - 1.78, z - 0.16) < 0.022] = 30, 17, 6
    rng = np.random.default_rng(3)
    rows, columns = rng.integers(250, 262, 60), rng.integers(140, 340, 60)
    image[rows, columns] = rng.uniform(4, 14, (60, 1)) * [1.0, 0.75, 0.4]
    world = World(np.zeros(3), image.astype(np.float32))
    table = build.materials(base_color=[[0.8, 0.78, 0.75]], roughness=[0.25])
    body = build.points("ball before hills", clouds.sphere_cloud(20000))
    seen = cameras.camera((0, -5, 0.3), (0.35, 0, 0.25), (WIDTH, HEIGHT))
    scene = build.scene((body, build.moved((0, 0, 0.1), 0.7)), lights=(), world=world, table=table)
    return scene, replace(seen, aperture=Aperture(0.15, 4.6))


def scanned(path: Path) -> tuple[Scene, Camera]:
    """Along a scan that is as deep as the lens blurs: in focus where it is nearest."""
    body = build.mesh(scan(path), "POINTS")
    lights = (build.sun(2.5, (0.4, 0.5, -0.8)),)
    seen = cameras.camera((-2.1, -1.0, 0.5), (0.1, 0.0, -0.15), (WIDTH, HEIGHT), field_of_view=50.0)
    of = build.scene((body, build.moved((0, 0, -1.0), 1.2)), lights=lights)
    return of, replace(seen, aperture=Aperture(0.06, 1.6))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True)
    parser.add_argument("--lens", type=int, default=256, help="samples through the lens")
    parser.add_argument("--scan", type=Path, help="a PLY of triangles")
    given = parser.parse_args()
    renderer, rows = Renderer(OpenGLDevice()), []
    pictures = [floor(), shell(False), shell(True), strands(), landscape()]
    if given.scan is not None:
        pictures.append(scanned(given.scan))
    for scene, camera in pictures:
        splat = Settings(use_shadows=False)
        wanted = (
            (replace(camera, aperture=None), splat, 16),
            (camera, splat, 16),
            (camera, replace(splat, dof_method="LENS_SAMPLES"), given.lens),
        )
        found = [
            renderer.render(scene, Request(c, s, frozenset({"combined"}), n)).pixels["combined"] for c, s, n in wanted
        ]
        difference = found[1] - found[2]
        print(f"RMSE {np.sqrt((difference[..., :3] ** 2).mean()):.4f}, without a lens "
              f"{np.sqrt(((found[0] - found[2])[..., :3] ** 2).mean()):.4f}")  # fmt: skip
        difference[..., 3] = 1
        rows.append([*found, np.abs(difference) * [4, 4, 4, 1]])
    sheet = Image.new("RGB", (4 * WIDTH + 3 * GAP, len(rows) * (HEIGHT + GAP) - GAP))
    for y, row in enumerate(rows):
        for x, picture in enumerate(row):
            shown = Image.fromarray(np.rint(255 * displayed(picture[::-1])).astype(np.uint8))
            sheet.paste(shown, (x * (WIDTH + GAP), y * (HEIGHT + GAP)))
    sheet.save(given.output, quality=90)
    renderer.release()


if __name__ == "__main__":
    main()
