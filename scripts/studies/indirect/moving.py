"""What indirect light takes in further pictures of a scene that stands still, and what it changes from one to the next.

    python -m scripts.studies.indirect.moving FILE.blend ... [--frames 6] [--step 0.01] [--far 0.5] [--samples 16]

The camera of each file draws a picture, moves forward by `--step` of its distance from what it looks at, `--frames`
times, and then turns about that by `--far` radians. Seconds of the light tree and of the gather are by the clock.
Changes are those of surfaces that both pictures show, brought from one into the other, less what they are without
indirect light, in 255ths of an exposure that brings the mean to 0.3: the largest change of the mean, then percentiles
99 and 99.9 and the largest of pixels.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request, Result
from pointsplat_addon.render.renderer import Renderer

PASSES = frozenset({"combined", "position", "normal"})
PARTS = "light tree", "gather"
APART = 0.5  # pixels that places of a surface may lie off its plane
RIM = 2  # pixels around the edges of surfaces that are left out


def loaded(file: Path) -> tuple[Scene, Camera, Settings]:
    """The scene of a .blend file, with its camera and settings."""
    import bpy

    import pointsplat_addon

    if not hasattr(bpy.types.Scene, "pointsplat"):
        pointsplat_addon.register()
    bpy.ops.wm.open_mainfile(filepath=str(file.resolve()))
    from pointsplat_addon.host.convert.camera import from_camera_object
    from pointsplat_addon.host.sync import Synchronizer

    depsgraph = bpy.context.evaluated_depsgraph_get()
    render, seen = bpy.context.scene.render, bpy.context.scene.camera
    camera = from_camera_object(seen, depsgraph, render.resolution_x, render.resolution_y)
    return Synchronizer().scene(depsgraph), camera, bpy.context.scene.pointsplat.settings()


def turned(camera: Camera, about: np.ndarray, angle: float) -> Camera:
    """The camera, turned about an upright axis through a place (3,)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    turn = np.eye(4)
    turn[:2, :2] = [[cosine, -sine], [sine, cosine]]
    turn[:3, 3] = about - turn[:3, :3] @ about
    return replace(camera, view_from_world=camera.view_from_world @ turn)


def nearer(camera: Camera, by: float) -> Camera:
    """The camera, moved forward by so many units."""
    move = np.eye(4)
    move[2, 3] = by
    return replace(camera, view_from_world=move @ camera.view_from_world)


