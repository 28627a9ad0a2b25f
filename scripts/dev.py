#!/usr/bin/env python3
"""Makes the environment and runs what a developer needs, with nothing but a plain Python.

    python3 scripts/dev.py render     the demo scene, drawn by PointSplat: out/demo.png and out/demo.json
    python3 scripts/dev.py test       the tests (--python 3.11|3.13|all, --long, --jobs N, then pytest's own arguments)
    python3 scripts/dev.py build      the extension: dist/pointsplat-<version>.zip
    python3 scripts/dev.py lint       ruff and pyright
    python3 scripts/dev.py benchmark  every benchmark (scripts/benchmarks), with what it compares against
    python3 scripts/dev.py env        only the environment

Blender comes as the package bpy, which needs Python 3.11 (Blender 4.5 LTS) or 3.13 (Blender 5.2 LTS).
Environments live in .venv/, pinned by requirements/. Exit codes: 0 done, 1 failed, 2 not possible here.
"""

import argparse
import concurrent.futures
import ctypes
import glob
import hashlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time

# ruff: noqa: RUF005, UP031 (this file is read by whatever Python a machine has, so it keeps to what 3.8 understands)
ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
BLENDER_FOR_PYTHON = {"3.11": "4.5 LTS", "3.13": "5.2 LTS"}
PASSED, NO_TESTS = 0, 5  # pytest's exit codes
LIMIT, LONG_LIMIT = 1800, 4 * 3600  # seconds that a process of tests may take
BESIDE_CYCLES = 6  # processes for the files of tests beside Cycles
# Seconds that groups of tests take on one core, where they are many: which to begin first.
SECONDS = {
    "tests/render/passes": 300,
    "tests/extreme": 260,
    "tests/core": 200,
    "tests/render/visibility": 170,
    "tests/render/budget": 150,
    "tests/render/frame": 110,
    "tests/render/prepare": 80,
    "tests/render/indirect": 70,
    "tests/blender/test_render_script.py": 50,
    "tests/blender/test_soak_blender.py": 50,
    "tests/blender/test_technique_devices.py": 45,
    "tests/blender/test_worlds_cycles.py": 40,
    "tests/blender/test_motion_blur.py": 40,
    "tests/render/plan": 40,
    "tests/blender/test_lights.py": 35,
    "tests/blender/test_lens_cycles.py": 30,
    "tests/blender/test_devices_agree.py": 30,
    "tests/blender/test_shadow_catchers_cycles.py": 30,
    "tests/render/shadow": 30,
    "tests/blender/test_silhouettes_cycles.py": 20,
    "tests/blender/test_light_passes_cycles.py": 20,
    "tests/blender/test_reflection_cycles.py": 20,
}

# What bpy links to, and what it and moderngl open at run time, with the Debian package of each.
LIBRARIES = {
    "libX11.so.6": "libx11-6",
    "libXext.so.6": "libxext6",
    "libXfixes.so.3": "libxfixes3",
    "libXi.so.6": "libxi6",
    "libXrender.so.1": "libxrender1",
    "libXxf86vm.so.1": "libxxf86vm1",
    "libxkbcommon.so.0": "libxkbcommon0",
    "libSM.so.6": "libsm6",
    "libICE.so.6": "libice6",
    "libGL.so.1": "libgl1",
    "libEGL.so.1": "libegl1",
}
# libEGL.so.1 only dispatches; a context needs a driver behind it. These bring Mesa's, which also draws without a GPU.
DRIVER_PACKAGES = ["libegl-mesa0", "libgl1-mesa-dri", "libglx-mesa0"]
EGL_PROBE = "import moderngl; print(moderngl.create_context(standalone=True, backend='egl').info['GL_RENDERER'])"


class ImpossibleError(Exception):
    """What was asked cannot be done on this machine as it is; the message says why and what would help."""


def say(text):
    print("dev: " + text, flush=True)


# ---------------------------------------------------------------------------- Python


