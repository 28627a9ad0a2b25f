"""An evaluated mesh to triangles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from ...core.scene.mesh import Mesh
from . import arrays

COLOR_TYPES = ("FLOAT_COLOR", "BYTE_COLOR")
Lookup = Callable[[str, Callable[[], Mesh]], Mesh]  # the mesh of a content key, made only where it is not known


def read_mesh(
    mesh: bpy.types.Mesh, name: str, rows: tuple[int, ...], wanted: frozenset[str | None] | None, lookup: Lookup
) -> Mesh | None:
    """Triangles of an evaluated mesh, or None where it has no faces.

    rows: for each material slot its row in the scene's table; faces beyond the last slot use the last.
    wanted: names of the colour and other attributes that the materials read, where a None among them is the
    default colour attribute; None instead of a set: all colours.
    UV maps are always taken. lookup: gives the cached mesh of a content key, so that unchanged arrays are
    digested (30 MB for a million triangles) but neither triangulated nor expanded.
    """
    if len(mesh.polygons) == 0:
        return None
    position = arrays.read(mesh.attributes["position"].data, "vector", 3, np.float32)
    corner_vert = arrays.read(mesh.attributes[".corner_vert"].data, "value", 1, np.int32)
    offsets = arrays.view(mesh.polygons, (len(mesh.polygons) + 1,), np.int32)
    slot = _slots(mesh, len(rows))
    smooth = mesh.normals_domain == "POINT"
    if smooth:
        normal = arrays.view(mesh.vertex_normals, (len(mesh.vertices), 3), np.float32)
    else:
        normal = arrays.view(mesh.corner_normals, (len(mesh.loops), 3), np.float32)
    uv = {m.name: arrays.read(mesh.attributes[m.name].data, "vector", 2, np.float32) for m in mesh.uv_layers}
    active = next((m.name for m in mesh.uv_layers if m.active_render), None)
    colors = _colors(mesh, wanted)

    def build() -> Mesh:
        mesh.calc_loop_triangles()
        corners = arrays.view(mesh.loop_triangles, (len(mesh.loop_triangles), 3), np.int32)
        material = None
        used = (rows[0] if slot is None else rows[slot[0]],)
        if slot is not None and len(found := np.unique(np.asarray(rows, np.uint16)[slot])) > 1:
            # A polygon of n corners gives n - 2 triangles, one polygon after another.
            material = np.repeat(np.asarray(rows, np.uint16)[slot], np.diff(offsets) - 2)
            used = tuple(int(row) for row in found)
        return Mesh(
            key=key,
            name=name,
            position=position,
            triangles=corner_vert[corners],
            vertex_normal=normal.copy() if smooth else None,
            corner_normal=None if smooth else normal[corners],
            uv={n: a[corners] for n, a in uv.items()},
            colors={n: arrays.scene_linear(a[_rows(d, corners, corner_vert)]) for n, (d, a) in colors.items()},
            active_uv=active,
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
    key = arrays.digest(topology, position, normal)
    return lookup(key, build)


def is_scattered(mesh: bpy.types.Mesh) -> bool:
    """Whether a mesh is nothing but vertices, as importers make of scans: it is drawn as points."""
    return len(mesh.polygons) == 0 and len(mesh.edges) == 0 and len(mesh.vertices) > 0


def _slots(mesh: bpy.types.Mesh, count: int) -> np.ndarray | None:
    """(P,) int32 material slot of each polygon, within the slots there are; None where all are the first."""
    attribute = mesh.attributes.get("material_index")
    if attribute is None or count < 2 or attribute.domain != "FACE":
        return None
    return np.clip(arrays.read(attribute.data, "value", 1, np.int32), 0, count - 1)


def _rows(domain: str, corners: np.ndarray, corner_vert: np.ndarray) -> np.ndarray:
    """(T, 3) rows of an attribute of that domain, for the triangles' corners."""
    return corners if domain == "CORNER" else corner_vert[corners]


def _colors(mesh: bpy.types.Mesh, wanted: frozenset[str | None] | None) -> dict[str, tuple[str, np.ndarray]]:
    """Name to (domain, (N, 4) as stored) of the wanted attributes, the default colour attribute first."""
    default = mesh.color_attributes.default_color_name
    names: list[str] = sorted((a.name for a in mesh.color_attributes), key=lambda n: n != default)
    found: dict[str, tuple[str, np.ndarray]] = {}
    for name in names:
        attribute = mesh.attributes[name]
        if (wanted is None or name in wanted or (name == default and None in wanted)) and _readable(attribute):
            found[name] = attribute.domain, arrays.colors(attribute)
    for name in sorted({n for n in wanted or () if n is not None} - set(found)):
        attribute = mesh.attributes.get(name)
        if attribute is not None and _readable(attribute) and name not in mesh.uv_layers:
            found[name] = attribute.domain, as_color(attribute)
    return found


def _readable(attribute: Any) -> bool:
    known = attribute.data_type in (*COLOR_TYPES, "FLOAT", "FLOAT_VECTOR")
    return known and attribute.domain in ("POINT", "CORNER")


def as_color(attribute: Any) -> np.ndarray:
    """(N, 4) as an Attribute node's Color output has it: a float in all three channels, a vector as it is."""
    if attribute.data_type in COLOR_TYPES:
        return arrays.colors(attribute)
    if attribute.data_type == "FLOAT":
        value = np.repeat(arrays.read(attribute.data, "value", 1, np.float32)[:, None], 3, axis=1)
    else:
        value = arrays.read(attribute.data, "vector", 3, np.float32)
    return np.concatenate([value, np.ones((len(value), 1), np.float32)], axis=1)
