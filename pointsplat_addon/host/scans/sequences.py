"""Numbered PLY files as one object whose points follow the scene's frame.

A group of geometry nodes reads the file of the frame, so that other engines draw it, too, and files that are saved,
loaded, or opened without this add-on keep it; renders in the background read each frame's file as they reach it.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...core.numeric.record import value_record
from ...core.surface.nearest import scan_spacing
from ...formats.points import ply
from ...formats.points.gather import Selection, gather
from ...formats.points.opening import open_points
from ...formats.points.reader import PointFileError
from ..convert.pointcloud import DEFAULT_RADIUS, VELOCITY
from .looks import look_material

ZEROS = "0" * 9  # before a file's number: as many digits as names of frames have at most
SPAN = 24  # bits of a float32


@value_record
class Frames:
    """Numbered files of one folder: those of one name and at least so many digits."""

    stem: str  # the path up to the number
    suffix: str
    digits: int  # of a padded number; 1: numbers are not padded
    numbers: tuple[int, ...]  # that exist, rising


def numbered_files(path: Path) -> Frames:
    """Returns the sequence that a file belongs to. Raises PointFileError where its name has no number at its end."""
    found = re.fullmatch(r"(.*?)(\d+)", path.stem)
    if found is None or len(found[2]) > len(ZEROS):
        raise PointFileError(
            path, "is not one of a sequence: its name does not end with a number, as in frame_0001.ply"
        )
    name, digits = found[1], len(found[2])
    same = re.compile(re.escape(name) + r"(\d+)" + re.escape(path.suffix))
    texts = [match[1] for item in path.parent.iterdir() if (match := same.fullmatch(item.name))]
    padded = any(text.startswith("0") and len(text) > 1 for text in (*texts, found[2]))
    least = digits if padded else 1
    numbers = sorted(int(text) for text in texts if len(text) == max(least, len(str(int(text)))))
    return Frames(f"{path.parent}{os.sep}{name}", path.suffix, least, tuple(numbers))


def import_sequence(context: Any, path: Path) -> tuple[bpy.types.Object, list[str]]:
    """Makes an object of the sequence that a PLY file belongs to; returns it, and warnings.

    Raises PointFileError and OSError; nothing is made then.
    """
    if path.suffix.lower() != ".ply":
        raise PointFileError(path, "is no PLY file: sequences are read from PLY files alone")
    if ply.kind_of(path) == "SPLATS":
        raise PointFileError(path, "holds captured Gaussian splats, not a scan: import it as such")
    frames = numbered_files(path)
    reader = open_points(path)
    try:
        columns = {attribute.name: attribute.source for attribute in reader.header.attributes}
        work = gather([reader], Selection(frozenset()))
        try:
            while True:
                next(work)
        except StopIteration as done:
            first = done.value
    finally:
        reader.close()
    warnings = _warnings(frames, first.origin, first.columns["position"])
    ob = bpy.data.objects.new(Path(frames.stem).name.strip(" ._-") or "Sequence", _empty_points())
    look = look_material(ob, "COLOR" if "color" in columns else "PLAIN")
    ob.data.materials.append(look)
    spacing = scan_spacing(first.columns["position"])
    group = _group(ob.name, frames, 0.5 * spacing or DEFAULT_RADIUS, look, columns.get(VELOCITY, ()))
    modifier = ob.modifiers.new("Sequence", "NODES")
    modifier.node_group = group
    context.collection.objects.link(ob)
    for other in context.selected_objects:
        other.select_set(False)
    context.view_layer.objects.active = ob
    ob.select_set(True)
    return ob, warnings


def _warnings(frames: Frames, origin: np.ndarray, position: np.ndarray) -> list[str]:
    """What a person should know of the files."""
    warnings = []
    first, last = frames.numbers[0], frames.numbers[-1]
    missing = last - first + 1 - len(frames.numbers)
    if missing:
        warnings.append(f"{missing:,} of the frames {first} to {last} have no file: nothing is drawn there")
    if len(position):
        farthest = float(np.abs(position + origin).max())
        if farthest > 1e5:
            warnings.append(
                f"Coordinates reach {farthest:,.0f}: sequences are read in single precision, which keeps them to "
                f"{farthest * 2.0**-SPAN:.2g}"
            )
    return warnings


def _empty_points() -> bpy.types.PointCloud:
    return bpy.data.pointclouds.new("Sequence")


def _group(
    name: str, frames: Frames, radius: float, material: bpy.types.Material, velocity: tuple[str, ...]
) -> bpy.types.NodeTree:
    """A group of geometry nodes that reads the file of the scene's frame. velocity: names of the files' columns."""
    tree = bpy.data.node_groups.new(f"{name} Sequence", "GeometryNodeTree")
    tree.is_modifier = True
    given = {
        "Path": ("NodeSocketString", frames.stem, "The files' path up to their number"),
        "Ending": ("NodeSocketString", frames.suffix, "What follows their number"),
        "Digits": ("NodeSocketInt", frames.digits, "Least number of digits; shorter numbers have zeros before them"),
        "First": ("NodeSocketInt", frames.numbers[0], "Number of the first file, which is shown before its frame"),
        "Last": ("NodeSocketInt", frames.numbers[-1], "Number of the last file, which is shown after its frame"),
        "Offset": ("NodeSocketInt", 0, "Number of the file that frame 0 shows"),
        "Radius": ("NodeSocketFloat", radius, "Radius of points that have no attribute radius"),
    }
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    for label, (kind, value, tip) in given.items():
        socket = tree.interface.new_socket(label, in_out="INPUT", socket_type=kind, description=tip)
        socket.default_value = value
    inputs = tree.nodes.new("NodeGroupInput").outputs

    def node(kind: str, *values: Any, **properties: Any) -> Any:
        """A node's first output; values: of its inputs that are available, in order, outputs being linked."""
        made = tree.nodes.new(kind)
        for key, value in properties.items():
            setattr(made, key, value)
        sockets = [socket for socket in made.inputs if socket.enabled]
        for socket, value in zip(sockets, values, strict=False):
            if isinstance(value, bpy.types.NodeSocket):
                tree.links.new(value, socket)
            else:
                socket.default_value = value
        return next(socket for socket in made.outputs if socket.enabled)

    def integer(operation: str, a: Any, b: Any) -> Any:
        return node("FunctionNodeIntegerMath", a, b, operation=operation)

    def joined(*texts: Any) -> Any:
        made = tree.nodes.new("GeometryNodeStringJoin")
        for text in reversed(texts):  # a socket of several links lists the last one first
            tree.links.new(text, made.inputs["Strings"])
        return made.outputs[0]

    time = tree.nodes.new("GeometryNodeInputSceneTime").outputs["Frame"]
    frame = node("FunctionNodeFloatToInt", time, rounding_mode="FLOOR")
    number = integer("ADD", frame, inputs["Offset"])
    number = integer("MINIMUM", integer("MAXIMUM", number, inputs["First"]), inputs["Last"])
    text = node("FunctionNodeValueToString", number, data_type="INT")
    length = node("FunctionNodeStringLength", text)
    size = integer("MAXIMUM", length, inputs["Digits"])
    zeros = node("FunctionNodeInputString", string=ZEROS)
    start = integer("SUBTRACT", integer("ADD", length, len(ZEROS)), size)
    padded = node("FunctionNodeSliceString", joined(zeros, text), start, size)
    mesh = node("GeometryNodeImportPLY", joined(inputs["Path"], padded, inputs["Ending"]))
    named = tree.nodes.new("GeometryNodeInputNamedAttribute")
    named.data_type = "FLOAT"
    named.inputs["Name"].default_value = "radius"
    own = node(
        "GeometryNodeSwitch", named.outputs["Exists"], inputs["Radius"], named.outputs["Attribute"], input_type="FLOAT"
    )
    points = tree.nodes.new("GeometryNodeMeshToPoints")
    tree.links.new(mesh, points.inputs["Mesh"])
    tree.links.new(own, points.inputs["Radius"])
    geometry = points.outputs[0]
    if velocity:
        parts = [node("GeometryNodeInputNamedAttribute", column, data_type="FLOAT") for column in velocity]
        whole = node("ShaderNodeCombineXYZ", *parts)
        stored = tree.nodes.new("GeometryNodeStoreNamedAttribute")
        stored.data_type, stored.domain = "FLOAT_VECTOR", "POINT"
        stored.inputs["Name"].default_value = VELOCITY
        tree.links.new(geometry, stored.inputs["Geometry"])
        tree.links.new(whole, next(s for s in stored.inputs if s.name == "Value" and s.enabled))
        geometry = stored.outputs[0]
    shown = tree.nodes.new("GeometryNodeSetMaterial")
    shown.inputs["Material"].default_value = material
    tree.links.new(geometry, shown.inputs["Geometry"])
    tree.links.new(shown.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    return tree
