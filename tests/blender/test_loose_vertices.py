"""Meshes without edges and faces, as Blender's PLY import makes of scans, are drawn as points."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportCallIssue=false
# Attributes may be None by type; what is tested here has those that are asked for.
import bpy
import numpy as np
import pytest

from pointsplat_addon.host.geometry_cache import GeometryCache
from pointsplat_addon.host.sync import Synchronizer
from tests.support.blender.scenes import pointcloud

pytestmark = pytest.mark.usefixtures("empty_file")

SPACING = 0.25


def lattice(n: int = 6) -> np.ndarray:
    return SPACING * np.stack(np.meshgrid(*[np.arange(n)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)


def ply(path, position, normal=None, color=None, radius=None) -> None:
    """A scan as text: vertices alone."""
    names = ["float x", "float y", "float z"]
    columns = [position]
    if normal is not None:
        names += ["float nx", "float ny", "float nz"]
        columns.append(normal)
    if radius is not None:
        names.append("float radius")
        columns.append(radius[:, None])
    if color is not None:
        names += ["uchar red", "uchar green", "uchar blue"]
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(position)}",
        *(f"property {n}" for n in names),
        "end_header",
    ]
    rows = np.concatenate(columns, axis=1)
    body = [" ".join(f"{v:.9g}" for v in row) for row in rows]
    if color is not None:
        body = [f"{row} {r} {g} {b}" for row, (r, g, b) in zip(body, color, strict=True)]
    path.write_text("\n".join([*head, *body]) + "\n")


def imported(path) -> bpy.types.Object:
    bpy.ops.wm.ply_import(filepath=str(path))
    return bpy.context.object


def cloud_of(ob):
    scene = Synchronizer(GeometryCache()).scene(bpy.context.evaluated_depsgraph_get())
    (geometry,) = scene.geometries
    assert geometry.name == ob.name
    assert geometry.mesh is None
    return geometry.cloud


def test_a_scan_has_its_colours_and_half_its_spacing_as_radius(tmp_path):
    position = lattice()
    color = np.random.default_rng(0).integers(0, 256, (len(position), 3))
    ply(tmp_path / "scan.ply", position, color=color)
    cloud = cloud_of(imported(tmp_path / "scan.ply"))
    # The importer may turn axes; rows keep their order.
    assert len(cloud) == len(position)
    np.testing.assert_allclose(cloud.radii, SPACING / 2, rtol=1e-6)
    assert cloud.normal is None
    srgb = color / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(cloud.color, linear, atol=1e-4)  # float32 sRGB curves of two programs


def test_a_scan_has_its_normals_and_its_own_radii(tmp_path):
    position, radius = lattice(), np.linspace(0.01, 0.2, 6**3)
    normal = np.tile([0.0, 0.0, 1.0], (len(position), 1))
    ply(tmp_path / "scan.ply", position, normal=normal, radius=radius)
    cloud = cloud_of(imported(tmp_path / "scan.ply"))
    np.testing.assert_allclose(cloud.radii[:, 0], radius, rtol=1e-6)
    assert cloud.normal is not None
    assert np.abs(cloud.normal).max(axis=1) == pytest.approx(1)


def test_the_object_s_radius_comes_before_all_others(tmp_path):
    ply(tmp_path / "scan.ply", lattice(), radius=np.full(6**3, 0.1))
    ob = imported(tmp_path / "scan.ply")
    ob.pointsplat.radius = 0.0625
    assert (cloud_of(ob).radii == 0.0625).all()
    ob.pointsplat.radius = 0
    np.testing.assert_allclose(cloud_of(ob).radii, 0.1)


def test_meshes_with_edges_or_faces_are_no_scans():
    for edges, faces in (([(0, 1)], []), ([], [(0, 1, 2)])):
        data = bpy.data.meshes.new("mesh")
        data.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], edges, faces)
        ob = bpy.data.objects.new("mesh", data)
        bpy.context.collection.objects.link(ob)
        found = Synchronizer(GeometryCache()).scene(bpy.context.evaluated_depsgraph_get()).geometries
        assert all(geometry.cloud is None for geometry in found)
        assert len(found) == len(faces)
        bpy.data.objects.remove(ob)


def test_a_single_vertex_has_blender_s_radius():
    data = bpy.data.meshes.new("dot")
    data.from_pydata([(0, 0, 0)], [], [])
    ob = bpy.data.objects.new("dot", data)
    bpy.context.collection.objects.link(ob)
    np.testing.assert_allclose(cloud_of(ob).radii, 0.01)


def test_the_object_s_radius_overrides_that_of_point_clouds():
    ob = pointcloud("cloud", np.arange(9, dtype=np.float32).reshape(3, 3))
    np.testing.assert_allclose(cloud_of(ob).radii, 0.01)
    ob.pointsplat.radius = 0.5
    assert (cloud_of(ob).radii == 0.5).all()
