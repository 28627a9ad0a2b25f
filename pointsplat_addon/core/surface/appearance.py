"""Material graphs over meshes: evaluated at samples (points), at corners or over the UV square (polygons)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..material.baking import bake, bakeable, stored, suggested_resolution
from ..material.evaluation import Appearance, evaluate_materials, triangle_tangents
from ..material.expression import Part, SampleInputs, walk
from ..material.graph import MaterialGraph, needs
from ..material.nodes.color_nodes import Color, Component
from ..material.nodes.input_nodes import UV, Attribute, ColorAttribute, Constant, Coordinates
from ..material.nodes.math_functions import normalize_rows
from ..scene.cloud import PointCloud
from ..scene.materials import MaterialTable
from ..scene.mesh import Mesh
from ..scene.scene import Instances
from ..scene.valid.geometry import valid_points
from ..splat.kernel import PEAK
from .evaluation import Evaluated
from .sample_areas import patch_shares, sample_areas
from .samples import Samples, difference_along_half_axes, interpolate, material_ids

CLIP = 0.5  # of alpha: surfaces that are not translucent are cut out below it
OPAQUE = 100.0  # the largest optical depth
STEP = 0.125  # of the way to a splat's rim, over which the change of heights is taken
# Half-axes of translucent splats over those that cover the surface: sums of kernels are then even within 0.6 percent,
# also where samples are no perfect lattice (where they are, 2 EVEN sqrt(2) = 1.1 does; elsewhere that errs by 4).
OVERLAP = 1.7


def graphs_of(mesh: Mesh, table: MaterialTable) -> dict[int, MaterialGraph]:
    """The graphs of the materials that a mesh uses, by row."""
    found = {row: table.graphs[row] for row in mesh.materials if row < len(table.graphs)}
    return {row: graph for row, graph in found.items() if isinstance(graph, MaterialGraph)}


def digest(mesh: Mesh, table: MaterialTable) -> str:
    """Equal digests give a mesh the same appearance: the graphs and the constants that fill their gaps."""
    parts = [f"{row}:{graph.digest}" for row, graph in graphs_of(mesh, table).items()]
    if parts:
        rows = list(mesh.materials)
        parts += [table.base_color[rows].tobytes().hex(), table.emission[rows].tobytes().hex()]
        parts += [table.roughness[rows].tobytes().hex(), table.metallic[rows].tobytes().hex()]
    read = frozenset().union(*(needs(graph).objects for graph in graphs_of(mesh, table).values()))
    parts += [mesh.objects[name][:1].tobytes().hex() for name in sorted(read & mesh.objects.keys())]
    if (passes := passing(mesh, table)) is not None:
        rows = list(mesh.materials)
        parts += [passes[rows].tobytes().hex(), table.alpha[rows].tobytes().hex()]
        if table.transmission_color is not None:
            parts.append(table.transmission_color[rows].tobytes().hex())
    return "|".join(parts)


def shown_by(mesh: Mesh, instances: Instances, row: int) -> Mesh:
    """The mesh as one of the instances shows it, where its materials read values of objects."""
    if not mesh.objects or not instances.objects:
        return mesh
    return replace(mesh, objects={name: values[row : row + 1] for name, values in instances.objects.items()})


def hiding(table: MaterialTable) -> MaterialTable:
    """What of the materials decides how much light they let through: their alphas and transmission colours, and graphs
    of nothing else. All other constants are 0, so that digests of shadows' samples do not tell them apart."""
    graphs = [
        MaterialGraph(alpha=graph.alpha, transmission_color=graph.transmission_color)
        if isinstance(graph, MaterialGraph)
        else MaterialGraph()
        for graph in table.graphs
    ]
    return replace(
        table,
        graphs=tuple(graph if graph.channels else None for graph in graphs),
        base_color=np.zeros_like(table.base_color),
        roughness=np.zeros_like(table.roughness),
        metallic=np.zeros_like(table.metallic),
        emission=np.zeros_like(table.emission),
    )


def passing(mesh: Mesh, table: MaterialTable) -> np.ndarray | None:
    """(M,) bool, MaterialTable.translucent; None where none of the mesh's materials is."""
    if table.translucent is None or not table.translucent[list(mesh.materials)].any():
        return None
    return table.translucent


