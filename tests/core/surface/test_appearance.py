"""Material graphs over meshes: the same at samples, at corners, and in baked pictures."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.baking import BORDER
from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.masks import is_mask
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, math_nodes, ramp_nodes, texture_nodes
from pointsplat_addon.core.scene.materials import default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.splat.kernel import PEAK, SUPPORT, kernel
from pointsplat_addon.core.surface.appearance import (
    at_corners,
    at_samples,
    baked,
    ball_extinction,
    corner_normals,
    digest,
    pictured,
    point_cloud,
    split_translucent,
    uv_of,
)
from pointsplat_addon.core.surface.evaluation import evaluate
from pointsplat_addon.core.surface.sample_areas import sample_areas
from pointsplat_addon.core.surface.sampling import sample_mesh

POSITION = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def square(**more) -> Mesh:
    """The unit square in XY, whose UV map is its position."""
    uv = POSITION[TRIANGLES][..., :2].copy()
    return Mesh("square", "Square", POSITION, TRIANGLES, uv={"UV": uv}, active_uv="UV", **more)


def table(*graphs, translucent=None, **columns):
    base = default_materials()
    count = max(len(graphs), 1)
    names = [f for f in base.__dataclass_fields__ if isinstance(getattr(base, f), np.ndarray)]
    repeated = {name: np.repeat(getattr(base, name), count, axis=0) for name in names}
    changed = {name: np.asarray(v, repeated[name].dtype) for name, v in columns.items()}
    return replace(
        base,
        **repeated | changed,
        translucent=None if translucent is None else np.array(translucent),
        names=tuple("m" * count),
        graphs=graphs or (None,),
    )


def ramp():
    """Colour (u, v, 0)."""
    return color_nodes.Color(input_nodes.UV())


def samples_of(mesh, spacing=0.05, method="AREA"):
    samples = sample_mesh(mesh, spacing, method)
    return samples, evaluate(mesh, samples)


def test_constants_cost_nothing():
    mesh = square()
    samples, evaluated = samples_of(mesh)
    cloud = point_cloud(mesh, samples, evaluated, table())
    assert cloud.color is cloud.surface is cloud.emission is cloud.shading_normal is None


def test_a_graph_is_evaluated_at_the_samples_own_place():
    mesh = square()
    samples, evaluated = samples_of(mesh)
    cloud = point_cloud(mesh, samples, evaluated, table(MaterialGraph(base_color=ramp())))
    where = cloud.position + cloud.origin
    assert cloud.color is not None
    np.testing.assert_allclose(cloud.color[:, :2], where[:, :2], atol=1e-6)  # measured 1.2e-7
    assert not cloud.color[:, 2].any()


def test_each_material_has_its_own_graph_and_constants_fill_the_rest():
    mesh = square(material=np.array([0, 1], np.uint16), materials=(0, 1))
    samples, evaluated = samples_of(mesh)
    graphs = MaterialGraph(base_color=ramp()), MaterialGraph(roughness=input_nodes.Constant((0.25,)))
    colors = np.array([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], np.float32)
    look = at_samples(mesh, samples, evaluated, table(*graphs, base_color=colors, metallic=[0.0, 1.0]))
    first = samples.triangle == 0
    assert look.color is not None
    assert look.surface is not None
    np.testing.assert_allclose(look.color[first, :2], evaluated.position[first, :2] + evaluated.origin[:2], atol=1e-6)
    assert (look.color[~first] == colors[1]).all()
    assert (look.surface[first] == np.array([0.5, 0.0], np.float32)).all()
    assert (look.surface[~first] == np.array([0.25, 1.0], np.float32)).all()
    assert look.emission is look.normal is look.alpha is None


def test_samples_are_cut_out_where_alpha_is_below_a_half():
    mesh = square()
    samples, evaluated = samples_of(mesh)
    cloud = point_cloud(
        mesh, samples, evaluated, table(MaterialGraph(alpha=color_nodes.Component(input_nodes.UV(), 0)))
    )
    x = cloud.position[:, 0] + cloud.origin[0]
    assert 0.4 < len(cloud) / len(samples) < 0.6
    assert x.min() >= 0.5 - 1e-6


def test_corners_agree_with_samples_there():
    mesh = square()
    graphs = {0: MaterialGraph(base_color=ramp())}
    look = at_corners(mesh, table(*graphs.values()), graphs, np.zeros(2, int))
    assert look.color is not None
    np.testing.assert_array_equal(look.color[:, :2], POSITION[TRIANGLES].reshape(-1, 3)[:, :2])


def test_a_baked_picture_holds_the_graph_at_the_texels_centres():
    color = baked(MaterialGraph(base_color=ramp()), 64)["base_color"]
    color = color[BORDER:-BORDER, BORDER:-BORDER]
    height, width = color.shape[:2]
    assert max(height, width) <= 64
    np.testing.assert_allclose(color[0, :, 0], (np.arange(width) + 0.5) / width, atol=1e-6)  # measured 3e-8
    np.testing.assert_allclose(color[:, 0, 1], (np.arange(height) + 0.5) / height, atol=1e-6)


def test_what_does_not_repeat_is_not_baked_where_uvs_leave_the_square():
    mesh = square()
    outside = replace(mesh, uv={"UV": mesh.uv["UV"] * 2})
    graph = MaterialGraph(base_color=ramp())
    assert pictured(mesh, graph)
    assert not pictured(outside, graph)


def test_a_missing_uv_map_reads_as_zero():
    mesh = replace(square(), uv={}, active_uv=None)
    graph = MaterialGraph(base_color=ramp())
    assert not uv_of(mesh, graph).any()
    assert uv_of(square(), graph).max() == 1


def test_a_digest_tells_what_changes_the_look():
    mesh, graph = square(), MaterialGraph(base_color=ramp())
    known = digest(mesh, table(graph))
    assert digest(mesh, table(MaterialGraph(base_color=ramp()))) == known
    assert digest(mesh, table(graph, roughness=[0.7])) != known
    assert digest(mesh, table(MaterialGraph(roughness=graph.base_color))) != known
    assert digest(mesh, table()) == digest(mesh, table(roughness=[0.7]))  # constants are read when shading


def test_smooth_normals_are_kept_beside_the_splats_plane_only_where_they_differ():
    up = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    leaning = up + np.array([0.3, 0, 0], np.float32) * (POSITION[:, :1] - 0.5)
    leaning = (leaning / np.linalg.norm(leaning, axis=1, keepdims=True)).astype(np.float32)
    for normal, differs in ((up, False), (leaning, True)):
        mesh = square(vertex_normal=normal)
        samples, evaluated = samples_of(mesh)
        cloud = point_cloud(mesh, samples, evaluated, table())
        assert (cloud.shading_normal is not None) == differs
        assert cloud.normal is not None
        np.testing.assert_allclose(np.abs(cloud.normal[:, 2]), 1, atol=1e-6)


def test_corner_normals_come_from_the_mesh_or_its_triangles():
    flat = corner_normals(square())
    np.testing.assert_allclose(flat, np.tile([0, 0, 1], (6, 1)), atol=1e-7)
    smooth = _unit_rows(np.arange(12, dtype=np.float32).reshape(4, 3) + 1)
    np.testing.assert_array_equal(corner_normals(square(vertex_normal=smooth)), smooth[TRIANGLES.ravel()])
    corners = _unit_rows(np.arange(18, dtype=np.float32).reshape(6, 3) + 1).reshape(2, 3, 3)
    np.testing.assert_array_equal(corner_normals(square(corner_normal=corners)), corners.reshape(-1, 3))


# Translucent surfaces


def masses(cloud):
    """(N,) float64: the splats' optical depths times their areas."""
    return (
        -np.log1p(-cloud.opacity.astype(np.float64)) * np.pi * cloud.radii[:, 0].astype(np.float64) * cloud.radii[:, -1]
    )


