"""Sources of a dependency graph as geometry of core; what has not changed is not converted again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import bpy
import numpy as np

from ..core.material.graph import MaterialGraph, needs
from ..core.scene import mesh as mesh_module
from ..core.scene import scene
from ..core.scene.cloud import PointCloud
from ..core.scene.materials import MaterialTable
from ..core.scene.scene import StreamedScan
from ..core.scene.volume import Medium, Volume
from ..core.surface.neighbourhoods.estimate import Ellipses
from ..core.volume.filling import Filling, fill_mesh
from ..stream.scan import scan_at
from .convert.arrays import digest
from .convert.captured import is_captured, read_captured
from .convert.mesh import is_loose_vertices, read_mesh
from .convert.objects import Source
from .convert.pages import LinkedScan, ScanLook, point_size
from .convert.pointcloud import convert_points, read_pointcloud
from .convert.sample_material import SampleMaterial, sample_material
from .convert.selection.clip_boxes import clipped
from .convert.selection.filters import kept_points
from .convert.strands import bevels, conversion, curves_objects, particle_hair
from .convert.volume import Voxels, convert_volume, read_voxels, source_key, transfer_digest, wanted_grids
from .geometry_cache import GeometryCache


class ConversionError(Exception):
    """An object that cannot be converted; the message names it and says why."""


class Known(NamedTuple):
    """What one source became."""

    geometry: scene.Geometry | None  # None: nothing to draw
    owners: frozenset[int]  # session_uids of the objects that use it, and of the data
    generated: bool  # made by an instancer, whose changes do not name it
    voxels: Voxels | None = None
    warnings: tuple[str, ...] = ()
    strands: conversion.ConvertedStrands | None = None
    parts: tuple[Ellipses | PointCloud, ...] = ()  # of points, which other materials and clip boxes find again


class Geometries:
    """Converts the sources of the successive states of one dependency graph, and remembers the last ones."""

    def __init__(self, cache: GeometryCache) -> None:
        self._cache = cache
        self._known: dict[tuple, Known] = {}
        # Kept alive so that another transfer function finds voxels, and strands that are read again stay evaluated
        self._shared: tuple[Voxels | conversion.ConvertedStrands | tuple[Ellipses | PointCloud, ...] | None, ...] = ()

    def warnings(self) -> dict[str, None]:
        """Warnings about the sources of the last `convert`, without repetitions, as the keys of a dictionary."""
        return dict.fromkeys(warning for known in self._known.values() for warning in known.warnings)

    def forget(self) -> None:
        """Read every source again at the next `convert`."""
        self._known = {}

    def forget_owned_by(self, changed: set[int]) -> None:
        """Read again the sources of changed objects or data, by their session_uids, and all generated ones."""
        unchanged = {k: v for k, v in self._known.items() if not v.generated and changed.isdisjoint(v.owners)}
        self._known = unchanged

    def convert(self, sources: list[Source], table: MaterialTable) -> list[scene.Geometry | None]:
        """The geometry of each source, None if there is nothing to draw; converts only what is not known.

        ConversionError: one of them cannot be converted."""
        known: dict[tuple, Known] = {}
        keys = []
        for source in sources:
            rows = tuple(self._cache.row(m) for m in source.materials)
            if source.matte and table.translucent is not None:
                # They hide what is behind them, whatever their material lets through.
                rows = tuple(0 if table.translucent[row] else row for row in rows)
            key = _source_key(source, rows, table)
            keys.append(key)
            last = known.get(key) or self._known.get(key)
            voxels, warnings, strands = (last.voxels, last.warnings, last.strands) if last else (None, (), None)
            parts = last.parts if last else ()
            try:
                if last and not source.editing:
                    geometry = last.geometry
                elif source.smoke or isinstance(source.data, bpy.types.Volume):
                    geometry, voxels, warnings = self._convert_volume(source, rows[0], table)
                elif source.filled:
                    geometry, warnings = self._convert_filled(source, rows, table)
                elif source.strands:
                    geometry, strands, warnings = self._convert_strands(source, rows, table)
                else:
                    geometry, parts, warnings = self._convert_surface(source, rows, table)
            except Exception as error:
                raise ConversionError(f"{source.name}: {type(error).__name__}: {error}") from error
            owners = {source.owner, source.data.original.session_uid, source.data.session_uid}
            owners |= last.owners if last else set()
            generated = source.generated or bool(last and last.generated)
            known[key] = Known(geometry, frozenset(owners), generated, voxels, warnings, strands, parts)
        self._known = known
        self._shared = tuple(entry.voxels or entry.strands or entry.parts for entry in known.values())
        return [known[key].geometry for key in keys]

    def _convert_surface(
        self, source: Source, rows: tuple[int, ...], table: MaterialTable
    ) -> tuple[scene.Geometry | None, tuple[Ellipses | PointCloud, ...], tuple[str, ...]]:
        """The geometry of a mesh, or of points; what it was made of; and warnings."""
        mesh = cloud = None
        material = sample_material(table, rows[0], source.extinction, source.values)
        parts: list[Ellipses | PointCloud] = []
        messages: tuple[str, ...] = ()

        def lookup(key: str, make: Callable[[], Any]) -> Any:
            found = self._cache.lookup(key, make)
            if isinstance(found, Ellipses) or (source.clip and isinstance(found, PointCloud)):
                parts.append(found)
            return found

        if is_captured(source.data) and not source.particles:
            return self._convert_captured(source)
        if source.scan is not None:
            return self._convert_scan(source, source.scan, material, lookup, parts)
        if source.particles:
            key, cloud = convert_points(source.particles, material, lookup)
        elif isinstance(source.data, bpy.types.PointCloud):
            key, cloud, messages = _read_points(source, source.data, material, lookup)
        else:
            found = _read_evaluated(
                source, rows, _attributes(table, rows), _use_generated(table, rows), material, lookup
            )
            if isinstance(found, mesh_module.Mesh):
                mesh, key = found, found.key
            else:
                key, cloud = found or ("", None)
        warnings = tuple(f"{source.name}: {message}" for message in messages)
        if mesh is None and cloud is None:
            return None, tuple(parts), warnings
        primitive, spacing, extinction = source.primitive, source.spacing, source.extinction
        pixels = source.pixel_radius

        def build() -> scene.Geometry:
            return scene.Geometry(
                key, source.name, mesh, cloud,
                primitive=primitive, spacing=spacing, extinction=extinction, pixel_radius=pixels,
            )  # fmt: skip

        key = f"{key} {primitive} {spacing:g} {extinction:g} {pixels:g}"
        return self._cache.lookup(key, build), tuple(parts), warnings

    def _convert_scan(
        self,
        source: Source,
        scan: LinkedScan,
        material: SampleMaterial,
        lookup: Callable[[str, Callable[[], Any]], Any],
        parts: list[Ellipses | PointCloud],
    ) -> tuple[scene.Geometry | None, tuple[Ellipses | PointCloud, ...], tuple[str, ...]]:
        """The geometry of a scan that is read by pages, for which the object's points stand in; and warnings."""
        shape = replace(source.shape, kind="BALLS" if source.shape.kind == "BALLS" else "GIVEN")
        own, stand_in, messages = _read_points(replace(source, shape=shape), source.data, material, lookup)  # pyright: ignore[reportArgumentType]
        look = ScanLook(material, source.filters, source.shape)
        boxes = None if source.clip is None else np.array(source.clip.box_from_object).reshape(-1, 4, 4)
        boxes = None if boxes is None or len(boxes) == 0 else boxes
        inside = source.clip is None or source.clip.inside
        size = point_size(source.shape)
        key = f"{scan.path} {own} {look.key} {size} {digest(boxes, inside)} {source.pixel_radius:g} pages"

        def build() -> scene.Geometry:
            streamed = StreamedScan(scan_at(scan.path), look, size, boxes, inside, stand_in)
            return scene.Geometry(key, source.name, streamed=streamed, pixel_radius=source.pixel_radius)

        warnings = tuple(f"{source.name}: {message}" for message in messages)
        return self._cache.lookup(key, build), tuple(parts), warnings

    def _convert_captured(
        self, source: Source
    ) -> tuple[scene.Geometry | None, tuple[Ellipses | PointCloud, ...], tuple[str, ...]]:
        """The geometry of captured splats that filters and clip boxes keep, and warnings."""
        rows, messages = kept_points(source.data, source.filters) if source.filters else (None, ())
        found = read_captured(source.data, source.antialiased, self._cache.lookup, rows, source.clip)
        if found is None:
            return None, (), tuple(f"{source.name}: {message}" for message in messages)
        key, splats, more = found
        warnings = tuple(f"{source.name}: {message}" for message in (*messages, *more))
        key = f"{key} captured" if source.lighting == "CAPTURED" else f"{key} captured {source.lighting}"
        made = scene.Geometry(key, source.name, captured=splats, lighting=source.lighting)
        return self._cache.lookup(key, lambda: made), (), warnings

    def _convert_strands(
        self, source: Source, rows: tuple[int, ...], table: MaterialTable
    ) -> tuple[scene.Geometry | None, conversion.ConvertedStrands | None, tuple[str, ...]]:
        """The geometry of strands, the conversion that it shares with others, and warnings."""
        materials = tuple(sample_material(table, row, values=source.values) for row in rows)
        if source.hair:
            control = particle_hair.read_hair(source.hair, materials)
        elif isinstance(source.data, bpy.types.Curve):
            control = bevels.read_splines(source.data)
        else:
            control = curves_objects.read_curves(source.data, materials, source.ribbons)  # pyright: ignore[reportArgumentType]
        if control is None:
            return None, None, ()
        found = conversion.convert_strands(control, source.name, materials, self._cache.lookup)
        warnings = tuple(f"{source.name}: {message}" for message in found.messages)
        if found.strands is None:
            return None, found, warnings
        key = f"{found.strands.key} lines"
        made = scene.Geometry(key, source.name, strands=found.strands, primitive="LINES")
        return self._cache.lookup(key, lambda: made), found, warnings

    def _convert_filled(
        self, source: Source, rows: tuple[int, ...], table: MaterialTable
    ) -> tuple[scene.Geometry | None, tuple[str, ...]]:
        """The geometry of what fills a mesh, and warnings. rows: of its medium, then of the mesh's materials."""
        if _hides_inside(rows[1:], table):
            return None, ()
        material = sample_material(table, rows[0])
        mesh = _read_evaluated(source, rows, frozenset(), False, material, self._cache.lookup)
        if not isinstance(mesh, mesh_module.Mesh) or _medium(table, rows[0]) is None:
            return None, ()
        scale = np.array(source.filled)
        key = f"{mesh.key} filled {source.filled} {source.spacing:g}"
        edge = source.spacing * float(np.cbrt(scale.prod()))
        made: Filling = self._cache.lookup(key, lambda: fill_mesh(mesh.position, mesh.triangles, scale, edge))
        if len(made.index) == 0:
            return None, (f"{source.name}: a mesh without an inside cannot be filled",)
        warnings = () if made.closed else (f"{source.name}: its volume has gaps, because the mesh is not closed",)
        volume = Volume(
            key, source.name, made.index, made.object_from_index, {}, rows[0],
            share=made.share, scale=float(np.cbrt(scale.prod())),
        )  # fmt: skip
        found = scene.Geometry(
            f"{key} {rows[0]} {source.extinction:g}", source.name, volume=volume, extinction=source.extinction
        )
        return self._cache.lookup(found.key, lambda: found), warnings

    def _convert_volume(
        self, source: Source, row: int, table: MaterialTable
    ) -> tuple[scene.Geometry | None, Voxels, tuple[str, ...]]:
        """The geometry of a volume, the voxels that it shares with others, and warnings."""
        names = wanted_grids(_medium(table, row), source.transfer)
        voxels = source.smoke or read_voxels(source.data, names, self._cache.lookup)  # pyright: ignore[reportArgumentType]
        warnings = tuple(f"{source.name}: {message}" for message in voxels.messages)
        volume = convert_volume(voxels, source.name, row, source.transfer)
        if volume is None:
            return None, voxels, warnings
        spacing, extinction = source.spacing, source.extinction
        transfer = source.transfer and transfer_digest(source.transfer)
        key = f"{volume.key} {row} {spacing:g} {extinction:g} {transfer}"
        made = scene.Geometry(key, source.name, volume=volume, spacing=spacing, extinction=extinction)
        return self._cache.lookup(key, lambda: made), voxels, warnings


