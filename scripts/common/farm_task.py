"""What one machine of a farm does: it draws a frame, or a part of one, in a process of its own, and puts it where the
film lies.
"""

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import uuid
from pathlib import Path

import distributed

ROOT = Path(__file__).resolve().parents[2]  # each machine's own
WHOLE = 0  # the "part" that is a frame
RENDERED, FAILED = 0, 1  # exit codes of render.py; others speak of the machine or of the arguments
LAST_LINES = 6  # of what a process said that says nothing of its end


def machine() -> str:
    return f"{socket.gethostname()}:{os.getpid()}"


def draw(job: dict, frame: int, part: int) -> dict:
    """Draw one frame of a film, or one part of it, unless it is there; what became of it.

    job: `file`, `output` (paths that every machine has), `folder` (of the farm's own files), `arguments` (further ones
    of render.py), `require` (version), `threads` (None: all), `parts` (of each frame) and perhaps `prepare` (others
    wait for what this one leaves in the shared caches). part: its number from 1 on;
    WHOLE for the frame, which is joined where it has parts.
    Returns "state": "drawn", "there" (another machine was first), "failed" (the render raised) or "refused" (this
    machine cannot draw it), with "machine", "begun" and "ended" (seconds since 1970 of this machine's clock),
    "processor" (seconds of processor time, where the system counts it), and "message" or "report".
    """
    begun, before = time.time(), os.times()
    found = {
        "frame": frame,
        "part": part,
        "machine": machine(),
        "address": distributed.get_worker().address,
        "begun": begun,
    }
    try:
        found |= {"state": "there"} if is_there(job, frame, part) else _drawn(job, frame, part)
    except OSError as error:
        found |= {"state": "refused", "message": f"{type(error).__name__}: {error}"}
    after = os.times()
    spent = after.children_user + after.children_system - before.children_user - before.children_system
    return found | {"ended": time.time(), "processor": spent}


def picture(output: Path, frame: int) -> Path:
    """The file of a frame, as render.py numbers it."""
    return output.with_name(f"{output.stem}_{frame:04d}{output.suffix}")


def is_there(job: dict, frame: int, part: int) -> bool:
    return (picture(Path(job["output"]), frame) if part == WHOLE else _report_path(job, frame, part)).exists()


def _parts(job: dict, frame: int) -> Path:
    return Path(job["folder"]) / f"{frame:04d}.parts"


def _report_path(job: dict, frame: int, part: int) -> Path:
    return Path(job["folder"]) / f"{frame:04d}.json" if part == WHOLE else _parts(job, frame) / f"{part}.json"


def _drawn(job: dict, frame: int, part_number: int) -> dict:
    folder, target = Path(job["folder"]), picture(Path(job["output"]), frame)
    # Beside the film, so that renaming moves no bytes; unknown to others, so that nobody else writes there.
    part = folder / "parts" / f"{uuid.uuid4().hex}{target.suffix}"
    told = part.with_suffix(".json")
    part.parent.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, str(ROOT / "scripts" / "render.py"), job["file"], "--output", str(part)]
    command += ["--frame", str(frame), "--report", str(told), "--cache", str(folder / "cache")]
    command += ["--strict", "--require", job["require"], "--end-with-input", *job["arguments"]]
    command += ["--threads", str(job["threads"])] if job["threads"] else []
    command += ["--prepare"] if job.get("prepare") else []
    if job["parts"] > 1:
        how = ["--join", str(job["parts"])] if part_number == WHOLE else ["--part", f"{part_number}/{job['parts']}"]
        command += [*how, "--parts", str(_parts(job, frame))]
    try:
        code, said = _run(command)
        if code != RENDERED:
            return {"state": "failed" if code == FAILED else "refused", "message": _reason(code, said)}
        report = json.loads(told.read_text(encoding="utf-8"))
        record = {"frame": frame, "machine": machine(), "report": report}
        write(_report_path(job, frame, part_number), json.dumps(record, indent=1))
        first = part_number != WHOLE or publish(part, target)
        if part_number == WHOLE:
            shutil.rmtree(_parts(job, frame), ignore_errors=True)
        return {"state": "drawn" if first else "there", "report": report}
    finally:
        for path in (part, told):
            with contextlib.suppress(OSError):
                path.unlink(missing_ok=True)


def _run(command: list[str]) -> tuple[int, str]:
    """(exit code, what was said) of a process that ends when this one does, however that ends."""
    # A pipe that nobody writes to: its end closes with this process, even where that is killed.
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    )
    assert process.stdout is not None
    with process:
        said = process.stdout.read()
    return process.returncode, said


def _reason(code: int, said: str) -> str:
    """Why a process ended, from the lines in which render.py says so, else from the last ones."""
    lines = said.strip().splitlines()
    own = [line.removeprefix("render: ") for line in lines if line.startswith("render: ")]
    own = [line for line in own if not line.startswith("warning: ")]
    if code < 0:
        return f"the process was ended by {signal.Signals(-code).name}; it said last: {' | '.join(lines[-LAST_LINES:])}"
    return "\n".join(own or lines[-LAST_LINES:])


def publish(part: Path, target: Path) -> bool:
    """Give a whole file its name; False if that name is taken, so that each frame is written once."""
    try:
        os.link(part, target)  # unlike renaming, it never replaces
    except FileExistsError:
        return False
    except OSError:  # a file system without links
        if target.exists():
            return False
        os.replace(part, target)
    return True


def write(path: Path, text: str) -> None:
    """Write a text file that readers see whole or not at all. OSError: it cannot be written."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        with part.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
