"""How much a camera that dollies steadily sees change from one picture to the next, beyond what polygons change.

    python -m scripts.studies.transitions [--shape NAME ...] [--step 0.01] [--samples 16] [--size 512]
    python -m scripts.studies.transitions --journey NAME [--technique EWA] [--tolerance 4] [--size 128] ...

A camera approaches a body on a grey world by a fixed share of its distance from frame to frame. For each pair of frames
and each pixel, the greatest change of a channel, as a display shows it (8 bits), less the same change of the polygons;
the 99th percentile over the pixels of the body tells what pops. Polygons with another set of samples are the floor:
what edges alone change by being quantised. Journeys (tests/render/frame/test_transitions.py) are those of clouds, fields of
instances, and meshes that are divided, from near to far or back, with what they are compared with.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Geometry, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.common.images import displayed

PERCENTILE = 99.0


@dataclass(frozen=True)
class Change:
    """Between two frames that follow each other, in steps of an 8-bit display."""

    frame: int
    excess: float  # 99th percentile, over the pixels of the body, of what changes more than in the reference
    worst: float  # 99.9th
    whole: float  # 99th over the whole picture
    own: float  # 99th percentile of the change itself
    reference: float  # and of the reference's
    drawn: str  # what the second frame draws


def levels(pixels: np.ndarray) -> np.ndarray:
    """(H, W, 3) float64, what an 8-bit display shows of scene-linear pixels, not rounded."""
    return 255.0 * displayed(pixels.astype(np.float64))


def excess(before: np.ndarray, after: np.ndarray, other_before: np.ndarray, other_after: np.ndarray) -> np.ndarray:
    """(H, W): by how much more the first pair of pictures differs than the second, in its worst channel."""
    own, other = (np.abs(b - a).max(axis=2) for a, b in ((before, after), (other_before, other_after)))
    return own - other


def body(*shown: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that differ in one of the pictures from their corner, where the world alone is seen."""
    return np.any([np.abs(p - p[:1, :1]).max(axis=2) > 0.5 for p in shown], axis=0)


def pictures(
    renderer: Renderer, scene: Scene, cameras: list[Camera], settings: Settings, samples: int
) -> Iterator[tuple[np.ndarray, str]]:
    """Each camera's picture as a display shows it, and what was drawn for it."""
    for camera in cameras:
        result = renderer.render(scene, Request(camera, settings, frozenset({"combined"}), samples))
        report = result.report
        yield levels(result.pixels["combined"]), f"{report['points']['cut']} points, {report['triangles']} triangles"


def changes(
    renderer: Renderer,
    scene: Scene,
    cameras: list[Camera],
    settings: Settings,
    samples: int,
    reference_samples: int = 0,
    reference: tuple[Scene, Settings] | None = None,
) -> list[Change]:
    """What `scene` changes from camera to camera beyond `reference`, or the same geometries as polygons.
    `reference_samples`: another number of samples than `samples`."""
    plain = replace(scene, geometries=tuple(as_polygons(g) for g in scene.geometries)), settings
    shown = pictures(renderer, scene, cameras, settings, samples)
    other_scene, other_settings = reference or plain
    truth = pictures(renderer, other_scene, cameras, other_settings, reference_samples or samples)
    found: list[Change] = []
    before = None
    for frame, ((own, drawn), (other, _)) in enumerate(zip(shown, truth, strict=True)):
        if before is not None:
            beyond = excess(before[0], own, before[1], other)
            moved = [np.abs(b - a).max(axis=2) for a, b in zip(before, (own, other), strict=True)]
            drawn_there = body(before[0], before[1], own, other)
            at, far = np.percentile(beyond[drawn_there], (PERCENTILE, 99.9))
            own_change, truth_change = (float(np.percentile(m[drawn_there], PERCENTILE)) for m in moved)
            whole = float(np.percentile(beyond, PERCENTILE))
            found.append(Change(frame, float(at), float(far), whole, own_change, truth_change, drawn))
        before = own, other
    return found


def as_polygons(geometry: Geometry) -> Geometry:
    return geometry if geometry.mesh is None else replace(geometry, primitive="POLYGONS")


def main() -> None:
    from tests.render.frame.test_transitions import JOURNEYS, SHAPES, Journey, dolly
    from tests.support import scenes

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shape", action="append", choices=SHAPES)
    parser.add_argument("--journey", action="append", choices=JOURNEYS, default=[])
    parser.add_argument("--step", type=float, default=0.01, help="share of the distance between two frames")
    parser.add_argument("--samples", type=int, default=16)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--from", dest="start", type=float, help="distance")
    parser.add_argument("--to", dest="stop", type=float)
    parser.add_argument("--primitive", default="AUTO")
    parser.add_argument("--technique", default="AUTO")
    parser.add_argument("--tolerance", type=float, default=1.0)
    parser.add_argument("--every", action="store_true", help="no adaptive sampling")
    parser.add_argument("--floor", type=int, default=0, metavar="N", help="polygons against polygons of N samples")
    options = parser.parse_args()
    settings = Settings(
        use_shadows=False,
        use_adaptive_sampling=not options.every,
        technique=options.technique,
        tolerance=options.tolerance,
    )
    for name in options.journey or options.shape or SHAPES:
        if name in options.journey:
            make, start, stop = JOURNEYS[name]
            journey = make(options.start or start, options.stop or stop, options.step, options.size)
        else:
            primitive = "POLYGONS" if options.floor else options.primitive
            near, far = options.stop or 2.5, options.start or 10.0
            journey = Journey(*dolly(name, far, near, options.step, options.size, primitive))
        renderer = scenes.opengl()
        sys.stdout.write(
            f"{name}: frame, excess at 99 %, 99.9 %, 99 % of the picture, own change, reference's, what is drawn\n"
        )
        for c in journey.changes(renderer, settings, options.samples, options.floor):
            mark = " !" if c.excess > 2 else ""
            figures = " ".join(f"{v:6.2f}" for v in (c.excess, c.worst, c.whole, c.own, c.reference))
            sys.stdout.write(f"{c.frame:4} {figures}  {c.drawn}{mark}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
