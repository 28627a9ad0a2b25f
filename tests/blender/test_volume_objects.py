"""OpenVDB grids as sparse arrays, and Volume objects of every origin as volumes of the scene."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest

from pointsplat_addon.formats.volumes import vdb

pytestmark = pytest.mark.usefixtures("empty_file")


@pytest.fixture
def openvdb():
    from pointsplat_addon.host.convert.volume import load_openvdb

    return load_openvdb()


def sync(synchronizer=None) -> Any:
    from pointsplat_addon.host.sync import Synchronizer

    depsgraph = bpy.context.evaluated_depsgraph_get()
    depsgraph.update()
    return (synchronizer or Synchronizer()).scene(depsgraph)


def linear(edge=0.1, offset=(1, 2, 3)):
    matrix = np.diag([edge, edge, edge, 1.0])
    matrix[:3, 3] = offset
    return matrix


def grid_of(openvdb, array, name="density", kind="FloatGrid", matrix=None, at=(0, 0, 0)):
    grid = getattr(openvdb, kind)()
    grid.copyFromArray(array, ijk=at)
    grid.name = name
    grid.transform = openvdb.createLinearTransform((np.eye(4) if matrix is None else matrix).T.tolist())
    return grid


def ball(n=24):
    x = np.linspace(-1, 1, n, dtype=np.float32)
    return (1 - (x[:, None, None] ** 2 + x[None, :, None] ** 2 + x[None, None] ** 2)).clip(0)


def volume_object(path, name="Smoke"):
    data = bpy.data.volumes.new(name)
    data.filepath = str(path)
    ob = bpy.data.objects.new(name, data)
    bpy.context.collection.objects.link(ob)
    return ob


def written(openvdb, path, *grids):
    openvdb.write(str(path), grids=list(grids))
    return path


# Files


def test_a_grid_comes_back_voxel_by_voxel(openvdb, tmp_path):
    array = ball()
    path = written(openvdb, tmp_path / "a.vdb", grid_of(openvdb, array, matrix=linear(), at=(-5, 1000, 7)))
    (grid,), messages = vdb.read(openvdb, path)
    assert messages == []
    place = grid.index - [-5, 1000, 7]
    np.testing.assert_array_equal(grid.value, array[tuple(place.T)])
    assert len(grid.index) == np.count_nonzero(array)
    np.testing.assert_allclose(grid.object_from_index, linear(), atol=1e-15)
    assert (np.lexsort(grid.index.T[::-1]) == np.arange(len(grid.index))).all()


def test_active_regions_far_apart_are_read_as_they_are(openvdb):
    random = np.random.default_rng(4)
    corners = random.integers(-30000, 30000, (30, 3))
    grid = openvdb.FloatGrid()
    expected = []
    for number, corner in enumerate(corners):
        size = random.integers(1, 40, 3)
        grid.fill(tuple(corner.tolist()), tuple((corner + size - 1).tolist()), number + 1.0, True)
        expected.append(np.stack(np.meshgrid(*map(np.arange, corner, corner + size), indexing="ij"), -1).reshape(-1, 3))
    found, messages = vdb.sparse(openvdb, grid)
    assert messages == []
    assert found is not None
    every = np.concatenate(expected)
    number = np.repeat(np.arange(30) + 1.0, [len(e) for e in expected])
    order = np.lexsort(every.T[::-1])
    np.testing.assert_array_equal(found.index, every[order])
    np.testing.assert_array_equal(found.value, number[order])


def test_scattered_voxels_and_constant_regions_are_read(openvdb):
    grid = openvdb.FloatGrid()
    for corner in ((0, 0, 0), (5000, -9000, 3), (2**20, 2**20, -(2**20))):
        grid.fill(corner, tuple(c + 1 for c in corner), 2.0, True)
    grid.fill((128, 128, 128), (255, 255, 255), 3.0, True)
    found, _ = vdb.sparse(openvdb, grid)
    assert found is not None
    assert len(found.index) == 3 * 8 + 128**3
    assert found.value.sum() == 2 * 24 + 3 * 128**3


def test_voxels_of_the_backgrounds_value_are_active_if_the_file_says_so(openvdb):
    grid = openvdb.FloatGrid(0.5)
    grid.fill((0, 0, 0), (2, 2, 2), 0.5, True)
    found, _ = vdb.sparse(openvdb, grid)
    assert found is not None
    assert len(found.index) == 27


@pytest.mark.parametrize(
    ("kind", "value", "expected"),
    [
        ("DoubleGrid", 1.5, 1.5),
        ("Int32Grid", -3, -3),
        ("Int64Grid", 7, 7),
        ("BoolGrid", True, 1),
        ("Vec3SGrid", (1.0, 2.0, 3.0), [1, 2, 3]),
        ("Vec3IGrid", (1, 2, 3), [1, 2, 3]),
    ],
)
def test_grids_of_other_types_become_floats(openvdb, kind, value, expected):
    grid = getattr(openvdb, kind)()
    grid.fill((1, 1, 1), (2, 2, 2), value, True)
    found, messages = vdb.sparse(openvdb, grid)
    assert found is not None
    assert messages == []
    np.testing.assert_array_equal(found.value, np.broadcast_to(np.float32(expected), (8, *np.shape(expected))))


def test_half_floats_and_values_that_are_not_numbers(openvdb, tmp_path):
    grid = grid_of(openvdb, np.full((4, 4, 4), 0.25, np.float32))
    grid.fill((0, 0, 0), (0, 0, 0), np.nan, True)
    grid.saveFloatAsHalf = True
    (found,), messages = vdb.read(openvdb, written(openvdb, tmp_path / "a.vdb", grid))
    assert (found.value == 0.25).all()
    assert messages == ['1 voxels of the grid "density" are not a number and are left out']


def test_a_level_set_is_filled_and_said_to_be_one(openvdb):
    radius, edge = 8.3, 0.1
    at = np.indices((24, 24, 24)) - 11.5
    distance = (np.sqrt((at**2).sum(axis=0)) - radius) * edge
    grid = openvdb.FloatGrid(3 * edge)
    grid.copyFromArray(np.clip(distance, -3 * edge, 3 * edge).astype(np.float32))
    grid.name, grid.gridClass = "surface", openvdb.GridClass.LEVEL_SET
    grid.transform = openvdb.createLinearTransform(edge)
    grid.signedFloodFill()
    found, messages = vdb.sparse(openvdb, grid)
    assert found is not None
    assert "level set" in messages[0]
    assert found.value.sum() == pytest.approx(4 / 3 * np.pi * radius**3, rel=5e-3)  # measured 2.7e-3


def test_a_missing_or_broken_file_and_one_of_points_are_told(openvdb, tmp_path):
    with pytest.raises(OSError, match="nowhere"):
        vdb.read(openvdb, tmp_path / "nowhere.vdb")
    good = written(openvdb, tmp_path / "a.vdb", grid_of(openvdb, ball()))
    (tmp_path / "cut.vdb").write_bytes(good.read_bytes()[:3000])
    with pytest.raises(OSError, match=r"cut\.vdb cannot be read"):
        vdb.read(openvdb, tmp_path / "cut.vdb")
    assert vdb.read(openvdb, written(openvdb, tmp_path / "empty.vdb", openvdb.FloatGrid())) == ([], [])


def test_grids_are_brought_to_one_lattice(openvdb):
    fine, coarse, shifted = ball(), np.full((8, 8, 8), 5.0, np.float32), np.ones((3, 3, 3), np.float32)
    grids = [
        vdb.sparse(openvdb, grid)[0]
        for grid in (
            grid_of(openvdb, fine, matrix=linear(0.1)),
            grid_of(openvdb, shifted, "mask", matrix=linear(0.1), at=(-2, 3, 3)),
            grid_of(openvdb, coarse, "temperature", matrix=linear(0.3)),
        )
    ]
    both, messages = vdb.combine([g for g in grids if g])
    assert messages == ['the grid "temperature" has a lattice of its own and is resampled to that of "density"']
    lookup = {tuple(i): row for row, i in enumerate(both.index.tolist())}
    assert len(lookup) == len(both.index) == np.count_nonzero(fine) + 27  # the corner of the mask lies outside the ball
    assert both.values["density"][lookup[12, 12, 12]] == fine[12, 12, 12]
    assert both.values["density"][lookup[-1, 4, 4]] == 0
    assert both.values["mask"][lookup[-1, 4, 4]] == 1
    inner = (both.index >= 0).all(axis=1) & (both.index <= 21).all(axis=1)
    np.testing.assert_allclose(both.values["temperature"][inner], 5, rtol=1e-6)
    # Half way to where the coarse grid ends
    assert both.values["temperature"][lookup[12, 12, 22]] == pytest.approx(5 * 2 / 3)


def test_what_is_written_is_read(openvdb, tmp_path):
    array, matrix = ball(), linear(0.02, (5, 6, 7))
    matrix[:3, :3] = matrix[:3, :3] @ [[0, -1, 0], [1, 0, 0], [0, 0, 2]]
    count = vdb.write(openvdb, tmp_path / "a.vdb", "density", array, matrix, 0.0)
    (grid,), _ = vdb.read(openvdb, tmp_path / "a.vdb")
    assert count == len(grid.index) == np.count_nonzero(array)
    np.testing.assert_allclose(grid.object_from_index, matrix, atol=1e-12)


# Objects


def test_a_volume_of_a_file_is_read_once_and_shared(openvdb, tmp_path):
    from pointsplat_addon.host.sync import Synchronizer

    path = written(openvdb, tmp_path / "a.vdb", grid_of(openvdb, ball(), matrix=linear()))
    first, second = volume_object(path), volume_object(path, "Copy")
    second.location = (5, 0, 0)
    other = volume_object(written(openvdb, tmp_path / "b.vdb", grid_of(openvdb, 2 * ball(8))), "Other")
    synchronizer = Synchronizer()
    scene = sync(synchronizer)
    assert not scene.warnings
    assert len(scene.geometries) == 2
    assert sorted(scene.instances.names) == sorted([first.name, second.name, other.name])
    volume = scene.geometries[0].volume
    assert set(volume.grids) == {"density"}
    np.testing.assert_allclose(volume.object_from_index, linear(), atol=1e-6)
    first.location = (0, 0, 9)
    assert sync(synchronizer).geometries[0] is scene.geometries[0]


def test_a_sequence_shows_the_file_of_its_frame(openvdb, tmp_path):
    for frame in (1, 2):
        written(openvdb, tmp_path / f"s_{frame:03d}.vdb", grid_of(openvdb, frame * np.ones((3, 3, 3), np.float32)))
    ob = volume_object(tmp_path / "s_001.vdb")
    ob.data.is_sequence = True
    ob.data.frame_duration = 2
    from pointsplat_addon.host.sync import Synchronizer

    synchronizer = Synchronizer()
    for frame in (1, 2, 1):
        bpy.context.scene.frame_set(frame)
        assert (sync(synchronizer).geometries[0].volume.grids["density"] == frame).all()


def test_modifiers_and_nodes_give_volumes(openvdb, tmp_path):
    path = written(openvdb, tmp_path / "a.vdb", grid_of(openvdb, np.ones((16, 16, 16), np.float32), matrix=linear()))
    displaced = volume_object(path, "Displaced")
    displaced.modifiers.new("Displace", "VOLUME_DISPLACE").texture = bpy.data.textures.new("Clouds", "CLOUDS")
    bpy.ops.mesh.primitive_cube_add(size=2)
    cube = bpy.context.object
    filled = bpy.data.objects.new("Filled", bpy.data.volumes.new("Filled"))
    bpy.context.collection.objects.link(filled)
    modifier = filled.modifiers.new("Fill", "MESH_TO_VOLUME")
    modifier.object, modifier.voxel_amount = cube, 16
    bpy.ops.mesh.primitive_cube_add(size=2)
    maker = bpy.context.object
    maker.name = "Maker"
    tree = bpy.data.node_groups.new("Cube", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    tree.links.new(tree.nodes.new("GeometryNodeVolumeCube").outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    maker.modifiers.new("Cube", "NODES").node_group = tree

    scene = sync()
    assert not scene.warnings
    found = {scene.instances.names[i]: scene.geometries[g].volume for i, g in enumerate(scene.instances.geometry)}
    volumes = {name: volume for name, volume in found.items() if volume}
    assert set(volumes) == {"Displaced", "Filled", "Maker"}
    assert len(volumes["Maker"].index) == 32**3
    place = volumes["Filled"].index @ volumes["Filled"].object_from_index[:3, :3].T
    assert np.abs(place).max() == pytest.approx(1, abs=0.25)
    assert len(volumes["Displaced"].index) != 16**3


def test_missing_and_empty_files_are_told_with_the_objects_name(openvdb, tmp_path):
    volume_object(tmp_path / "nowhere.vdb", "Gone")
    volume_object("", "Nothing")
    array = ball(8)
    grid = grid_of(openvdb, array)
    grid.gridClass = openvdb.GridClass.LEVEL_SET
    volume_object(written(openvdb, tmp_path / "a.vdb", grid), "Surface")
    scene = sync()
    assert any(w.startswith("Gone: ") and "nowhere.vdb" in w for w in scene.warnings)
    assert any(w.startswith("Surface: ") and "level set" in w for w in scene.warnings)
    assert len(scene.warnings) == 2


def test_only_the_grids_that_are_used_are_read(openvdb, tmp_path):
    grids = [grid_of(openvdb, ball(), name) for name in ("density", "heat", "fuel")]
    ob = volume_object(written(openvdb, tmp_path / "a.vdb", *grids))
    assert set(sync().geometries[0].volume.grids) == {"density"}
    ob.pointsplat.use_transfer = True
    ob.pointsplat.transfer_grid = "heat"
    with bpy.context.temp_override(object=ob):
        bpy.ops.pointsplat.transfer_ramp()
    assert set(sync().geometries[0].volume.grids) == {"heat"}


def test_the_ramp_of_an_object_is_its_transfer_function(openvdb, tmp_path):
    from pointsplat_addon.host.sync import Synchronizer

    ob = volume_object(written(openvdb, tmp_path / "a.vdb", grid_of(openvdb, ball())))
    synchronizer = Synchronizer()
    before = sync(synchronizer).geometries[0]
    assert before.volume.transfer is None
    with bpy.context.temp_override(object=ob):
        bpy.ops.pointsplat.transfer_ramp()
    ob.pointsplat.use_transfer = True
    ob.pointsplat.transfer_low, ob.pointsplat.transfer_high, ob.pointsplat.transfer_density = -1, 2, 7
    ramp = ob.pointsplat.transfer_texture.color_ramp
    ramp.elements[0].color, ramp.elements[1].color = (1, 0, 0, 0), (0, 0, 1, 1)
    after = sync(synchronizer).geometries[0]
    transfer = after.volume.transfer
    assert (transfer.grid, transfer.low, transfer.high, transfer.density) == ("density", -1, 2, 7)
    np.testing.assert_allclose(transfer.ramp[[0, -1]], [[1, 0, 0, 0], [0, 0, 1, 1]], atol=1e-6)
    # Another function over the same voxels
    assert after.key != before.key
    assert after.volume.index is before.volume.index
    ramp.elements[1].color = (0, 1, 0, 1)
    again = sync(synchronizer).geometries[0]
    np.testing.assert_allclose(again.volume.transfer.ramp[-1], [0, 1, 0, 1], atol=1e-6)
    assert again.volume.key == after.volume.key


def test_an_array_becomes_a_volume_object_of_a_chosen_size(tmp_path):
    array = np.zeros((20, 10, 5), np.int16)
    array[4:9, 2:7, 1:4] = np.arange(75).reshape(5, 5, 3) - 10
    np.save(tmp_path / "scan.npy", array)
    assert bpy.ops.pointsplat.import_volume(filepath=str(tmp_path / "scan.npy"), size=4) == {"FINISHED"}
    ob = bpy.context.object
    assert (ob.type, ob.name) == ("VOLUME", "scan")
    scene = sync()
    assert not scene.warnings
    volume = scene.geometries[0].volume
    # The lowest value is the background.
    assert len(volume.index) == 999
    value = dict(zip(map(tuple, volume.index.tolist()), volume.grids["density"].tolist(), strict=True))
    assert value[8, 6, 3] == 64
    corner = volume.object_from_index @ [-0.5, -0.5, -0.5, 1]
    np.testing.assert_allclose(corner[:3], [-2, -1, -0.5], atol=1e-6)
    assert (volume.transfer.low, volume.transfer.high) == (-10, 64)
    # A second import does not overwrite the first one's file.
    bpy.ops.pointsplat.import_volume(filepath=str(tmp_path / "scan.npy"))
    assert {p.name for p in tmp_path.glob("*.vdb")} == {"scan.vdb", "scan.001.vdb"}


def test_a_file_that_is_no_volume_is_told(tmp_path):
    np.save(tmp_path / "flat.npy", np.ones((3, 3)))
    with pytest.raises(RuntimeError, match="expected three dimensions"):
        bpy.ops.pointsplat.import_volume(filepath=str(tmp_path / "flat.npy"))
    with pytest.raises(RuntimeError, match="No such file"):
        bpy.ops.pointsplat.import_volume(filepath=str(tmp_path / "gone.nii"))
    assert len(bpy.data.objects) == 0


class Floats(list):
    """As Blender's arrays of floats: read into a buffer."""

    def foreach_get(self, buffer):
        buffer[:] = self