def _source_key(source: Source, rows: tuple[int, ...], table: MaterialTable) -> tuple:
    """What tells whether a source is the same as before, apart from changes that the dependency graph reports.

    rows: of its materials in the table.
    """
    digests = tuple(graph.digest if (graph := _graph(table, row)) else "" for row in rows)
    settings = source.primitive, source.spacing, source.extinction, source.shape
    settings = *settings, source.pixel_radius, source.filters, source.clip, source.motion
    settings = *settings, source.antialiased, source.lighting, source.scan, source.filled
    key = (source.data.session_uid, rows, digests, *settings)
    if source.filled:
        key = (*key, _hides_inside(rows[1:], table))
    if source.smoke:
        key = (*key, source.smoke.key)
    if isinstance(source.data, bpy.types.Volume):
        names = wanted_grids(_medium(table, rows[0]), source.transfer)
        key = (*source_key(source.data), *key, names, source.transfer and transfer_digest(source.transfer))
    if source.particles:
        key = (*key, source.particles.key)
    if source.particles or isinstance(source.data, bpy.types.PointCloud) or _is_loose_vertices(source):
        key = (*key, sample_material(table, rows[0], values=source.values).key)
    if source.strands:
        materials = [sample_material(table, row, values=source.values) for row in rows]
        looks = tuple((m.key, *m.base_color) for m in materials)
        # Evaluated curve data have no session_uid
        names = source.data.original.session_uid, source.owner, source.hair and source.hair.modifier.name
        key = (*key, *names, looks, source.ribbons)
    return key