def seen_in(camera: Camera, position: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of places (N, 3), counted from their middles."""
    view = np.column_stack([position, np.ones(len(position))]) @ camera.view_from_world.T
    clip = view @ camera.clip_from_view.T
    with np.errstate(all="ignore"):
        return (clip[:, :2] / clip[:, 3:] * 0.5 + 0.5) * camera.resolution - 0.5


def brought(before: dict[str, np.ndarray], camera: Camera, now: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """What a picture, (H, W, C) by pass and seen by `camera`, shows of the surfaces that another shows: (H, W, 3), and
    where it shows them, (H, W) bool."""
    high, wide = now["combined"].shape[:2]
    position, normal = now["position"].reshape(-1, 3), now["normal"].reshape(-1, 3)
    at = seen_in(camera, position)
    corner = np.nan_to_num(np.floor(at), nan=-9)
    good = ((corner >= 0) & (corner < np.array([wide, high]) - 1)).all(axis=1)
    x, y = np.where(good[:, None], corner, 0).astype(np.int64).T
    fx, fy = (at - corner).T
    found = np.zeros((len(at), 3))
    eye = np.linalg.inv(camera.view_from_world)[:3, 3]
    size = np.linalg.norm(position - eye, axis=1) / camera.pixel_from_view()[0]
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        weight = (fx if dx else 1 - fx) * (fy if dy else 1 - fy)
        found += weight[:, None] * before["combined"][y + dy, x + dx, :3]
        other, turned_to = before["position"][y + dy, x + dx], before["normal"][y + dy, x + dx]
        off = np.abs(((other - position) * normal).sum(axis=1))
        good &= (off < APART * size) & ((turned_to * normal).sum(axis=1) > 0.999)
        good &= np.abs(other - position).max(axis=1) < 20 * size
    return found.reshape(high, wide, 3), good.reshape(high, wide) & inner(now, size.reshape(high, wide))


def inner(picture: dict[str, np.ndarray], size: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that lie on one plane with those around them; `size` (H, W): of a pixel."""
    position, normal = picture["position"], picture["normal"]
    good = np.zeros(size.shape, bool)
    good[RIM:-RIM, RIM:-RIM] = True
    steps = range(-RIM, RIM + 1)
    for x, y in product(steps, steps):
        other = np.roll(position, (y, x), (0, 1))
        good &= np.abs(((other - position) * normal).sum(axis=2)) < APART * size
        good &= (np.roll(normal, (y, x), (0, 1)) * normal).sum(axis=2) > 0.999
    return good


def change(pictures: list[dict[str, np.ndarray]], plain: list[dict[str, np.ndarray]], camera: Camera) -> np.ndarray:
    """(N,) by how much indirect light changes from the first picture, seen by `camera`, to the second."""
    (a, good), (b, _) = (brought(pair[0], camera, pair[1]) for pair in (pictures, plain))
    own = (pictures[1]["combined"][..., :3] - a) - (plain[1]["combined"][..., :3] - b)
    return own[good].mean(axis=1)


def measured(file: Path, frames: int, step: float, far: float, samples: int) -> str:
    """A row of the table."""
    scene, camera, settings = loaded(file)
    renderer = Renderer(OpenGLDevice())

    def drawn(seen: Camera, indirect: bool) -> Result:
        return renderer.render(scene, Request(seen, replace(settings, use_indirect=indirect), PASSES, samples))

    def seconds(result: Result) -> float:
        return sum(one["ms"] for one in result.report["passes"] if one["name"] in PARTS) / 1000

    first = drawn(camera, True)
    position = first.pixels["position"]
    about = position[position.shape[0] // 2, position.shape[1] // 2].astype(float)
    distance = float(np.linalg.norm(about - np.linalg.inv(camera.view_from_world)[:3, 3]))
    exposure = 0.3 / first.pixels["combined"][..., :3].mean()
    seen, pictures, took = camera, [(first.pixels, drawn(camera, False).pixels)], [seconds(first)]
    changes = []
    for _ in range(frames):
        before, seen = seen, nearer(seen, step * distance)
        result = drawn(seen, True)
        took.append(seconds(result))
        pictures = [pictures[-1], (result.pixels, drawn(seen, False).pixels)]
        changes.append(255 * exposure * change([p[0] for p in pictures], [p[1] for p in pictures], before))
    turn = seconds(drawn(turned(seen, about, far), True))
    of_means = max(abs(float(c.mean())) for c in changes)
    sizes = [max(float(np.quantile(np.abs(c), q)) for c in changes) for q in (0.99, 0.999, 1.0)]
    each = " ".join(f"{one:.2f}" for one in took)
    shares = f"{max(took[1:]) / took[0]:.2f} | {turn:.2f} ({turn / took[0]:.2f})"
    return f"| {file.stem} | {each} | {shares} | {of_means:.3f} | {' | '.join(f'{one:.2f}' for one in sizes)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path, nargs="+")
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--step", type=float, default=0.01)
    parser.add_argument("--far", type=float, default=0.5)
    parser.add_argument("--samples", type=int, default=16)
    options = parser.parse_args()
    sys.stdout.write(
        "| scene | seconds | share | turned | mean | 99 | 99.9 | largest |\n|---|---|---|---|---|---|---|---|\n"
    )
    for file in options.file:
        row = measured(file, options.frames, options.step, options.far, options.samples)
        sys.stdout.write(row + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