def probe(python):
    """(version "3.11", can make environments) of an interpreter, or None if it does not run."""
    code = "import sys, importlib.util as u; print('%d.%d' % sys.version_info[:2], bool(u.find_spec('ensurepip')))"
    try:
        out = subprocess.run(
            [python, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=60, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    words = out.stdout.decode().split()
    return (words[0], words[1] == "True") if len(words) == 2 else None


def interpreter(version):
    """(path, can make environments) of an interpreter of that version, or None; one that can is preferred."""
    pyenv = os.environ.get("PYENV_ROOT") or os.path.expanduser("~/.pyenv")
    candidates = [getattr(sys, "_base_executable", sys.executable) or sys.executable]
    candidates += [os.path.join(d, "python" + version) for d in os.get_exec_path()]
    candidates += [os.path.join(d, "python3") for d in os.get_exec_path()]
    candidates += sorted(glob.glob(os.path.join(pyenv, "versions", version + ".*", "bin", "python" + version)))
    candidates += sorted(
        glob.glob(os.path.expanduser("~/.local/share/uv/python/cpython-" + version + ".*/bin/python3"))
    )
    second_choice = None
    for path in candidates:
        if not os.access(path, os.X_OK) or os.path.isdir(path):
            continue
        found = probe(path)
        if found and found[0] == version:
            if found[1]:
                return path, True
            second_choice = second_choice or (path, False)
    return second_choice


def venv_python(version):
    folder = os.path.join(ROOT, ".venv", "py" + version.replace(".", ""))
    return os.path.join(folder, "Scripts", "python.exe") if os.name == "nt" else os.path.join(folder, "bin", "python")


def available(version):
    found = probe(venv_python(version))
    return bool(found and found[0] == version) or interpreter(version) is not None


def chosen_versions(wish):
    """Python versions to use: one ("3.11"), every one that the machine has ("all"), or the first of them (None)."""
    if wish in BLENDER_FOR_PYTHON and available(wish):
        return [wish]
    versions = [v for v in BLENDER_FOR_PYTHON if available(v)] if wish in (None, "all") else []
    if not versions:
        here = "%d.%d" % sys.version_info[:2]
        asked = "Python " + wish if wish in BLENDER_FOR_PYTHON else "Python 3.11 (Blender 4.5) or 3.13 (Blender 5.2)"
        raise ImpossibleError(
            "this needs %s, because Blender's package bpy exists for those only. Neither PATH nor pyenv has it; "
            "this is Python %s.\n  Debian 12: apt-get install python3.11 python3.11-venv"
            "\n  Debian 13: apt-get install python3.13 python3.13-venv"
            "\n  Ubuntu and elsewhere: pyenv install 3.13, or uv python install 3.13" % (asked, here)
        )
    return versions if wish == "all" else versions[:1]


# ---------------------------------------------------------------------------- environment


def run(command, **options):
    """Run a command in the repository's root; its exit code."""
    return subprocess.call(command, cwd=ROOT, **options)


def apt_install(packages, why):
    """Install Debian packages as root or with sudo; where that is not possible, say the command."""
    command = ["apt-get", "install", "-y", "--no-install-recommends"] + packages
    if not shutil.which("apt-get"):
        raise ImpossibleError("%s. On Debian and Ubuntu the packages are: %s" % (why, " ".join(packages)))
    prefix = []
    if os.geteuid() != 0:
        prefix = ["sudo"]
        may_ask = sys.stdin is not None and sys.stdin.isatty()
        if not shutil.which("sudo") or not (may_ask or run(["sudo", "-n", "true"], stderr=subprocess.DEVNULL) == 0):
            raise ImpossibleError("%s. Please run, as root: %s" % (why, " ".join(command)))
    say("%s. Running: %s" % (why, " ".join(prefix + command)))
    environment = dict(os.environ, DEBIAN_FRONTEND="noninteractive")
    run(prefix + ["apt-get", "update", "-q"], env=environment)
    if run(prefix + command, env=environment) != 0:
        raise ImpossibleError("apt-get could not install: " + " ".join(packages))


def install(python, requirements):
    """Install a requirements file into an environment, unless its stamp says that this was done."""
    with open(os.path.join(ROOT, "requirements", requirements), "rb") as file:
        wanted = hashlib.sha256(file.read()).hexdigest()
    stamp = os.path.join(os.path.dirname(os.path.dirname(python)), requirements + ".sha256")
    if os.path.exists(stamp):
        with open(stamp) as file:
            if file.read() == wanted:
                return
    size = " (bpy alone is 400 MB)" if requirements.startswith("py") else ""
    say("installing requirements/%s into %s" % (requirements, os.path.relpath(python, ROOT)) + size)
    pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    if run(pip + ["-r", os.path.join("requirements", requirements)]) != 0:
        raise ImpossibleError("pip could not install requirements/" + requirements)
    with open(stamp, "w") as file:
        file.write(wanted)


def bare_environment(version):
    """The interpreter of .venv/pyXYZ, made where needed."""
    python = venv_python(version)
    found = probe(python)
    if not found or found[0] != version:
        choice = interpreter(version)
        if choice is None:
            raise ImpossibleError("this machine has no Python %s" % version)
        base, can_make_environments = choice
        if not can_make_environments:
            apt_install(["python%s-venv" % version], "%s cannot make virtual environments" % base)
        folder = os.path.dirname(os.path.dirname(python))
        say("making %s with %s" % (os.path.relpath(folder, ROOT), base))
        if run([base, "-m", "venv", "--clear", folder]) != 0:
            raise ImpossibleError("%s could not make a virtual environment" % base)
    return python


def environments(versions):
    """The interpreters of .venv/pyXYZ, made and filled where needed, side by side: each waits for its downloads."""
    pythons = [bare_environment(version) for version in versions]
    requirements = ["py" + version.replace(".", "") + ".txt" for version in versions]
    with concurrent.futures.ThreadPoolExecutor() as threads:
        list(threads.map(install, pythons, requirements))
    return pythons


def unopenable():
    """Names of the needed system libraries that the loader cannot open."""
    missing = []
    for name in LIBRARIES:
        try:
            ctypes.CDLL(name)
        except OSError:
            missing.append(name)
    return missing


def check_system(python):
    """Make sure that bpy can load and that an OpenGL context can be made; install what is missing on Debian."""
    if not sys.platform.startswith("linux"):
        return
    missing = unopenable()
    if missing:
        apt_install([LIBRARIES[name] for name in missing], "this machine lacks " + ", ".join(missing))
        missing = unopenable()
        if missing:
            raise ImpossibleError("still missing: " + ", ".join(missing))
    if run([python, "-c", EGL_PROBE], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) != 0:
        apt_install(DRIVER_PACKAGES, "no OpenGL context can be made through EGL: a driver is missing")
        if run([python, "-c", EGL_PROBE], stdout=subprocess.DEVNULL) != 0:
            raise ImpossibleError("no OpenGL context can be made through EGL; the error stands above")


def ready(wish):
    """Interpreters of ready environments, checked against the system."""
    pythons = environments(chosen_versions(wish))
    check_system(pythons[0])
    return pythons


# ---------------------------------------------------------------------------- verbs


def render(args, rest):
    python = ready(args.python)[0]
    os.makedirs(os.path.join(ROOT, "out"), exist_ok=True)
    scene, picture, report = (os.path.join("out", "demo" + end) for end in (".blend", ".png", ".json"))
    steps = [
        ["-m", "scripts.demos.park", "--output", scene],
        ["scripts/render.py", scene, "--output", picture, "--report", report] + rest,
    ]
    for step in steps:
        if run([python] + step) != 0:
            say("failed: " + step[0])
            return 1
    say("the picture is %s, its report is %s" % (picture, report))
    return 0


def build(args, rest):
    return run([ready(args.python)[0], "scripts/build_extension.py"] + rest)


def lint(args, rest):
    python = environments(chosen_versions(args.python)[:1])[0]
    install(python, "lint.txt")
    commands = [
        [python, "-m", "ruff", "check"],
        [python, "-m", "ruff", "format", "--check"],
        [python, "-m", "pyright", "--pythonpath", python],
    ]
    failed = []
    for command in commands:
        say(" ".join(command[2:]))
        if run(command + rest) != 0:
            failed.append(command[2])
    if failed:
        say("failed: " + ", ".join(sorted(set(failed))))
    return 1 if failed else 0


def cost_of(paths):
    """Seconds that a group of tests takes, roughly: long ones are begun first."""
    return sum(SECONDS.get(path.replace(os.sep, "/"), 10) for path in paths)


def dealt(files):
    """Groups of files, each dealt to the group that takes the least time so far, the longest first."""
    groups = [[] for _ in range(min(BESIDE_CYCLES, len(files)))]
    for file in sorted(files, key=lambda file: (-cost_of([file]), file)):
        min(groups, key=cost_of).append(file)
    return groups


def test_groups(arguments):
    """Split pytest's arguments into options and groups of paths, each group for one process; the longest come first.

    The rooms of tests/render have one each, so that none needs the memory of two; the extreme cases always have their
    own, of which they measure the memory. So has every file that loads bpy, whose state cannot be reset, but those
    beside Cycles: each of their tests begins with an empty file, and some files that share a process load bpy once.
    """
    is_path = [os.path.exists(os.path.join(ROOT, a.split("::")[0])) and not a.startswith("-") for a in arguments]
    options = [a for a, path in zip(arguments, is_path) if not path]  # noqa: B905 (Python 3.8 has no strict)
    paths = [a for a, path in zip(arguments, is_path) if path] or ["tests"]  # noqa: B905
    plain, groups = [], []
    for path in paths:
        name = os.path.relpath(os.path.join(ROOT, path), ROOT)
        whole = name == "tests"
        parts = [name]
        if whole:
            folders = sorted(
                set(map(os.path.dirname, glob.glob(os.path.join(ROOT, "tests", "render", "*", "test_*.py"))))
            )
            parts = [os.path.relpath(folder, ROOT) for folder in folders]
            rooms = ("core", "formats", "stream", "reference", "scripts", "extreme", "blender")
            parts += [os.path.join(name, room) for room in rooms]
        for part in parts:
            if part.startswith(os.path.join("tests", "blender")):
                is_folder = os.path.isdir(os.path.join(ROOT, part))
                files = glob.glob(os.path.join(part, "**", "test_*.py"), recursive=True) if is_folder else [part]
                beside = [f for f in files if f.endswith("_cycles.py")]
                groups += [[file] for file in sorted(set(files) - set(beside))] + dealt(beside)
            elif part.startswith((os.path.join("tests", "extreme"), os.path.join("tests", "render"))):
                groups.append([part])
            else:
                plain.append(part)
    groups += [plain] if plain else []
    return options, sorted(groups, key=cost_of, reverse=True)


def in_turns(groups, pythons):
    """(group, which Python) of each process, so that the Pythons begin each two groups the other way about: both draw
    much with the same shaders, which the first one compiles and Mesa keeps; side by side both would compile them."""
    tasks = []
    for first in range(0, len(groups), 2):
        for turn in range(pythons):
            tasks += [(group, (turn + i) % pythons) for i, group in enumerate(groups[first : first + 2])]
    return tasks


class Process:
    """One pytest process over a group of paths, whose output is kept until it ends."""

    def __init__(self, task, limit, environment):
        python, options, paths = self.task = task
        self.name = "%s %s" % (os.path.relpath(python, ROOT), " ".join(paths))
        self.limit, self.begin = limit, time.monotonic()
        self.output = tempfile.TemporaryFile()  # noqa: SIM115 (it lives as long as the process)
        command = [python, "-m", "pytest", "-o", "faulthandler_timeout=%d" % (limit // 2)] + options + paths
        self.process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=self.output, stderr=subprocess.STDOUT, start_new_session=True
        )

    def ended(self):
        """Its exit code, or None while it runs. A process that outlives its limit is killed."""
        code = self.process.poll()
        if code is None and time.monotonic() - self.begin > self.limit:
            self.kill()
            say("killed after %d s: %s" % (self.limit, self.name))
            return 1
        return code

    def kill(self):
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()

    def print_output(self):
        say("%s (%d s)" % (self.name, time.monotonic() - self.begin))
        self.output.seek(0)
        sys.stdout.write(self.output.read().decode(errors="replace"))
        sys.stdout.flush()
        self.output.close()


def test_environment(jobs):
    """Variables for a process of tests, beside which others run; what is set stays."""
    environment = dict(os.environ)
    # llvmpipe draws with all cores; processes side by side would fight for them.
    environment.setdefault("LP_NUM_THREADS", str(max(1, (os.cpu_count() or 1) // jobs)))
    # Each process finds the modules that one before has compiled, also where Python is told to leave no files.
    environment.setdefault("PYTHONPYCACHEPREFIX", os.path.join(ROOT, ".venv", "bytecode"))
    environment.pop("PYTHONDONTWRITEBYTECODE", None)
    # glibc keeps large arrays that were let go, for the next: else the system clears all of their pages each time.
    environment.setdefault("MALLOC_MMAP_MAX_", "0")
    environment.setdefault("MALLOC_TRIM_THRESHOLD_", str(1 << 32))
    return environment


def run_all(tasks, jobs, limit):
    """Run (python, options, paths) in so many processes at a time; (name, exit code) of each, as they end.

    One that a signal ends runs once more: Mesa 22.3's llvmpipe crashes in one of some hundred processes, each time at
    another draw. What crashes twice has failed.
    """
    environment = test_environment(jobs)
    waiting, running, found, crashed = list(tasks), [], [], set()
    begun = 0
    try:
        while waiting or running:
            while waiting and len(running) < jobs:
                running.append(Process(waiting.pop(0), limit, environment))
                if running[-1].name not in crashed:
                    begun += 1
                say("started %s (%d of %d)" % (running[-1].name, begun, len(tasks)))
            time.sleep(0.1)
            for process in list(running):
                code = process.ended()
                if code is not None:
                    running.remove(process)
                    process.print_output()
                    if code < 0 and process.name not in crashed:
                        say("CRASHED by signal %d, and runs once more: %s" % (-code, process.name))
                        crashed.add(process.name)
                        waiting.insert(0, process.task)
                    else:
                        found.append((process.name, code))
    finally:
        for process in running:
            process.kill()
    return found


def test(args, rest):
    pythons = ready(args.python)
    os.chdir(ROOT)
    options, groups = test_groups(rest)
    if not args.long and "-m" not in options:
        options = ["-m", "not long"] + options
        say("tests that take minutes are deselected: --long runs them too")
    shares = [[] for _ in pythons]
    if not args.long and len(pythons) > 1:
        shares = [["--share", "%d/%d" % (i, len(pythons))] for i in range(len(pythons))]
        say("tests that hardly depend on Blender and Python run with one Python each: --long runs all with each")
    tasks = [(pythons[i], options + shares[i], paths) for paths, i in in_turns(groups, len(pythons))]
    found = run_all(tasks, args.jobs or min(2, os.cpu_count() or 1), args.limit or (LONG_LIMIT if args.long else LIMIT))
    # A file whose tests are all deselected is no failure, as long as some other ran.
    failed = ["%s (exit code %d)" % (name, code) for name, code in found if code not in (PASSED, NO_TESTS)]
    ran = any(code == PASSED for _, code in found)
    for line in sorted(failed):
        say("FAILED " + line)
    if not failed:
        say("all passed" if ran else "no test ran")
    return 0 if ran and not failed else 1


def benchmark(args, rest):
    python = ready(args.python)[0]
    install(python, "benchmark.txt")
    return run([python, "-m", "scripts.benchmarks"] + rest)


def env(args, rest):
    pythons = ready(args.python)
    if args.lint:
        install(pythons[0], "lint.txt")
    for python in pythons:
        say("ready: " + os.path.relpath(python, ROOT))
    return 0


VERBS = {"render": render, "test": test, "build": build, "lint": lint, "benchmark": benchmark, "env": env}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("verb", choices=sorted(VERBS), help="what to do; further arguments are handed on")
    parser.add_argument("--python", choices=sorted(BLENDER_FOR_PYTHON) + ["all"], help="default: the first there is")
    parser.add_argument("--lint", action="store_true", help="env: also what lint needs")
    parser.add_argument("--long", action="store_true", help="test: also the tests that take minutes")
    parser.add_argument("--jobs", type=int, help="test: processes at a time (default: 2, or 1 on one core)")
    parser.add_argument("--limit", type=int, help="test: seconds until a test process is killed")
    args, rest = parser.parse_known_args()
    # As an exception, so that `finally` ends the processes of tests, which have sessions of their own.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        return VERBS[args.verb](args, rest)
    except ImpossibleError as reason:
        say(str(reason))
        return 2


if __name__ == "__main__":
    sys.exit(main())
