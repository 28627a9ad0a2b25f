"""How a script that has loaded bpy ends."""

import os
import sys
import traceback
from collections.abc import Callable
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