@pytest.mark.parametrize("method", ["VERTICES", "AREA"])
@pytest.mark.parametrize("spacing", [2.0, 0.31, 0.1, 0.013])
def test_the_optical_mass_of_a_veil_is_that_of_its_area(spacing, method):
    bent = POSITION * np.array([3, 1, 1], np.float32)
    bent[2, 2] = 0.7
    mesh = replace(square(), position=bent)
    a, b, c = bent[TRIANGLES].astype(float).transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    samples, evaluated = samples_of(mesh, spacing, method)
    cloud = point_cloud(mesh, samples, evaluated, table(alpha=[0.3], translucent=[True]))
    assert masses(cloud).sum() == pytest.approx(-np.log(0.7) * area, rel=1e-6)  # measured 1.1e-7


def test_a_sample_stands_for_what_of_the_triangle_lies_in_its_cell():
    """Samples of one triangle in the unit square: the area to the left of a line between columns is a trapezium's."""
    mesh = Mesh("t", "T", np.array([[0, 0, 0], [4, 0, 0], [1.5, 3, 0]], np.float32), np.array([[0, 1, 2]], np.int32))
    samples = sample_mesh(mesh, 0.25, "AREA")
    area = sample_areas(mesh, samples)
    y = samples.barycentric[:, 1].astype(float)  # over the height, 3
    rows = 12
    for row in range(rows):
        # The roof lowers the centres of a row's outer cells, so that only rows can be told apart by their centres.
        inside = (y * rows >= row) & (y * rows < row + 1)
        strip = 6 * ((1 - row / rows) ** 2 - (1 - (row + 1) / rows) ** 2)
        assert area[inside].sum() == pytest.approx(strip, rel=1e-5)
    # A cell's ellipse is spanned by half-diameters that are its sides over the root of 2; those at the edges are cut.
    assert samples.ellipse is not None
    cell = 6 * 4 * np.abs(np.linalg.det(samples.ellipse.astype(float)))
    assert (area <= cell * (1 + 1e-4)).all()
    assert np.isclose(area, cell, rtol=1e-4).mean() > 0.7  # measured 0.78


