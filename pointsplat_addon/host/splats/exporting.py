"""Exports captured splats as modifiers leave them, in the axes of a format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.scene.captured import CapturedSplats
from ...formats.splats.axes import Y_DOWN, Y_UP, blender_from
from ...formats.splats.writing.ply import write_ply
from ...formats.splats.writing.spz import write_spz
from ...formats.splats.writing.transform import transformed
from ..convert.captured import ANTIALIASED, is_captured, read_captured

AXES = {".ply": Y_DOWN, ".spz": Y_UP}
SAME = 1e-6  # of a transform's numbers, which are float32 in Blender: nothing is computed for smaller ones


class NothingToExportError(ValueError):
    """There are no splats; the message says where."""


def export_file(
    context: Any, path: Path, objects: Sequence[bpy.types.Object], version: int = 3
) -> tuple[int, list[str]]:
    """Writes the splats of objects into one file, by their evaluated transforms; returns how many, and warnings.

    Raises NothingToExportError, PointFileError and OSError; no file is made then.
    """
    axes = AXES[path.suffix.lower()]
    depsgraph = context.evaluated_depsgraph_get()
    file_from_world = np.eye(4)
    file_from_world[:3, :3] = blender_from(axes).T
    parts, warnings = [], []
    for ob in objects:
        evaluated = ob.evaluated_get(depsgraph)
        found = None
        if is_captured(evaluated.data):
            found = read_captured(evaluated.data, bool(ob.get(ANTIALIASED, False)), lambda _, make: make())
        if found is None:
            continue
        _, splats, messages = found
        matrix = file_from_world @ np.array(evaluated.matrix_world, np.float64)
        exact = True
        if np.abs(matrix - np.eye(4)).max() > SAME:
            splats, exact = transformed(splats, matrix)
        if not exact:
            messages = (
                *messages,
                "its scale is uneven: colours that depend on the view are turned by the nearest rotation",
            )
        warnings += [f"{ob.name}: {message}" for message in messages]
        parts.append(splats)
    if not parts:
        raise NothingToExportError("No object that is selected holds captured splats")
    whole = joined(parts)
    if path.suffix.lower() == ".spz":
        warnings += write_spz(path, whole, version)
    else:
        write_ply(path, whole)
    return len(whole), warnings


def joined(parts: Sequence[CapturedSplats]) -> CapturedSplats:
    """Returns all splats, with as many coefficients as any of them has and the first one's origin."""
    if len(parts) == 1:
        return parts[0]
    most = max(0 if part.sh is None else part.sh.shape[1] for part in parts)
    first = parts[0].origin
    moved = [replace(part, position=(part.position + (part.origin - first)).astype(np.float32)) for part in parts]
    names = "position", "scale", "rotation", "base", "opacity"
    arrays = {name: np.concatenate([getattr(part, name) for part in moved]) for name in names}
    sh = None
    if most:
        sh = np.zeros((len(arrays["opacity"]), most, 3), np.float32)
        at = 0
        for part in parts:
            if part.sh is not None:
                sh[at : at + len(part), : part.sh.shape[1]] = part.sh
            at += len(part)
    return CapturedSplats(**arrays, sh=sh, origin=first, antialiased=all(part.antialiased for part in parts))
