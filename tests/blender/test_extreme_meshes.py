"""What float32 leaves of places in Blender's meshes and objects, PointSplat keeps: it rounds nothing again."""

from __future__ import annotations

import bpy
import numpy as np
import pytest

from pointsplat_addon.core.scene.cloud import FARTHEST
from tests.support.blender.scenes import mesh_object, pointcloud, sync

pytestmark = pytest.mark.usefixtures("empty_file")

SQUARE = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float64)


@pytest.mark.parametrize("place", [0.0, 1e3, 8e3, 1e5, 1e8, -1e8, 1e30])
def test_vertices_come_as_blender_has_them(place):
    """Detail of a thousandth is there up to 8,000 units from the mesh's origin, and no farther."""
    vertices = SQUARE * 1e-3 + place
    mesh_object("Far", vertices.tolist(), [(0, 1, 2, 3)])
    found = sync().geometries[0].mesh
    np.testing.assert_array_equal(found.position, vertices.astype(np.float32))
    kept = np.abs(np.ptp(found.position.astype(np.float64), axis=0)[:2] / 1e-3 - 1).max()
    assert (kept < 0.5) == (abs(place) <= 8e3)  # measured 0.47 at 8e3, where float32 steps by 4.9e-4; 6.8 at 1e5


@pytest.mark.parametrize("place", [0.0, 1e5, 1e8, 1e30])
@pytest.mark.parametrize("scale", [(1, 1, 1), (1e-6, 1e-6, 1e-6), (-1, 1, 1), (1e9, 1e-9, 1)])
def test_matrices_come_as_blender_has_them(place, scale):
    ob = mesh_object("Placed", SQUARE.tolist(), [(0, 1, 2, 3)])
    ob.location, ob.scale = (place, -place, 0), scale
    scene = sync()
    matrix = np.diag([*scale, 1.0])
    matrix[:2, 3] = place, -place
    np.testing.assert_array_equal(scene.instances.world_from_object[0], matrix.astype(np.float32))


@pytest.mark.parametrize("odd", [np.nan, np.inf, -np.inf, 1e-42, 3e38])
def test_odd_values_of_attributes_come_through_and_are_left_out_when_drawn(odd):
    """Conversion raises nothing; what draws it leaves the points out (tests/extreme/test_values.py)."""
    from pointsplat_addon.core.scene.valid.geometry import valid_points

    position = np.arange(12, dtype=np.float32).reshape(4, 3)
    position[1] = odd
    radius = np.ones(4, np.float32)
    radius[2] = odd
    pointcloud("Odd", position, radius=("FLOAT", "value", radius))
    cloud = sync().geometries[0].cloud
    kept, dropped = valid_points(cloud)
    assert dropped == (0 if abs(odd) < FARTHEST else 2)
    for array in kept.arrays().values():
        assert np.isfinite(array).all()


def test_a_light_that_is_nowhere_lights_nothing_and_is_said():
    data = bpy.data.lights.new("Lost", "POINT")
    ob = bpy.data.objects.new("Lost", data)
    bpy.context.collection.objects.link(ob)
    ob.location = (float("nan"), 0, 0)
    scene = sync()
    assert scene.lights == ()
    assert any("Lost" in warning for warning in scene.warnings)