def test_a_fluid_domains_smoke_is_where_its_cells_are():
    from pointsplat_addon.host.convert.volume import smoke

    shape, edge = np.array([4, 3, 2]), np.array([0.5, 0.5, 0.5])
    for finer in (1, 2):
        z, y, x = np.indices((2 * finer, 3 * finer, 4 * finer))
        density = np.where((x == 2) & (y == 1), z + 1.0, 0).ravel()
        domain = SimpleNamespace(
            domain_resolution=shape, start_point=(-1, 0, 5), cell_size=edge, density_grid=Floats(density),
            flame_grid=Floats(), heat_grid=Floats(), temperature_grid=Floats(2 * density),
        )  # fmt: skip
        grids = smoke(domain).grids
        assert grids is not None
        assert set(grids.values) == {"density", "temperature"}
        np.testing.assert_array_equal(grids.values["density"], np.arange(2 * finer) + 1)
        np.testing.assert_array_equal(grids.values["temperature"], 2 * grids.values["density"])
        first = grids.index[0] @ grids.object_from_index[:3, :3].T + grids.object_from_index[:3, 3]
        np.testing.assert_allclose(first, [-1, 0, 5] + (np.array([2, 1, 0]) + 0.5) * edge / finer)


def test_a_domain_before_its_simulation_holds_nothing():
    bpy.ops.mesh.primitive_cube_add()
    modifier = bpy.context.object.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "DOMAIN"
    modifier.domain_settings.domain_type = "GAS"
    scene = sync()
    assert len(scene.geometries) == 0
    assert not scene.warnings