def split_translucent(mesh: Mesh, table: MaterialTable) -> tuple[Mesh | None, Mesh | None]:
    """The opaque and the translucent part of a mesh, by material; None where there is none.

    What is all of one kind is the mesh itself. Parts share its vertices, and have content keys that tell from which
    materials they are. Triangles that are clear everywhere are in neither.
    """
    passes = passing(mesh, table)
    if passes is None:
        return mesh, None
    graphs = graphs_of(mesh, table)
    seen = [row for row in mesh.materials if _shows(table, row, graphs.get(row))]
    opaque = _part(mesh, tuple(row for row in seen if not passes[row]))
    return opaque, _part(mesh, tuple(row for row in seen if passes[row]))


def _shows(table: MaterialTable, row: int, graph: MaterialGraph | None) -> bool:
    """Whether a material may hide something, or colour it."""
    if table.alpha[row] > 0 or (graph is not None and graph.channels.keys() & {"alpha", "transmission_color"}):
        return True
    return table.transmission_color is not None and bool((table.transmission_color[row] < 1).any())


def _part(mesh: Mesh, rows: tuple[int, ...]) -> Mesh | None:
    """The triangles that have these materials."""
    if rows == mesh.materials:
        return mesh
    if not rows or mesh.material is None:
        return None
    part = mesh.take(np.flatnonzero(np.isin(mesh.material, rows)))
    name = f" of {','.join(map(str, rows))}"
    return replace(
        part,
        key=mesh.key + name,
        topology=mesh.topology and mesh.topology + name,
        material=part.material if len(rows) > 1 else None,
        materials=rows,
    )


def point_cloud(
    mesh: Mesh, samples: Samples, evaluated: Evaluated, table: MaterialTable, value: np.ndarray | None = None
) -> PointCloud:
    """The splats of a mesh: geometry, material rows, and what its graphs make of them; cut-out samples are left out.

    value (N,) float32: PointCloud.value of the samples.

    With a translucent material there are opacities, which are shares: overlapping splats add up to the alpha A. A
    sample that stands for the area S has the optical mass -ln(1 - A) S, spread over its ellipse. With a transmission
    colour C they have three channels, T = (1 - A) C.
    """
    cloud = PointCloud(
        evaluated.position,
        evaluated.origin,
        normal=evaluated.plane,
        axis=evaluated.axis,
        radii=evaluated.radii,
        material=material_ids(mesh, samples),
        value=value,
    )
    own = evaluated.normal
    look = at_samples(mesh, samples, evaluated, table)
    if look.normal is not None:
        own = look.normal
    # Below a quarter of a degree the splat's plane shades as well.
    if own is not evaluated.plane and (np.einsum("ij,ij->i", own, evaluated.plane) < 1 - 1e-5).any():
        cloud = replace(cloud, shading_normal=np.ascontiguousarray(own, np.float32))
    cloud = replace(cloud, color=look.color, surface=look.surface, emission=look.emission)
    passes = passing(mesh, table)
    if passes is not None:
        overlap = OVERLAP
        if samples.method == "PATCHES" and samples.ellipse is not None:
            # They are diced for a lens, which makes them add up evenly.
            overlap, share = 1.0, np.maximum(patch_shares(samples.ellipse), np.finfo(np.float32).tiny)
            cloud = replace(cloud, span=(1 / np.sqrt(share)).astype(np.float32))
        cloud = _with_opacity(cloud, passes[cloud.material], look, sample_areas(mesh, samples), table, overlap)
    elif look.alpha is not None:
        cloud = cloud.take(look.alpha >= CLIP)
    return valid_points(cloud)[0]  # ellipses around triangles may be larger than these