def _hides_inside(rows: tuple[int, ...], table: MaterialTable) -> bool:
    """Whether all surfaces of a mesh with these materials are opaque."""
    return table.translucent is None or not table.translucent[list(rows)].any()


def _medium(table: MaterialTable, row: int) -> Medium | None:
    return table.media[row] if row < len(table.media) else None


def _graph(table: MaterialTable, row: int) -> MaterialGraph | None:
    return table.graphs[row] if row < len(table.graphs) else None  # pyright: ignore[reportReturnType]


def _attributes(table: MaterialTable, rows: tuple[int, ...]) -> frozenset[str | None]:
    """Names of the attributes that the materials read; None among them is the default colour attribute."""
    graphs = [graph for row in rows if (graph := _graph(table, row))]
    return frozenset().union(*(needs(graph).colors for graph in graphs))


def _use_generated(table: MaterialTable, rows: tuple[int, ...]) -> bool:
    """Whether some of the materials reads generated coordinates."""
    return any(needs(graph).generated for row in rows if (graph := _graph(table, row)))


def _is_loose_vertices(source: Source) -> bool:
    """Whether a source is a mesh that is drawn as points because it has neither edges nor faces."""
    return isinstance(source.data, bpy.types.Mesh) and not source.strands and is_loose_vertices(source.data)