def test_a_pose_keeps_each_samples_share_of_its_triangle():
    mesh = square()
    samples, _ = samples_of(mesh, 0.11)
    stretched = replace(mesh, position=mesh.position * np.array([2, 3, 1], np.float32))
    np.testing.assert_allclose(sample_areas(stretched, samples), 6 * sample_areas(mesh, samples), rtol=1e-12)


def test_opaque_samples_of_a_translucent_material_have_the_largest_depth_and_clear_ones_are_left_out():
    mesh = square()
    samples, evaluated = samples_of(mesh)
    stripes = math_nodes.Math(
        color_nodes.Component(input_nodes.UV(), 0),
        input_nodes.Constant((0.5,)),
        input_nodes.Constant((0.0,)),
        "GREATER_THAN",
    )
    cloud = point_cloud(mesh, samples, evaluated, table(MaterialGraph(alpha=stripes), translucent=[True]))
    assert cloud.opacity is not None
    x = cloud.position[:, 0] + cloud.origin[0]
    assert len(cloud) == (evaluated.position[:, 0] + evaluated.origin[0] > 0.5).sum()
    assert x.min() > 0.5
    assert cloud.opacity.min() > 0.999  # a share of the depth of 100


def test_alpha_is_evaluated_at_each_sample():
    mesh = square()
    samples, evaluated = samples_of(mesh, 0.01)
    half = math_nodes.Math(
        color_nodes.Component(input_nodes.UV(), 0),
        input_nodes.Constant((0.5,)),
        input_nodes.Constant((0.0,)),
        "MULTIPLY",
    )
    cloud = point_cloud(mesh, samples, evaluated, table(MaterialGraph(alpha=half), translucent=[True]))
    # The integral of -ln(1 - x/2) from 0 to 1.
    assert masses(cloud).sum() == pytest.approx(1 - np.log(2), rel=1e-4)  # measured 6.8e-6


def test_a_mesh_of_one_kind_is_its_own_part():
    mesh = square()
    assert split_translucent(mesh, table()) == (mesh, None)
    assert split_translucent(mesh, table(translucent=[False])) == (mesh, None)
    assert split_translucent(mesh, table(alpha=[0.5], translucent=[True])) == (None, mesh)
    assert split_translucent(mesh, table(alpha=[0.0], translucent=[True])) == (None, None)


def test_parts_by_material_hold_all_triangles_and_have_keys_of_their_own():
    corners = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    mesh = square(material=np.array([0, 1], np.uint16), materials=(0, 1), corner_normal=corners, topology="t")
    materials = table(None, None, alpha=[1.0, 0.5], translucent=[False, True])
    opaque, translucent = split_translucent(mesh, materials)
    assert opaque is not None
    assert translucent is not None
    assert len({mesh.key, opaque.key, translucent.key}) == 3
    assert len({mesh.topology, opaque.topology, translucent.topology}) == 3
    for row, part in enumerate((opaque, translucent)):
        np.testing.assert_array_equal(part.triangles, TRIANGLES[row : row + 1])
        assert part.corner_normal is not None
        np.testing.assert_array_equal(part.corner_normal, corners[row : row + 1])
        np.testing.assert_array_equal(part.uv["UV"], mesh.uv["UV"][row : row + 1])
        assert part.materials == (row,)
        assert part.position is mesh.position
    # What the other part looks like does not change this one's key.
    again, _ = split_translucent(mesh, replace(materials, alpha=np.array([1, 0.9], np.float32)))
    assert again is not None
    assert again.key == opaque.key
    assert digest(translucent, materials) != digest(translucent, replace(materials, alpha=np.ones(2, np.float32)))


