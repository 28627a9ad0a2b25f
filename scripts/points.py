"""Build hierarchies on disk from scans of any size, and look at them.

    python scripts/points.py build INPUT... --output NAME.psh [--memory BYTES] [--normals]
        [--attributes intensity,classification] [--workers N | --scheduler tcp://...]
    python scripts/points.py info NAME.psh

INPUT: files of points, folders of Entwine or Potree octrees, or patterns such as "tiles/*.laz", sorted by name.
--memory: at most so many bytes, also as 800M or 4G; default: a quarter of the machine's. --workers: processes; default:
as many as there are processors. --scheduler: the address of a Dask scheduler, whose workers find this package and see
inputs and output under the same paths. A build that was stopped goes on where it was. Exit codes: 0 built, 1 failed,
2 a wrong argument.
"""

import argparse
import glob
import os
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # run as a file, also by Blender: neither knows the checkout

UNITS = {"K": 10, "M": 20, "G": 30}


def memory(text: str) -> int:
    unit = text[-1:].upper()
    number = text[:-1] if unit in UNITS else text
    if not number.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is no number of bytes such as 800M or 4G")
    return int(number) << UNITS.get(unit, 0)


def quarter_of_memory() -> int:
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 4
    except (AttributeError, ValueError, OSError):
        return 2 << 30


def inputs(given: list[str]) -> list[Path]:
    found = []
    for text in given:
        found += sorted(glob.glob(text)) if glob.has_magic(text) and not os.path.exists(text) else [text]
    return [Path(text) for text in found]


def output(text: str) -> Path:
    path = Path(text).resolve()
    if path.suffix.lower() != ".psh":
        raise argparse.ArgumentTypeError(f"{text!r} must end in .psh")
    return path


def arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    build = commands.add_parser("build", help="from files of points to NAME.psh")
    build.add_argument("input", nargs="+", metavar="INPUT")
    build.add_argument("--output", type=output, required=True, metavar="NAME.psh")
    build.add_argument("--memory", type=memory, default=quarter_of_memory(), metavar="BYTES")
    build.add_argument("--normals", action="store_true")
    build.add_argument("--attributes", default="", metavar="NAME,NAME")
    who = build.add_mutually_exclusive_group()
    who.add_argument("--workers", type=int, default=0, metavar="N")
    who.add_argument("--scheduler", metavar="tcp://...")
    info = commands.add_parser("info", help="what a NAME.psh holds")
    info.add_argument("file", type=Path, metavar="NAME.psh")
    return parser.parse_args(argv)


class Progress:
    """One line on the terminal; whole stages where it is none."""

    def __init__(self) -> None:
        self._start = time.monotonic()
        self._stage, self._shown = "", -1.0

    def __call__(self, stage: str, share: float) -> None:
        if stage == self._stage and share < 1 and share - self._shown < 0.01:
            return
        line = f"{stage:8} {100 * share:5.1f} %  {time.monotonic() - self._start:7.1f} s"
        if sys.stderr.isatty():
            print(f"\r{line}", end="\n" if share >= 1 else "", file=sys.stderr, flush=True)
        elif stage != self._stage or share >= 1:
            print(line, file=sys.stderr, flush=True)
        self._stage, self._shown = stage, share


def build(args: argparse.Namespace) -> int:
    from pointsplat_addon.formats.hierarchies.building.build import Settings, build

    found = inputs(args.input)
    if not found:
        print("points.py: no file fits", *args.input, file=sys.stderr)
        return 2
    names = tuple(name.strip() for name in args.attributes.split(",") if name.strip())
    settings = Settings(args.memory, args.normals, names, args.workers, args.scheduler)
    try:
        built = build(found, args.output, settings, Progress())
    except (ValueError, OSError, ImportError) as error:
        print(f"points.py: {error}", file=sys.stderr)
        return 1
    for warning in built.warnings:
        print(f"Warning: {warning}", file=sys.stderr)
    each = built.nbytes / built.points
    print(f"{args.output}: {built.points:,} points, {built.nbytes:,} bytes ({each:.2f} a point)")
    return 0


def info(args: argparse.Namespace) -> int:
    from pointsplat_addon.formats.hierarchies.psh import PshPages

    try:
        with PshPages(args.file) as pages:
            directory, layout = pages.directory, pages.layout
    except (ValueError, OSError) as error:
        print(f"points.py: {error}", file=sys.stderr)
        return 1
    has = [n for n, there in (("colour", layout.color), ("normals", layout.normal)) if there]
    has += [name for name, _ in layout.attributes]
    print(f"{directory.points:,} points with {', '.join(has) or 'positions alone'}")
    print(f"{len(directory):,} pages of {directory.level.max() + 1} levels, {directory.nbytes.sum():,} bytes")
    print(f"origin {directory.origin.tolist()}, bounds {(directory.bounds[0] + directory.origin).tolist()}")
    print(f"reference system: {directory.crs or 'none'}")
    for level in range(directory.level.max() + 1):
        some = directory.level == level
        print(f"  level {level}: {some.sum():,} pages, {directory.count[some].sum():,} elements, "
              f"spacing {directory.spacing[some].min():.4g} to {directory.spacing[some].max():.4g}")  # fmt: skip
    return 0


def main() -> int:
    args = arguments(sys.argv[1:])
    return {"build": build, "info": info}[args.command](args)


if __name__ == "__main__":
    sys.exit(main())
