"""Evaluated meshes of Blender as triangle meshes of core."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ...core.scene.mesh import Mesh
from . import arrays
from .arrays import READABLE_TYPES, attribute_as_color

ROUNDED = 1e-6  # of coordinates, within which places are the same
Lookup = Callable[[str, Callable[[], Mesh]], Mesh]  # the mesh of a content key, made only if it is not known


def read_mesh(
    mesh: bpy.types.Mesh,
    name: str,
    rows: tuple[int, ...],
    wanted: frozenset[str | None] | None,
    lookup: Lookup,
    use_generated: bool = False,
) -> Mesh | None:
    """The triangles of an evaluated mesh in object space; None if it has no faces.

    rows: row of each material slot in the scene's table; faces with a slot beyond the last use the last.
    wanted: names of the colour and other attributes that the materials read, where a None among them is the
    default colour attribute; None instead of a set: all colours.
    UV maps are always read. lookup: gives the known mesh of a content key, so that unchanged arrays are digested
    (30 MB for a million triangles) but neither triangulated nor expanded. use_generated: the materials read
    generated coordinates.
    """
    if len(mesh.polygons) == 0:
        return None
    position = arrays.values(mesh.attributes["position"], 3, np.float32)
    corner_vert = arrays.values(mesh.attributes[".corner_vert"], 1, np.int32)
    offsets = arrays.view(mesh.polygons, (len(mesh.polygons) + 1,), np.int32)
    slot = _slots(mesh, len(rows))
    smooth = mesh.normals_domain == "POINT"
    if smooth:
        normal = arrays.view(mesh.vertex_normals, (len(mesh.vertices), 3), np.float32)
    else:
        normal = arrays.view(mesh.corner_normals, (len(mesh.loops), 3), np.float32)
    uv = {m.name: arrays.values(mesh.attributes[m.name], 2, np.float32) for m in mesh.uv_layers}
    active = next((m.name for m in mesh.uv_layers if m.active_render), None)
    colors = _read_colors(mesh, wanted, offsets)
    generated = _generated(mesh, position) if use_generated else None

    def build() -> Mesh:
        of_triangles = _triangle_corners(mesh)
        vertices = of_triangles(corner_vert)
        material = None
        used = (rows[0] if slot is None else rows[slot[0]],)
        if slot is not None and len(found := np.unique(np.asarray(rows, np.uint16)[slot])) > 1:
            # A polygon of n corners gives n - 2 triangles, one polygon after another.
            material = np.repeat(np.asarray(rows, np.uint16)[slot], np.diff(offsets) - 2)
            used = tuple(int(row) for row in found)
        return Mesh(
            key=key,
            name=name,
            position=position.copy(),
            triangles=vertices,
            vertex_normal=normal.copy() if smooth else None,
            corner_normal=None if smooth else of_triangles(normal),
            uv={n: of_triangles(a) for n, a in uv.items()},
            colors={
                n: arrays.scene_linear(of_triangles(a) if domain == "CORNER" else a[vertices])
                for n, (domain, a) in colors.items()
            },
            active_uv=active,
            generated=generated,
            material=material,
            materials=used,
            topology=topology,
        )

    parts = [len(position), corner_vert, offsets, smooth, rows, active]
    parts += [] if slot is None else [slot]
    for attribute, array in uv.items():
        parts += [attribute, array]
    for attribute, (domain, array) in colors.items():
        parts += [attribute, domain, array]
    topology = arrays.digest(*parts)
    key = arrays.digest(topology, position, normal, *([] if generated is None else [generated]))
    return lookup(key, build)


def _generated(mesh: bpy.types.Mesh, position: np.ndarray) -> np.ndarray | None:
    """(V, 3) float32: generated coordinates of vertices (V, 3), which lie in the texture space where they were before
    modifiers deformed them, as Blender keeps them for renders; None: they are places within the mesh's bounds."""
    rest = np.empty(position.size, np.float32)
    mesh.vertices.foreach_get("undeformed_co", rest)
    middle, half = (np.array(v, np.float32) for v in (mesh.texspace_location, mesh.texspace_size))
    low, high = position.min(axis=0), position.max(axis=0)
    rest = rest.reshape(-1, 3)
    near = ROUNDED * max(float(np.abs([low, high]).max()), 1e-30)
    flat = high <= low
    whole = np.abs(np.where(flat, 0, [middle - half - low, middle + half - high])).max() <= near
    if whole and np.abs(rest - position).max() <= near:
        return None
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(half > 0, 0.5 * (rest - middle) / half + 0.5, np.float32(0.5)).astype(np.float32)


def is_loose_vertices(mesh: bpy.types.Mesh) -> bool:
    """Whether a mesh has vertices but neither edges nor faces, as imported scans do: it is drawn as points."""
    return len(mesh.polygons) == 0 and len(mesh.edges) == 0 and len(mesh.vertices) > 0


def _slots(mesh: bpy.types.Mesh, count: int) -> np.ndarray | None:
    """Material slot of each polygon, (P,) int32, clipped to the `count` existing ones; None if all are the first."""
    attribute = mesh.attributes.get("material_index")
    if attribute is None or count < 2 or attribute.domain != "FACE":
        return None
    return np.clip(arrays.read(attribute.data, "value", 1, np.int32), 0, count - 1)


def _triangle_corners(mesh: bpy.types.Mesh) -> Callable[[np.ndarray], np.ndarray]:
    """A function that copies values (L, ...) of the mesh's corners to the corners of its triangles, (T, 3, ...)."""
    if len(mesh.loops) == 3 * len(mesh.polygons):  # all are triangles, as in scans
        return lambda values: values.copy().reshape(-1, 3, *values.shape[1:])
    mesh.calc_loop_triangles()
    corners = arrays.view(mesh.loop_triangles, (len(mesh.loop_triangles), 3), np.int32)
    return lambda values: values[corners]


def _read_colors(
    mesh: bpy.types.Mesh, wanted: frozenset[str | None] | None, offsets: np.ndarray
) -> dict[str, tuple[str, np.ndarray]]:
    """The wanted attributes by name, as (POINT or CORNER, colours (N, 4) as stored), the default colours first.

    offsets (P + 1,): the first corner of each polygon.
    """
    default = mesh.color_attributes.default_color_name
    names: list[str] = sorted((a.name for a in mesh.color_attributes), key=lambda n: n != default)
    found: dict[str, tuple[str, np.ndarray]] = {}
    for name in names:
        attribute = mesh.attributes[name]
        if (wanted is None or name in wanted or (name == default and None in wanted)) and _readable(attribute):
            found[name] = attribute.domain, arrays.stored_colors(attribute)
    for name in sorted({n for n in wanted or () if n is not None} - set(found)):
        attribute = mesh.attributes.get(name)
        if attribute is not None and _readable(attribute) and name not in mesh.uv_layers:
            values = attribute_as_color(attribute)
            if attribute.domain == "FACE":
                found[name] = "CORNER", np.repeat(values, np.diff(offsets), axis=0)
            else:
                found[name] = attribute.domain, values
    return found


def _readable(attribute: Any) -> bool:
    """Whether an attribute has a type and a domain that materials can read here."""
    return attribute.data_type in READABLE_TYPES and attribute.domain in ("POINT", "CORNER", "FACE")
