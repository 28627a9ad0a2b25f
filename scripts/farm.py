"""Draw a film on many machines, or by several processes of one (dask.distributed).

    python scripts/farm.py render FILE.blend --frames 1-240 --output OUT.png|OUT.exr
        [--scheduler tcp://HOST:8786 | --workers N] [--threads N] [--parts N] [-- further arguments of render.py]
    python scripts/farm.py scheduler [--port 8786]
    python scripts/farm.py worker tcp://HOST:8786

Every machine sees FILE and OUT under the same paths. Each frame is a process of its own, and goes to another machine
where one fails; with --parts so is each of N parts of a frame, which are joined. Frames that are there are not drawn
again, so that the same command goes on after whatever was killed. Beside the pictures, the folder OUT.farm holds a
report of each frame, report.json of all, and caches that machines share. Exit codes: 0 all frames are there, 1 some
failed, 2 a wrong argument.
"""

import argparse
import hashlib
import json
import logging
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))
# Processes that dask starts import what a task is from here. No idle machine takes what another one was given: it may
# have been refused there.
os.environ["PYTHONPATH"] = os.pathsep.join([str(ROOT), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]).rstrip(":")
os.environ["DASK_DISTRIBUTED__SCHEDULER__WORK_STEALING"] = "False"

from scripts.common import farm_task  # noqa: E402
from scripts.common.farm_task import WHOLE  # noqa: E402
from scripts.common.version import version_of  # noqa: E402
from scripts.render import frames, output  # noqa: E402

try:
    import distributed
except ModuleNotFoundError:
    sys.exit("farm: dask.distributed is missing; python -m pip install distributed brings it")

POLL = 1.0  # seconds, after which new machines are looked for
PATIENCE = 5.0  # seconds between attempts to reach a scheduler
GRACE = 120.0  # seconds in which another machine may come where none that is there can draw
DASK = sys.executable, "-P", "-m"  # -P: scripts are those of this checkout, whatever the working folder has
MOST_TRIES = 2  # machines on which a frame raises before it counts as failed


Unit = tuple[int, int]  # a frame and a part of it, or WHOLE


class ArgumentError(Exception):
    """What was asked makes no sense; the message says why."""


class LostError(Exception):
    """The scheduler is gone, and what it knew."""


def say(text: str) -> None:
    print(f"farm: {text}", flush=True)


# ---------------------------------------------------------------------------- the film


@dataclass
class Film:
    """What is to be drawn, and how far it is."""

    job: dict  # of farm_task.draw
    numbers: list[int]
    shared: bool  # machines come and go; else they are processes of this one
    failed: dict[int, str] = field(default_factory=dict)  # message by frame
    ended: list[dict] = field(default_factory=list)  # what farm_task.draw returned for frames that are there
    begun: float = field(default_factory=time.time)

    @property
    def folder(self) -> Path:
        return Path(self.job["folder"])

    def missing(self) -> list[Unit]:
        """What can be drawn now, by what is on disk."""
        return [unit for frame in self.numbers for unit in self.missing_of(frame)]

    def missing_of(self, frame: int) -> list[Unit]:
        """What can be drawn now of a frame: its parts; with these there, itself; nothing if it is there or failed."""
        if frame in self.failed or farm_task.is_there(self.job, frame, WHOLE):
            return []
        parts = range(1, self.job["parts"] + 1) if self.job["parts"] > 1 else ()
        return [(frame, part) for part in parts if not farm_task.is_there(self.job, frame, part)] or [(frame, WHOLE)]

    def drawn(self, found: dict, left: int) -> None:
        """Note a frame or part, and say how far the film is: `left` others are missing. All machines draw with what the
        first one drew with."""
        if found["state"] == "drawn":
            self.ended.append(found)
            if "Blender" not in self.job["require"]:
                self.job["require"] = found["report"]["version"]
                keep_job(self.job)
            for warning in found["report"].get("warnings", []):
                say(f"frame {found['frame']}: warning: {warning}")
        rate = (time.time() - self.begun) / max(len(self.ended), 1)
        seconds = f"{found['ended'] - found['begun']:.1f} s"
        more = f"{left} to go, about {timedelta(seconds=round(rate * left))}" if left else "the last one"
        say(f"{name(found)} on {found['machine']} in {seconds}; {more}")

    def fail_all(self, units: list[Unit], message: str) -> None:
        for frame in dict.fromkeys(frame for frame, _ in units):
            self.fail(frame, message)

    def fail(self, frame: int, message: str) -> None:
        self.failed[frame] = message
        say(f"frame {frame} FAILED: {message}")

    def write_report(self) -> None:
        """report.json: what this call did, and which machines drew the frames that are there."""
        seconds = time.time() - self.begun
        machines: dict[str, dict] = defaultdict(lambda: {"frames": [], "seconds": 0.0, "processor": 0.0})
        for found in self.ended:
            row = machines[found["machine"]]
            row["frames"].append(found["frame"] if found["part"] == WHOLE else [found["frame"], found["part"]])
            row["seconds"] += found["ended"] - found["begun"]
            row["processor"] += found["processor"]
        for row in machines.values():
            row["waiting"] = max(0.0, seconds - row["seconds"])
        devices = sorted({found["report"]["device"] for found in self.ended})
        if len(devices) > 1:
            say(f"machines drew with different devices, whose pictures may differ: {'; '.join(devices)}")
        whole = {
            "seconds": seconds,
            "processor": sum(found["processor"] for found in self.ended),
            "machines": machines,
            "devices": devices,
            "version": self.job["require"],
            "missing": sorted({frame for frame, _ in self.missing()}),
            "failed": self.failed,
        }
        farm_task.write(self.folder / "report.json", json.dumps(whole, indent=1))


