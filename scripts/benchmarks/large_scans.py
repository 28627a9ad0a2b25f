"""What building a hierarchy takes: time by the clock and of processors, memory of all processes, bytes on disk.

    python -m scripts.benchmarks.large_scans OUTPUT.psh INPUT... [-- OPTIONS of scripts/points.py build]

Linux only: memory is the sum of the proportional set sizes of the build's processes, looked at five times a second.
"""

import resource
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAUSE = 0.2  # seconds


def processes_below(process: int) -> list[int]:
    """The process and its descendants."""
    found = [process]
    for one in found:
        try:
            tasks = list(Path(f"/proc/{one}/task").iterdir())
            for task in tasks:
                found += [int(child) for child in (task / "children").read_text().split()]
        except OSError:
            continue
    return found


def memory_of(process: int) -> int:
    """Bytes that a process and its descendants hold."""
    total = 0
    for one in processes_below(process):
        try:
            lines = Path(f"/proc/{one}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) << 10 for line in lines if line.startswith("Pss:"))
    return total


def size_of(folder: Path) -> int:
    try:
        return sum(path.stat().st_size for path in folder.iterdir())
    except OSError:
        return 0


def main() -> int:
    given, _, options = (list(part) for part in _split(sys.argv[1:]))
    output, inputs = Path(given[0]), given[1:]
    command = [sys.executable, str(ROOT / "scripts" / "points.py"), "build", *inputs, "--output", str(output), *options]
    begin = time.monotonic()
    process = subprocess.Popen(command)
    most = disk = looks = 0
    while process.poll() is None:
        most = max(most, memory_of(process.pid))
        if looks % 25 == 0:
            disk = max(disk, size_of(output.with_name(output.name + ".building")))
        looks += 1
        time.sleep(PAUSE)
    wall = time.monotonic() - begin
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"{wall:.1f} s by the clock, {used.ru_utime:.1f} + {used.ru_stime:.1f} s of processors (own and system), "
          f"{most / 1e6:,.0f} MB of memory at most, {disk / 1e6:,.0f} MB in the folder at most")  # fmt: skip
    return process.returncode


def _split(words: list[str]) -> tuple[list[str], list[str], list[str]]:
    at = words.index("--") if "--" in words else len(words)
    return words[:at], words[at : at + 1], words[at + 1 :]


if __name__ == "__main__":
    sys.exit(main())
