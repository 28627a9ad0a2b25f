"""Evaluated Volume objects and fluid domains of Blender as sparse voxels of core."""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy
import numpy as np

from ...core.numeric.record import record
from ...core.scene.volume import Medium, Transfer, Volume
from ...formats.volumes import vdb
from . import arrays

DOMAIN_GRIDS = ("density", "flame", "heat", "temperature")  # of fluid simulations
RAMP_SAMPLES = 256  # samples of a colour ramp
Lookup = Callable[[str, Callable[[], Any]], Any]


@record
class Voxels:
    """The grids of one file or of one evaluated object."""

    key: str  # content key
    grids: vdb.Grids | None  # None: nothing to draw
    messages: tuple[str, ...] = ()  # about what cannot be read; they do not name the object


def load_openvdb() -> ModuleType:
    """The `openvdb` module that Blender ships. Raises ImportError where it ships none."""
    try:
        return importlib.import_module("openvdb")
    except ImportError:
        pass
    # As a Python package, Blender keeps it beside itself, where Python does not look.
    version = "python{}.{}".format(*sys.version_info)
    folder = os.path.join(bpy.utils.resource_path("LOCAL"), "python", "lib", version, "site-packages")
    sys.path.append(folder)
    try:
        return importlib.import_module("openvdb")
    finally:
        sys.path.remove(folder)


def wanted_grids(medium: Medium | None, transfer: Transfer | None) -> tuple[str, ...]:
    """Names of the grids that the optics read, that of the density or transfer function first."""
    if transfer is not None:
        return (transfer.grid,)
    medium = medium or Medium()
    temperature = medium.temperature_grid if medium.blackbody > 0 else ""
    return tuple(dict.fromkeys(n for n in (medium.density_grid, medium.color_grid, temperature) if n))


def source_key(data: bpy.types.Volume) -> tuple:
    """What identifies the state of a volume: its session_uid, and the path, time and size of its file.

    The evaluated copy of a volume that nothing modifies has no session_uid of its own.
    """
    path = _file(data)
    if path is None:
        return (data.session_uid,)
    try:
        state = path.stat()
    except OSError:
        return data.original.session_uid, str(path)
    return data.original.session_uid, str(path), state.st_mtime_ns, state.st_size


def read_voxels(data: bpy.types.Volume, names: Collection[str], lookup: Lookup) -> Voxels:
    """The voxels of the grids called `names`; `lookup(key, make)` gives those that are known by their content key.

    A file is read again only if it changed or other grids of it are wanted; the results of modifiers and nodes are
    always read, and recognised by their content.
    """
    if not data.grids.load():
        return Voxels("", None, (data.grids.error_message,))
    if len(data.grids) == 0:
        return Voxels("", None)
    path = _file(data)
    if path is None:
        return _read_generated(data, names, lookup)
    key = arrays.digest("volume file", source_key(data)[1:], tuple(names))
    return lookup(key, lambda: _read_file(key, path, names))


def _read_generated(data: bpy.types.Volume, names: Collection[str], lookup: Lookup) -> Voxels:
    """Voxels of a volume in memory, by way of a temporary file: Python has no other access to them."""
    with tempfile.TemporaryDirectory(prefix="pointsplat-") as folder:
        path = Path(folder) / "grids.vdb"
        try:
            data.grids.save(str(path))
        except RuntimeError as error:
            return Voxels("", None, (str(error),))
        read = _read_file("", path, names)
    if read.grids is None:
        return read
    parts = [part for name, values in read.grids.values.items() for part in (name, values)]
    key = arrays.digest("volume", read.grids.index, read.grids.object_from_index, read.messages, *parts)
    return lookup(key, lambda: replace(read, key=key))


def _read_file(key: str, path: Path, names: Collection[str]) -> Voxels:
    """The voxels of these grids of an OpenVDB file on one lattice."""
    try:
        found, messages = vdb.read(load_openvdb(), path, names)
        if not found:
            return Voxels(key, None, tuple(messages))
        # The lattice is that of the first name.
        order = {name: position for position, name in enumerate(names)}
        grids, more = vdb.combine(sorted(found, key=lambda grid: order.get(grid.name, len(order))))
    except (OSError, ValueError, ImportError) as error:
        return Voxels(key, None, (str(error),))
    return Voxels(key, grids, (*messages, *more))


