"""What `blender -b FILE -f N` and `-a`, as farms call them, ask of the engine beyond a picture."""

from __future__ import annotations

import os
import sys

import bpy

RENDER_OPTIONS = {"-f", "--render-frame", "-a", "--render-anim"}


def fail(message: str) -> None:
    """End a process whose command line asked for pictures, with exit code 1: Blender itself would write a black one and
    end with 0. Does nothing elsewhere.
    """
    own = sys.argv[: sys.argv.index("--")] if "--" in sys.argv else sys.argv
    if bpy.app.module or not bpy.app.background or RENDER_OPTIONS.isdisjoint(own):
        return
    print(f"Error: frame {bpy.context.scene.frame_current}: {message}", flush=True)
    sys.stderr.flush()
    os._exit(1)


def use_threads(render: bpy.types.RenderSettings) -> None:
    """Let Mesa draw with as many threads as Blender was told to take (-t N, or the scene's Threads Mode).

    To be called before the context is made. In the window, which shares its driver, nothing is changed."""
    if bpy.app.background and render.threads_mode == "FIXED":
        os.environ.setdefault("LP_NUM_THREADS", str(render.threads))
