"""A lock among processes: one holds it at a time, and a killed owner leaves it free."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from pointsplat_addon.formats.file_lock import held

ROOT = Path(__file__).resolve().parents[2]

# Says when it holds the lock, and goes on when it is told to.
OWNER = """
import sys
from pathlib import Path
from pointsplat_addon.formats.file_lock import held
with held(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.readline()
print("free", flush=True)
"""

# Between reading a number and writing the next one others would read the same one.
COUNTS = """
import sys, time
from pathlib import Path
from pointsplat_addon.formats.file_lock import held
lock, count = map(Path, sys.argv[1:])
for _ in range(20):
    with held(lock):
        before = int(count.read_text())
        time.sleep(0.002)
        count.write_text(str(before + 1))
"""


def start(code: str, *arguments: Path) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", code, *map(str, arguments)]
    return subprocess.Popen(command, cwd=ROOT, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)


def next_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def test_processes_hold_it_one_after_another(tmp_path: Path) -> None:
    count = tmp_path / "count"
    count.write_text("0")
    workers = [start(COUNTS, tmp_path / "new" / "a.lock", count) for _ in range(3)]
    assert [worker.wait(60) for worker in workers] == [0, 0, 0]
    assert count.read_text() == "60"


def test_a_killed_owner_leaves_it_free(tmp_path: Path) -> None:
    lock = tmp_path / "a.lock"
    owner, other = start(OWNER, lock), None
    try:
        assert next_line(owner) == "held"
        other = start(OWNER, lock)
        time.sleep(0.5)
        os.kill(owner.pid, signal.SIGKILL)
        assert next_line(other) == "held"
    finally:
        for process in (owner, other):
            if process is not None:
                process.kill()
                process.communicate()


def test_where_nothing_can_be_locked_work_goes_on(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    with held(tmp_path / "file" / "a.lock"):
        pass
