"""How much a camera that dollies steadily sees change from one picture to the next, beyond what polygons change.

    python -m scripts.studies.transitions [--shape NAME ...] [--step 0.01] [--samples 16] [--size 512]
    python -m scripts.studies.transitions --journey NAME [--technique EWA] [--tolerance 4] [--size 128] ...

A camera approaches a body on a grey world by a fixed share of its distance from frame to frame. For each pair of frames
and each pixel, the greatest change of a channel, as a display shows it (8 bits), less the same change of the polygons;
the 99th percentile over the pixels of the body tells what pops. Polygons with another set of samples are the floor:
what edges alone change by being quantised. Journeys (scripts/scenes/journeys.py) are those of clouds, fields of
instances, and meshes that are divided, from near to far or back, with what they are compared with.
"""

from __future__ import annotations

import argparse
import sys

from pointsplat_addon.core.scene.settings import Settings
from scripts.scenes import drawing


def main() -> None:
    from scripts.scenes.journeys import JOURNEYS, SHAPES, Journey, dolly

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
        renderer = drawing.opengl()
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