def _with_opacity(
    cloud: PointCloud, passes: np.ndarray, look: Appearance, area: np.ndarray, table: MaterialTable, overlap: float
) -> PointCloud:
    """The splats that show, with their shares of opacity. passes (N,) bool: translucent; area (N,); overlap: by which
    these are wider than their ellipses."""
    assert cloud.radii is not None
    assert cloud.material is not None
    alpha = table.alpha[cloud.material] if look.alpha is None else look.alpha
    hidden, shaded = np.where(passes, alpha, 1), None
    color = look.transmission_color
    if color is None and table.transmission_color is not None:
        color = table.transmission_color[cloud.material]
    if color is not None and (color[passes] < 1).any():
        hidden, shaded = hidden_and_shaded(hidden, color)
    most = hidden if hidden.ndim == 1 else hidden.max(axis=1)
    shows = np.where(passes, most > 0, alpha >= CLIP)
    radii = cloud.radii * np.where(passes, np.float32(overlap), np.float32(1))[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = area / (np.pi * radii[:, 0].astype(np.float64) * radii[:, -1])
        depth = (optical_depth(hidden).T * share).T
    opaque = passes if hidden.ndim == 1 else passes[:, None]
    opacity = np.where(opaque, -np.expm1(-np.minimum(depth, OPAQUE)), 1).astype(np.float32)
    return replace(cloud, radii=radii, opacity=opacity, shaded=shaded).take(shows)


def hidden_and_shaded(alpha: np.ndarray, color: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What surfaces of the alphas (N,) and transmission colours (N, 3) hide in each channel, (N, 3) float32, and how
    much of that shows their own light: PointCloud.shaded."""
    hidden = (1 - (1 - alpha[:, None]) * color).astype(np.float32)
    shaded = np.divide(alpha[:, None], hidden, out=np.ones_like(hidden), where=hidden > alpha[:, None])
    return hidden, shaded


def optical_depth(alpha: np.ndarray) -> np.ndarray:
    """float64: -ln(1 - alpha), at most OPAQUE."""
    with np.errstate(divide="ignore"):
        return np.minimum(-np.log1p(-np.clip(alpha, 0, 1).astype(np.float64)), OPAQUE)


def ball_extinction(alpha: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Extinction of balls whose centres have these alphas, (N,) or (N, 3); radii (N,) in object units; float32.

    A ball of radius r, two standard deviations, has the mass m = 4/3 pi r^3 extinction, and its kernel the depth
    PEAK m / (2 pi (r / 2)^2) at the centre.
    """
    with np.errstate(divide="ignore"):
        extinction = optical_depth(alpha).T / PEAK * 3 / (8 * radius.astype(np.float64))
    # Balls of no extent have no mass.
    return np.where(radius > 0, np.minimum(extinction, np.finfo(np.float32).max), 0).T.astype(np.float32)


def at_samples(mesh: Mesh, samples: Samples, evaluated: Evaluated, table: MaterialTable) -> Appearance:
    """The appearance of a mesh at its samples."""
    graphs = graphs_of(mesh, table)
    if not graphs:
        return Appearance()
    rows = material_ids(mesh, samples)
    position = evaluated.position + evaluated.origin.astype(np.float32)
    return _evaluate(mesh, samples, rows, position, evaluated.normal, graphs, table, wide=True)


def at_corners(mesh: Mesh, table: MaterialTable, graphs: dict[int, MaterialGraph], rows: np.ndarray) -> Appearance:
    """The appearance of a mesh, (3T,), at the corners of its triangles; `rows` (T,) are their materials."""
    triangles = len(mesh.triangles)
    weights = np.tile(np.array([[0, 0], [1, 0], [0, 1]], np.float32), (triangles, 1))
    samples = Samples("VERTICES", np.repeat(np.arange(triangles, dtype=np.int32), 3), weights)
    position = mesh.position[mesh.triangles.reshape(-1)]
    return _evaluate(mesh, samples, np.repeat(rows, 3), position, corner_normals(mesh), graphs, table)


def scattered_at(mesh: Mesh, samples: Samples, table: MaterialTable) -> Appearance:
    """The appearance of a mesh at samples that stand for all it scatters and emits there: without normals, and with
    images of about the resolution of the samples' ellipses."""
    graphs = {row: replace(graph, normal=None, tangent=None) for row, graph in graphs_of(mesh, table).items()}
    graphs = {row: graph for row, graph in graphs.items() if graph.channels}
    if not graphs:
        return Appearance()
    wanted = [needs(graph) for graph in graphs.values()]
    position = normal = np.zeros((len(samples), 3), np.float32)
    if any(one.position or one.generated for one in wanted):
        position = interpolate(mesh, samples, mesh.position[mesh.triangles])
    if any(one.normal for one in wanted):
        normal = normalize_rows(interpolate(mesh, samples, corner_normals(mesh).reshape(-1, 3, 3)))
    rows = material_ids(mesh, samples)

    def inputs(graph: MaterialGraph, part: Part) -> SampleInputs:
        return replace(_inputs(mesh, graph, _subset(samples, part), position[part], normal[part], True), rough=True)

    return evaluate_materials(rows, graphs, inputs, table, None)


def interpolates(graph: MaterialGraph) -> bool:
    """Whether what a graph varies is, within a triangle, what its values at the corners interpolate to; alpha apart."""
    linear = UV, Attribute, ColorAttribute, Constant, Coordinates, Color, Component
    channels = {name: output for name, output in graph.channels.items() if name != "alpha"}
    return (
        graph.normal is None
        and graph.tangent is None
        and all(
            isinstance(node, linear) and not (isinstance(node, Coordinates) and node.kind == "normal")
            for node in walk(*channels.values())
        )
    )


def at_places(
    mesh: Mesh, samples: Samples, graphs: dict[int, MaterialGraph], table: MaterialTable, scale: np.ndarray
) -> Appearance:
    """The appearance of a mesh at places in its triangles, with normals that are interpolated between the corners'.
    Images are filtered over the samples' ellipses.

    scale: (N,) float32, world units of one of object space: heights are in the former.
    """
    triangles = mesh.position[mesh.triangles]
    position = interpolate(mesh, samples, triangles)
    normal = normalize_rows(interpolate(mesh, samples, corner_normals(mesh).reshape(-1, 3, 3)))
    return _evaluate(mesh, samples, material_ids(mesh, samples), position, normal, graphs, table, True, scale)


def corner_normals(mesh: Mesh) -> np.ndarray:
    """(3T, 3) float32: the mesh's own normals at its corners, else those of its triangles."""
    if mesh.corner_normal is not None:
        return mesh.corner_normal.reshape(-1, 3)
    if mesh.vertex_normal is not None:
        return mesh.vertex_normal[mesh.triangles.reshape(-1)]
    a, b, c = mesh.position[mesh.triangles].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return np.repeat(normal / np.maximum(length, 1e-30), 3, axis=0).astype(np.float32)


def pictured(mesh: Mesh, graph: MaterialGraph) -> bool:
    """Whether pictures over the UV square show all of a graph on a mesh: not where it needs more than one UV map or
    does not repeat."""
    name = _uv_name(mesh, graph)
    inside = name in mesh.uv and bool((mesh.uv[name] >= 0).all() and (mesh.uv[name] <= 1).all())
    return bakeable(graph, unit_square=inside, active_uv=mesh.active_uv)


def baked(graph: MaterialGraph, largest: int) -> dict[str, np.ndarray]:
    """Pictures (H, W, C) float32 of a graph's varying channels over the UV square, whose sides are at most `largest`,
    the same for all meshes. core.material.baking.reading says what they hold."""
    return stored(graph, bake(graph, suggested_resolution(graph, largest)))


def _uv_name(mesh: Mesh, graph: MaterialGraph) -> str:
    name = next(iter(needs(graph).uv), None)
    return name or mesh.active_uv or ""


def uv_of(mesh: Mesh, graph: MaterialGraph) -> np.ndarray:
    """(3T, 2) float32: the map that a bakeable graph reads; zeros where the mesh lacks it."""
    uv = mesh.uv.get(_uv_name(mesh, graph))
    return np.zeros((3 * len(mesh.triangles), 2), np.float32) if uv is None else uv.reshape(-1, 2)


def _evaluate(
    mesh: Mesh,
    samples: Samples,
    rows: np.ndarray,
    position: np.ndarray,
    normal: np.ndarray,
    graphs: dict[int, MaterialGraph],
    table: MaterialTable,
    wide: bool = False,
    scale: np.ndarray | None = None,
) -> Appearance:
    """The appearance at samples with these material rows. wide: images are filtered over the samples' splats. scale:
    (N,), world units of one of object space; None: they are alike."""

    def inputs(graph: MaterialGraph, part: Part) -> SampleInputs:
        found = _inputs(mesh, graph, _subset(samples, part), position[part], normal[part], wide)
        if scale is None or found.steps is None:
            return found
        return replace(found, steps=found.steps * scale[part, None], unit=scale[part, None])

    return evaluate_materials(rows, graphs, inputs, table, normal)


def _subset(samples: Samples, part: Part) -> Samples:
    ellipse = None if samples.ellipse is None else samples.ellipse[part]
    owner = None if samples.object is None else samples.object[part]
    back = None if samples.backfacing is None else samples.backfacing[part]
    triangle, barycentric = samples.triangle[part], samples.barycentric[part]
    return Samples(samples.method, triangle, barycentric, ellipse, owner, back, samples.eye)


def _inputs(
    mesh: Mesh, graph: MaterialGraph, samples: Samples, position: np.ndarray, normal: np.ndarray, wide: bool
) -> SampleInputs:
    """What the graph reads, and nothing else."""
    wanted = needs(graph)
    uv_names = {name or mesh.active_uv for name in wanted.uv | wanted.tangent} & mesh.uv.keys()
    colors = mesh.colors.keys() if None in wanted.colors else wanted.colors & mesh.colors.keys()
    generated = tangent = sign = None
    if wanted.generated and mesh.generated is not None:
        generated = interpolate(mesh, samples, mesh.generated[mesh.triangles])
    elif wanted.generated and len(mesh.position):
        low, high = mesh.position.min(axis=0), mesh.position.max(axis=0)
        flat = high <= low  # along such an axis Blender's coordinates are those of the middle
        generated = np.where(flat, np.float32(0.5), (position - low) / np.where(flat, np.float32(1), high - low))
    tangent_map = next(iter({name or mesh.active_uv for name in wanted.tangent} & mesh.uv.keys()), None)
    if tangent_map is not None:
        along, side = triangle_tangents(mesh.position[mesh.triangles], mesh.uv[tangent_map])
        tangent, sign = along[samples.triangle], side[samples.triangle]
    inputs = SampleInputs(
        uv={name: interpolate(mesh, samples, mesh.uv[name]) for name in uv_names if name is not None},
        active_uv=mesh.active_uv,
        colors={name: interpolate(mesh, samples, mesh.colors[name]) for name in colors if name is not None},
        position=position if wanted.position else None,
        generated=generated,
        normal=normal if wanted.normal else None,
        tangent=tangent,
        bitangent_sign=sign,
        objects={name: _of_objects(mesh, samples, name) for name in wanted.objects & mesh.objects.keys()},
        backfacing=samples.backfacing if wanted.backfacing else None,
        eye=samples.eye if wanted.eye else None,
        count=len(samples),
    )
    wide = wide and wanted.images
    if not (wide or wanted.heights):
        return inputs
    displaced = _displaced(mesh, samples, inputs)
    filtered = replace(inputs, displaced=displaced if wide else None)
    if not wanted.heights:
        return filtered
    first, second = (_moved_to(filtered, inputs, end) for end in displaced)
    ways = difference_along_half_axes(samples, mesh.position[mesh.triangles])
    return replace(filtered, moved=(first, second), steps=np.float32(STEP) * ways)


def _of_objects(mesh: Mesh, samples: Samples, name: str) -> np.ndarray:
    """(N | 1, C): a value of the objects that samples lie on."""
    return mesh.objects[name][:1] if samples.object is None else mesh.objects[name][samples.object]


def _moved_to(filtered: SampleInputs, inputs: SampleInputs, end: SampleInputs) -> SampleInputs:
    """Inputs at STEP of the way from `inputs` to others, with the splats over which images are filtered."""
    moved = _shifted(inputs, end, inputs, STEP)
    if filtered.displaced is None:
        return moved
    first, second = (_shifted(rim, end, inputs, STEP) for rim in filtered.displaced)
    return replace(moved, displaced=(first, second))


def _shifted(of: SampleInputs, end: SampleInputs, start: SampleInputs, share: float) -> SampleInputs:
    """The inputs `of`, their coordinates moved by a share of the way from those of `start` to those of `end`."""
    part = np.float32(share)
    places = {
        name: getattr(of, name) + part * (getattr(end, name) - getattr(start, name))
        for name in ("position", "generated")
        if getattr(of, name) is not None
    }
    uv = {name: array + part * (end.uv[name] - start.uv[name]) for name, array in of.uv.items()}
    return replace(of, uv=uv, **places)


def _displaced(mesh: Mesh, samples: Samples, inputs: SampleInputs) -> tuple[SampleInputs, SampleInputs]:
    """The inputs at the ends of two half-diameters of each sample's splat, as far as pictures are mapped by them."""
    steps = {name: difference_along_half_axes(samples, mesh.uv[name]) for name in inputs.uv}
    places = {"position": inputs.position, "generated": inputs.generated}
    places = {name: array for name, array in places.items() if array is not None}
    if places:
        moved = difference_along_half_axes(samples, mesh.position[mesh.triangles])
        ways = {"position": moved}
        if inputs.generated is not None and mesh.generated is not None:
            ways["generated"] = difference_along_half_axes(samples, mesh.generated[mesh.triangles])
        elif inputs.generated is not None:
            extent = np.maximum(mesh.position.max(axis=0) - mesh.position.min(axis=0), 1e-30)
            ways["generated"] = moved / extent.astype(np.float32)
    first, second = (
        replace(
            inputs,
            uv={name: array + steps[name][k] for name, array in inputs.uv.items()},
            **{name: array + ways[name][k] for name, array in places.items()},
        )
        for k in range(2)
    )
    return first, second