def _read_points(
    source: Source, data: bpy.types.PointCloud, material: SampleMaterial, lookup: Callable
) -> tuple[str, PointCloud | None, tuple[str, ...]]:
    """(content key, cloud, messages) of the points of a point cloud that its filters and clip boxes keep."""
    rows, messages = kept_points(data, source.filters) if source.filters else (None, ())
    key, cloud = read_pointcloud(data, material, lookup, source.shape, rows, source.motion) or ("", None)
    if source.clip is not None and cloud is not None:
        key, cloud = clipped(key, cloud, source.clip, lookup)
        messages += source.clip.messages
    return key, cloud, messages


def _read_evaluated(
    source: Source,
    rows: tuple[int, ...],
    wanted: frozenset[str | None],
    use_generated: bool,
    material: SampleMaterial,
    lookup: Callable,
) -> mesh_module.Mesh | tuple[str, PointCloud] | None:
    """The mesh of a source, or (content key, points) of one without edges and faces; None if nothing is to be drawn.

    In edit mode Blender's evaluated mesh holds no arrays, and a copy is made.
    """

    def read(data: bpy.types.Mesh) -> mesh_module.Mesh | tuple[str, PointCloud] | None:
        if is_loose_vertices(data):
            return read_pointcloud(data, material, lookup, source.shape, motion=source.motion)
        return read_mesh(data, source.name, rows, wanted, lookup, use_generated)

    if source.editing is None:
        return read(source.data)  # pyright: ignore[reportArgumentType]
    try:
        return read(source.editing.to_mesh())
    finally:
        source.editing.to_mesh_clear()