def convert_volume(voxels: Voxels, name: str, row: int, transfer: Transfer | None) -> Volume | None:
    """The volume of core of these voxels; None if no voxel is active. row: of its material in the table."""
    grids = voxels.grids
    if grids is None:
        return None
    return Volume(voxels.key, name, grids.index, grids.object_from_index, grids.values, row, transfer)


def read_domain(ob: bpy.types.Object) -> Voxels | None:
    """The smoke and flames of a gas domain of Blender's fluid simulation in this frame, in object space.

    Returns None if the object is no such domain.
    """
    for modifier in ob.modifiers:
        if (
            modifier.type == "FLUID"
            and modifier.fluid_type == "DOMAIN"
            and modifier.domain_settings.domain_type == "GAS"
        ):
            return smoke(modifier.domain_settings)
    return None


def smoke(domain: Any) -> Voxels:
    """The voxels of a FluidDomainSettings with smoke or flames.

    With noise, grids are finer than the domain's resolution by an integer factor.
    """
    resolution = np.array(domain.domain_resolution, np.int64)
    found = {name: _flat(getattr(domain, f"{name}_grid")) for name in DOMAIN_GRIDS}
    count, coarse = len(found["density"]), int(resolution.prod())
    finer = round((count / coarse) ** (1 / 3)) if coarse else 0
    if count == 0 or count != coarse * finer**3:
        return Voxels("", None)
    # x varies fastest in Blender's arrays
    active = np.flatnonzero((found["density"] > 0) | (found["flame"] > 0 if len(found["flame"]) == count else False))
    fine = resolution * finer
    index = np.stack([active % fine[0], active // fine[0] % fine[1], active // (fine[0] * fine[1])], axis=1)
    matrix = np.eye(4)
    edge = np.array(domain.cell_size, np.float64) / finer
    matrix[:3, :3] = np.diag(edge)
    matrix[:3, 3] = np.array(domain.start_point, np.float64) + edge / 2
    order = np.lexsort(index.T[::-1])
    values = {name: grid[active[order]] for name, grid in found.items() if len(grid) == count}
    grids = vdb.Grids(index[order].astype(np.int32), matrix, values)
    parts = [part for name, value in values.items() for part in (name, value)]
    return Voxels(arrays.digest("smoke", grids.index, matrix, *parts), grids if len(active) else None)


def _flat(array: Any) -> np.ndarray:
    """An array property of Blender as (N,) float32."""
    values = np.empty(len(array), np.float32)
    if len(array):
        array.foreach_get(values)
    return values


def sample_ramp(ramp: bpy.types.ColorRamp) -> np.ndarray:
    """RAMP_SAMPLES colours (R, 4) float32 of a colour ramp at equal distances, both ends included."""
    return np.array([ramp.evaluate(x) for x in np.linspace(0, 1, RAMP_SAMPLES)], np.float32)


def convert_transfer(ob: bpy.types.Object) -> Transfer | None:
    """The transfer function of an object; None if it has none or uses none."""
    settings = ob.pointsplat
    if not settings.use_transfer or settings.transfer_texture is None:
        return None
    texture = settings.transfer_texture
    if texture.color_ramp is None:
        return None
    return Transfer(
        grid=settings.transfer_grid,
        low=settings.transfer_low,
        high=settings.transfer_high,
        ramp=sample_ramp(texture.color_ramp),
        density=settings.transfer_density,
    )


def transfer_digest(transfer: Transfer) -> str:
    """Content key of a transfer function."""
    return arrays.digest("transfer", transfer.grid, transfer.low, transfer.high, transfer.ramp, transfer.density)


def _file(data: bpy.types.Volume) -> Path | None:
    """The file with exactly these grids; None for the results of modifiers or nodes, which have no original."""
    if data.original == data:
        return None
    data.grids.load()
    path = data.grids.frame_filepath
    return Path(bpy.path.abspath(path)) if path and data.packed_file is None else None
