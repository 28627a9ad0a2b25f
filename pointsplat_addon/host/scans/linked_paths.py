"""Keeps the relative paths of linked scans right when the .blend is saved elsewhere, as Blender does for its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

_before: dict[str, str] = {}  # paths by object, before the file that is being saved got others
_saved_from = ""


def linked_objects() -> list[bpy.types.Object]:
    """The objects of this file that refer to scans."""
    return [ob for ob in bpy.data.objects if ob.library is None and ob.pointsplat.scan_path]


@bpy.app.handlers.persistent
def on_save(path: Any, *_arguments: object) -> None:
    """Makes relative paths count from where the file is going to be; when it is saved for the first time, all paths."""
    global _saved_from
    _before.clear()
    _saved_from = bpy.data.filepath
    if not isinstance(path, str) or not path:
        return
    target, source = Path(path).parent, Path(_saved_from).parent if _saved_from else None
    if target == source:
        return
    relative = bpy.context.preferences.filepaths.use_relative_paths
    for ob in linked_objects():
        stored = ob.pointsplat.scan_path
        if (stored.startswith("//") and source is not None) or (
            source is None and relative and Path(stored).is_absolute()
        ):
            _before[ob.name] = stored
            try:
                ob.pointsplat.scan_path = bpy.path.relpath(bpy.path.abspath(stored), start=str(target))
            except ValueError:  # another drive
                ob.pointsplat.scan_path = bpy.path.abspath(stored)


@bpy.app.handlers.persistent
def on_saved(*_arguments: object) -> None:
    """Gives a file that is still where it was, for a copy of it was saved, or none, its paths again."""
    if bpy.data.filepath == _saved_from:
        for name, stored in _before.items():
            if (ob := bpy.data.objects.get(name)) is not None:
                ob.pointsplat.scan_path = stored
    _before.clear()


HANDLERS = (("save_pre", on_save), ("save_post", on_saved), ("save_post_fail", on_saved))


def register() -> None:
    for name, handler in HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    for name, handler in HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
