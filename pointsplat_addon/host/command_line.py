"""What `blender -b FILE -f N` and `-a`, as farms call them, ask of the engine beyond a picture."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..formats.whole_image import is_whole

WHOLE_ENDINGS = {".png", ".exr"}  # of files of which `is_whole` can tell
RENDER_OPTIONS = {"-f", "--render-frame", "-a", "--render-anim"}


def _draws_for_command_line() -> bool:
    """Whether the process's command line asked for pictures."""
    own = sys.argv[: sys.argv.index("--")] if "--" in sys.argv else sys.argv
    return not bpy.app.module and bpy.app.background and not RENDER_OPTIONS.isdisjoint(own)


def fail(message: str) -> None:
    """End a process whose command line asked for pictures, with exit code 1: Blender itself would write a black one and
    end with 0. Does nothing elsewhere.
    """
    if not _draws_for_command_line():
        return
    print(f"Error: frame {bpy.context.scene.frame_current}: {message}", flush=True)
    sys.stderr.flush()
    os._exit(1)


@persistent
def check_written(scene: bpy.types.Scene, _: object = None) -> None:
    """Leave no file behind that a full disk has cut off, and fail: Blender takes it for saved. A handler of
    `render_write`."""
    if scene.render.engine != "POINTSPLAT" or not _draws_for_command_line():
        return
    path = Path(bpy.path.abspath(scene.render.frame_path(frame=scene.frame_current)))
    if path.suffix.lower() in WHOLE_ENDINGS and path.is_file() and not is_whole(path):
        path.unlink()
        fail(f"the picture could not be written whole to {path.parent}; is it full?")


def register() -> None:
    bpy.app.handlers.render_write.append(check_written)


def unregister() -> None:
    bpy.app.handlers.render_write.remove(check_written)


def use_threads(render: bpy.types.RenderSettings) -> None:
    """Let Mesa draw with as many threads as Blender was told to take (-t N, or the scene's Threads Mode).

    To be called before the context is made. In the window, which shares its driver, nothing is changed."""
    if bpy.app.background and render.threads_mode == "FIXED":
        os.environ.setdefault("LP_NUM_THREADS", str(render.threads))
