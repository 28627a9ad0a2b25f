"""How a script that has loaded bpy ends, and how processes begin whose start is measured."""

import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn


def run(main: Callable[[], int | None]) -> NoReturn:
    """Call `main` and leave with its exit status (None: 0), or 1 and a traceback where it raised.

    Blender 4.5 does not come back from the interpreter's own shutdown while an engine is registered.
    """
    status = 1
    try:
        status = main() or 0
    except Exception:
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def environment(bytecode: Path, shader_cache: bool = True) -> dict[str, str]:
    """The environment of a process whose start is measured.

    bytecode: the folder where it finds its modules compiled once another process has run with it, as those of an
    installed extension are, whatever the caller's own environment says. shader_cache: shaders that Mesa's driver has
    compiled for an earlier process are at hand; else all are compiled, as by the very first on a machine.
    """
    changed = {**os.environ, "PYTHONPYCACHEPREFIX": str(bytecode)}
    changed.pop("PYTHONDONTWRITEBYTECODE", None)
    if not shader_cache:
        changed["MESA_SHADER_CACHE_DISABLE"] = "true"
    return changed