def name(found: dict) -> str:
    """What a frame, or a part of one, is called in messages."""
    return f"frame {found['frame']}" + (f", part {found['part']}," if found["part"] != WHOLE else "")


def keep_job(job: dict) -> None:
    farm_task.write(Path(job["folder"]) / "job.json", json.dumps(job, indent=1))


def film_of(args: argparse.Namespace) -> Film:
    """The film that is asked for. ArgumentError: there is no file, or pictures of another film lie where it would."""
    if not args.file.is_file():
        raise ArgumentError(f"there is no file {args.file}")
    file = args.file.resolve()
    folder = args.output.with_suffix(".farm")
    job = {
        "file": str(file),
        "digest": hashlib.blake2b(file.read_bytes(), digest_size=16).hexdigest(),
        "output": str(args.output),
        "folder": str(folder),
        "arguments": args.arguments,
        "require": version_of(ROOT),
        "parts": args.parts,
        "threads": args.threads or (max(1, (os.cpu_count() or 1) // args.workers) if args.workers else None),
    }
    film = Film(job, list(args.frames), args.scheduler is not None)
    try:
        before = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    except FileNotFoundError:
        before = None
    if before is not None and before["require"].split()[0] == job["require"]:
        job["require"] = before["require"]
    same = before is not None and all(before[key] == job[key] for key in ("digest", "arguments", "parts", "require"))
    if not same and any(args.output.parent.glob(f"{args.output.stem}_[0-9]*{args.output.suffix}")):
        raise ArgumentError(
            f"pictures that lie in {args.output.parent} are of another file, other arguments or another version of "
            f"PointSplat; delete them and {folder}, or choose another --output"
        )
    if not same:
        shutil.rmtree(folder, ignore_errors=True)  # parts of another picture
    folder.mkdir(parents=True, exist_ok=True)
    keep_job(job)
    return film


# ---------------------------------------------------------------------------- machines


@contextmanager
def connected(args: argparse.Namespace) -> Iterator[distributed.Client]:
    """A client of the scheduler, or of one of its own with as many workers as were asked for.

    LostError: no scheduler answers."""
    if args.scheduler is None:
        with (
            tempfile.TemporaryDirectory() as scratch,
            distributed.LocalCluster(
                n_workers=args.workers,
                threads_per_worker=1,
                memory_limit=0,
                dashboard_address="127.0.0.1:0",
                local_directory=scratch,
            ) as cluster,
            distributed.Client(cluster) as client,
        ):
            yield client
        return
    try:
        client = distributed.Client(args.scheduler, timeout=PATIENCE)
    except (OSError, TimeoutError) as error:
        raise LostError(str(error)) from error
    with client:
        yield client


def draw_missing(client: distributed.Client, film: Film) -> None:
    """Draw what is missing of a film, the first frame alone: it makes the caches that all others find.

    LostError: the scheduler is gone."""
    refused: dict[str, str] = {}  # why, by address of the machine
    tried: dict[Unit, dict[str, str]] = defaultdict(dict)  # what each machine said that failed
    waiting = film.missing()
    running: dict[distributed.Future, Unit] = {}
    alone, idle = True, 0.0  # idle: since when no machine that is there can draw
    while waiting or running:
        able = [address for address in _workers(client) if address not in refused]
        if able or running:
            idle = 0.0
        elif not idle:
            if film.shared:
                say("waiting for machines: python scripts/farm.py worker ADDRESS starts one")
            idle = time.monotonic()
        elif refused and time.monotonic() - idle > (GRACE if film.shared else 0):
            reasons = "; ".join(sorted(set(refused.values())))
            film.fail_all(waiting, f"no machine can draw it: {reasons}")
            return
        while waiting and len(running) < (1 if alone else len(able)) and able:
            unit = waiting.pop(0)
            others = [address for address in able if address not in tried[unit]]
            # Anyone may draw it where all of these are gone by then.
            where = {"workers": others, "allow_other_workers": True} if refused or tried[unit] else {}
            running[client.submit(farm_task.draw, film.job | {"prepare": alone}, *unit, pure=False, **where)] = unit
        for future in _ended(list(running)):
            unit = running.pop(future)
            found, address = _result(future, unit)
            if found["frame"] in film.failed:  # by another part
                continue
            if found["state"] in ("drawn", "there"):
                alone = False
                joined = found["frame"], WHOLE
                if joined in film.missing_of(found["frame"]) and joined not in [*waiting, *running.values()]:
                    waiting.insert(0, joined)  # all its parts are there
                film.drawn(found, len(waiting) + len(running))
                continue
            tried[unit][address] = found["message"]
            say(f"{name(found)} on {found['machine']}: {found['message']}")
            if found["state"] == "refused":
                refused[address] = f"{found['machine']}: {found['message']}"
                waiting.insert(0, unit)
            elif len(tried[unit]) < MOST_TRIES and set(able) - set(tried[unit]) - set(refused):
                waiting.insert(0, unit)
            else:
                alone = False
                film.fail(found["frame"], found["message"])
                waiting = [other for other in waiting if other[0] != found["frame"]]


def _workers(client: distributed.Client) -> list[str]:
    """Addresses of all workers. LostError: the scheduler is gone."""
    try:
        return list(client.scheduler_info(n_workers=-1)["workers"])
    except OSError as error:
        raise LostError("the connection was lost") from error


def _ended(running: list[distributed.Future]) -> list[distributed.Future]:
    """Those that have ended, once some have or POLL seconds are over. LostError: the scheduler is gone."""
    if not running:
        time.sleep(POLL)
        return []
    try:
        done = distributed.wait(running, timeout=POLL, return_when="FIRST_COMPLETED").done
    except TimeoutError:
        return []
    except (OSError, distributed.CancelledError) as error:
        raise LostError("the connection was lost") from error
    if any(future.status in ("cancelled", "lost") for future in running):
        raise LostError("it forgot the frames")
    return list(done)


def _result(future: distributed.Future, unit: Unit) -> tuple[dict, str]:
    """What farm_task.draw returned and the address of the worker that did; "failed" where workers died of it."""
    try:
        found = future.result()
    except distributed.KilledWorker as error:
        found = {"state": "failed", "machine": error.last_worker.name, "message": str(error)}
        found |= {"frame": unit[0], "part": unit[1]}
    except (OSError, distributed.CancelledError) as error:
        raise LostError("the connection was lost") from error
    return found, found.get("address", found["machine"])


# ---------------------------------------------------------------------------- verbs


def render(args: argparse.Namespace) -> int:
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what matters is said here
    film = film_of(args)
    say(f"{len({frame for frame, _ in film.missing()})} of {len(film.numbers)} frames are missing")
    try:
        while film.missing():
            try:
                with connected(args) as client:
                    draw_missing(client, film)
            except LostError as error:
                say(f"no scheduler ({error}); trying again")
                time.sleep(PATIENCE)
    finally:
        film.write_report()
    for frame, message in sorted(film.failed.items()):
        say(f"frame {frame} is missing: {message}")
    say(f"the report is {film.folder / 'report.json'}")
    return 1 if film.failed else 0


def scheduler(args: argparse.Namespace) -> int:
    return subprocess.call([*DASK, "distributed.cli.dask_scheduler", "--port", str(args.port), "--no-dashboard"])


def worker(args: argparse.Namespace) -> int:
    """Draws frames for a scheduler, and waits for it where it is not there, until it is interrupted."""
    with tempfile.TemporaryDirectory() as scratch:
        command = [*DASK, "distributed.cli.dask_worker", args.address, "--nthreads", "1"]
        command += ["--memory-limit", "0", "--no-dashboard", "--local-directory", scratch]
        while True:
            subprocess.call(command)
            time.sleep(POLL)


def arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    verbs = parser.add_subparsers(required=True, metavar="render|scheduler|worker")
    film = verbs.add_parser("render", help="draw a film; what stands behind -- goes to render.py")
    film.add_argument("file", type=Path, metavar="FILE.blend")
    film.add_argument("--frames", type=frames, required=True, metavar="A-B")
    film.add_argument("--output", type=output, required=True, metavar="OUT.png|OUT.exr")
    where = film.add_mutually_exclusive_group()
    where.add_argument("--scheduler", metavar="tcp://HOST:PORT")
    where.add_argument("--workers", type=int, default=0, metavar="N", help="processes on this machine (default: 1)")
    film.add_argument("--parts", type=int, default=1, metavar="N", help="of each frame, drawn by themselves")
    film.add_argument("--threads", type=int, metavar="N", help="of each process (default: all, shared by --workers)")
    film.set_defaults(verb=render)
    main = verbs.add_parser("scheduler", help="share out frames among machines")
    main.add_argument("--port", type=int, default=8786)
    main.set_defaults(verb=scheduler)
    hand = verbs.add_parser("worker", help="draw frames on this machine")
    hand.add_argument("address", metavar="tcp://HOST:PORT")
    hand.set_defaults(verb=worker)
    own, _, rest = (argv, [], []) if "--" not in argv else (argv[: argv.index("--")], [], argv[argv.index("--") + 1 :])
    args = parser.parse_args(own)
    args.arguments = rest
    if args.verb is render and args.scheduler is None:
        args.workers = max(args.workers, 1)
    return args


def main() -> int:
    # As an exception, so that clusters end with their processes.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        args = arguments(sys.argv[1:])
        return args.verb(args)
    except ArgumentError as error:
        print(f"farm: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