def test_an_alpha_that_varies_from_zero_is_not_dropped():
    mesh, graph = square(), MaterialGraph(alpha=color_nodes.Component(input_nodes.UV(), 0))
    assert split_translucent(mesh, table(graph, alpha=[1.0], translucent=[True])) == (None, mesh)


def _unit_rows(v):
    return (v / np.linalg.norm(v, axis=1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("method", ["VERTICES", "AREA"])
def test_a_veil_of_overlapping_splats_is_even(method):
    """The splats' kernels, with standard deviations of half their half-axes, add up to -ln(1 - alpha) everywhere
    within the veil."""
    steps = np.linspace(0, 1, 21)
    x, y = (a.ravel() for a in np.meshgrid(steps, steps))
    corner = (np.arange(20)[:, None] * 21 + np.arange(20)).ravel()
    quads = np.stack([corner, corner + 1, corner + 22, corner + 21], axis=1)
    grid = Mesh(
        "grid",
        "Grid",
        np.stack([x, y, 0 * x], axis=1).astype(np.float32),
        np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32),
    )
    mesh = grid if method == "VERTICES" else square()
    samples, evaluated = samples_of(mesh, 0.05, method)
    cloud = point_cloud(mesh, samples, evaluated, table(alpha=[0.3], translucent=[True]))
    assert cloud.radii is not None
    across = cloud.axis[:, :2] if cloud.axis is not None else np.tile([1.0, 0.0], (len(cloud), 1))
    sigma = cloud.radii.astype(float) / 2
    where = np.random.default_rng(5).random((400, 2)) * 0.6 + 0.2
    d = where[:, None] - (cloud.position + cloud.origin)[None, :, :2]
    u, v = (d * across).sum(axis=2), d[..., 1] * across[:, 0] - d[..., 0] * across[:, 1]
    exponent = (u / sigma[:, 0]) ** 2 + (v / sigma[:, -1]) ** 2
    depth = (masses(cloud) * kernel(exponent) / (2 * np.pi * sigma[:, 0] * sigma[:, -1])).sum(axis=1)
    np.testing.assert_allclose(depth, -np.log(0.7), rtol=1e-2)  # measured 5.2e-3


def test_the_kernel_of_a_ball_holds_its_mass_and_has_its_alpha_at_the_centre():
    alpha, radius = np.array([0.2, 0.9]), np.array([0.5, 3.0])
    mass = 4 / 3 * np.pi * radius**3 * ball_extinction(alpha, radius)
    step = np.linspace(0, SUPPORT**0.5, 4001) * radius[:, None] / 2  # in standard deviations
    x = (step[:, 1:] + step[:, :-1]) / 2
    profile = kernel(4 * (x / radius[:, None]) ** 2) / PEAK
    whole = (2 * np.pi * x * profile * np.diff(step)).sum(axis=1)
    np.testing.assert_allclose(1 - np.exp(-mass / whole), alpha, rtol=1e-6)  # measured 1.6e-8
    small = ball_extinction(np.array([0.5, 1]), np.array([0, 1e-44]))
    assert small[0] == 0
    assert np.isfinite(small).all()


def test_masks_are_told_from_gradients():
    def picture(alpha):
        texels = np.ones((8, 8, 4), np.float32)
        texels[..., 3] = alpha
        return color_nodes.Component(texture_nodes.ImageTexture(input_nodes.UV(), Image(texels)), 3)

    hole, edge, fog = np.eye(8), np.where(np.arange(64) < 4, 0.5, 1).reshape(8, 8), np.full((8, 8), 0.5)
    vertex = color_nodes.Component(input_nodes.ColorAttribute("Col"), 3)
    half, one, zero = (input_nodes.Constant((v,)) for v in (0.5, 1.0, 0.0))
    assert is_mask(picture(hole))
    assert is_mask(picture(edge))
    assert not is_mask(picture(fog))
    assert not is_mask(vertex)
    assert is_mask(math_nodes.Math(vertex, half, zero, "GREATER_THAN"))
    assert is_mask(math_nodes.Math(one, picture(hole), zero, "SUBTRACT"))
    assert not is_mask(math_nodes.Math(half, picture(hole), zero, "MULTIPLY"))
    assert is_mask(color_nodes.Mix(picture(hole), one, zero))
    assert not is_mask(color_nodes.Mix(vertex, one, zero))
    stops = np.array([0, 0.5], np.float32)
    for interpolation, expected in (("CONSTANT", True), ("LINEAR", False)):
        colors = np.array([[0, 0, 0, 1], [1, 1, 1, 1]], np.float32)
        assert (
            is_mask(color_nodes.Gray(color_nodes.Color(ramp_nodes.ColorRamp(vertex, stops, colors, interpolation))))
            == expected
        )
