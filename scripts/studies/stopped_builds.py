"""Whether a build gives the same bytes however it is done: by 1, 2 and 4 processes, killed ten times and begun again,
and by Dask workers of which one is killed.

    python -m scripts.studies.stopped_builds FOLDER INPUT... [--kills 10] [--normals]

FOLDER takes the files that are built; all but the first are deleted. The first build's time tells when to kill.
"""

import argparse
import os
import random
import signal
import socket
import subprocess
import sys
import time
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def checksum(path: Path) -> tuple[int, int]:
    """Bytes and CRC-32 of a file."""
    crc = size = 0
    with path.open("rb") as file:
        while part := file.read(1 << 24):
            crc, size = zlib.crc32(part, crc), size + len(part)
    return size, crc


def start(args: argparse.Namespace, output: Path, *options: str) -> subprocess.Popen:
    command = [sys.executable, str(ROOT / "scripts" / "points.py"), "build", *args.input, "--output", str(output)]
    command += [*options, *(["--normals"] if args.normals else [])]
    return subprocess.Popen(command, start_new_session=True, stderr=subprocess.DEVNULL)


def finish(process: subprocess.Popen) -> None:
    if process.wait() != 0:
        sys.exit(f"a build failed with {process.returncode}")


def killed(args: argparse.Namespace, output: Path, seconds: float) -> int:
    """Builds, and kills the build with all its processes at random moments; returns how often."""
    moments = random.Random(0)
    kills = 0
    while True:
        process = start(args, output, "--workers", "2")
        if kills < args.kills:
            # What was done is not done again: each try gets a share of the time of the whole.
            time.sleep(moments.uniform(0.5, 1.5) * seconds / args.kills + 1.0)
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
                kills += 1
                assert not output.exists()
                continue
        finish(process)
        return kills


def on_dask(args: argparse.Namespace, output: Path, seconds: float) -> None:
    """Builds on two workers of a cluster; kills one of them in the middle, and starts another."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", address, "--no-dashboard"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny"]
    worker.append("--no-dashboard")

    def begin(command: list[str]) -> subprocess.Popen:
        return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)

    running = [begin(dask)]
    try:
        time.sleep(3)
        running += [begin(worker) for _ in range(2)]
        time.sleep(3)
        process = start(args, output, "--scheduler", address)
        time.sleep(0.5 * seconds)
        print("killed a worker:", process.poll() is None)
        running[1].kill()
        running.append(begin(worker))
        finish(process)
    finally:
        for one in reversed(running):
            one.kill()
            one.wait()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("input", nargs="+")
    parser.add_argument("--kills", type=int, default=10)
    parser.add_argument("--normals", action="store_true")
    parser.add_argument("--dask", action="store_true", help="only 1 process and Dask")
    args = parser.parse_args()
    first = args.folder / "stopped_first.psh"
    begin = time.monotonic()
    finish(start(args, first, "--workers", "1"))
    seconds = time.monotonic() - begin
    truth = checksum(first)
    print(f"1 process: {truth}", flush=True)
    same = True

    def compare(what: str, output: Path) -> None:
        nonlocal same
        found = checksum(output)
        same &= found == truth
        print(f"{what}: {found}, {'the same' if found == truth else 'ANOTHER'}", flush=True)
        output.unlink()

    other = args.folder / "stopped_other.psh"
    if not args.dask:
        for count in (2, 4):
            finish(start(args, other, "--workers", str(count), "--memory", "4G"))
            compare(f"{count} processes", other)
        kills = killed(args, other, seconds)
        compare(f"killed {kills} times", other)
    on_dask(args, other, seconds)
    compare("Dask, a worker killed", other)
    return 0 if same else 1


if __name__ == "__main__":
    sys.exit(main())
