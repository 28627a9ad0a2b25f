"""Volume objects and media for the scripts: voxels to .vdb files by Blender's own openvdb, and their materials."""

import os
import sys
from pathlib import Path

import bpy
import numpy as np


def openvdb():
    """The module that Blender ships; as a Python package Blender does not put it on the path."""
    folder = Path(bpy.utils.resource_path("LOCAL"), "python", "lib")
    folder = folder / "python{}.{}".format(*sys.version_info) / "site-packages"
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    import openvdb

    return openvdb


def write_vdb(path: Path, grids: dict[str, np.ndarray], corner, voxel: float) -> None:
    """Arrays (X, Y, Z) or (X, Y, Z, 3) by name as one file. What is 0 stays inactive.

    corner: object-space position of the outer corner of voxel (0, 0, 0); voxel: length of its edges.
    """
    vdb = openvdb()
    rows = np.diag([voxel, voxel, voxel, 1.0])
    rows[3, :3] = np.asarray(corner, float) + voxel / 2  # an integer index is a voxel's centre; openvdb has rows
    made = []
    for name, values in grids.items():
        grid = vdb.FloatGrid() if values.ndim == 3 else vdb.Vec3SGrid()
        grid.copyFromArray(np.ascontiguousarray(values, np.float32), tolerance=0.0)
        grid.name, grid.gridClass = name, vdb.GridClass.FOG_VOLUME
        grid.transform = vdb.createLinearTransform(rows.tolist())
        made.append(grid)
    path.parent.mkdir(parents=True, exist_ok=True)
    vdb.write(os.fspath(path), grids=made)


def volume_object(name: str, path: Path, look: bpy.types.Material) -> bpy.types.Object:
    """An object that shows a .vdb file, in full precision."""
    data = bpy.data.volumes.new(name)
    data.filepath = os.fspath(path)
    data.render.precision = "FULL"
    data.render.clipping = 0.0
    data.materials.append(look)
    made = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(made)
    return made


def new_material(name: str) -> bpy.types.Material:
    """A material with nodes, whichever Blender makes it."""
    made = bpy.data.materials.new(name)
    if not made.node_tree:
        made.use_nodes = True
    return made


def medium(name: str, density=1.0, color=(0.5, 0.5, 0.5), **inputs) -> bpy.types.Material:
    """A Principled Volume; `inputs` are further sockets, their spaces as underscores (Absorption_Color=(...))."""
    made = new_material(name)
    nodes = made.node_tree.nodes
    nodes.remove(nodes["Principled BSDF"])
    volume = nodes.new("ShaderNodeVolumePrincipled")
    values = {"Density": density, "Color": color} | {k.replace("_", " "): v for k, v in inputs.items()}
    for socket, value in values.items():
        volume.inputs[socket].default_value = (*value, 1.0) if isinstance(value, tuple) else value
    made.node_tree.links.new(volume.outputs["Volume"], nodes["Material Output"].inputs["Volume"])
    return made


def surface(name: str, color=(0.8, 0.8, 0.8), **inputs) -> bpy.types.Material:
    """A Principled surface; `inputs` as in `medium`."""
    made = new_material(name)
    principled = made.node_tree.nodes["Principled BSDF"]
    for socket, value in ({"Base Color": color} | {k.replace("_", " "): v for k, v in inputs.items()}).items():
        principled.inputs[socket].default_value = (*value, 1.0) if isinstance(value, tuple) else value
    return made


def ball(resolution: int) -> np.ndarray:
    """(N, N, N) the share of each voxel that lies in the ball which fills the grid, to first order at its rim."""
    middle = (np.arange(resolution) + 0.5) / resolution * 2 - 1
    distance = np.sqrt(np.square(middle)[:, None, None] + np.square(middle)[:, None] + np.square(middle))
    return np.clip(0.5 + (1 - distance) * resolution / 2, 0, 1).astype(np.float32)


def volumes_last(scene: bpy.types.Scene) -> None:
    """Put volumes behind all other objects: camera rays of Cycles in Blender 5.2.3 miss those that precede a lamp."""
    objects = scene.collection.objects
    for item in [o for o in objects if o.type == "VOLUME"]:
        objects.unlink(item)
        objects.link(item)
