"""Procedural textures are Cycles' own: pixels of emission beside the expressions at the same coordinates.

Each case is a square of SIDE x SIDE pixels that an orthographic camera sees straight on. Its material rounds the
position down to whole pixels before it scales it by powers of two, so that both compute at the same coordinates to the
bit, wherever in its pixel Cycles takes a sample.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import pointsplat_addon
from pointsplat_addon.core.material.expression import SampleInputs, evaluate
from pointsplat_addon.core.material.graph import Needs, needs
from pointsplat_addon.host.convert.material.materials import convert_material
from tests.support.blender.scenes import mesh_object, new_material, node, picture

SIDE = 32  # pixels along a side of each case
COLUMNS = 16


class Case(NamedTuple):
    kind: str  # of node, without its prefix
    output: str
    inputs: dict[str, float | tuple | str]  # values; "x" and "y" are the coordinates of that name, scaled to [0, 1]
    settings: dict[str, Any]
    step: float = 1 / 16  # of coordinates from pixel to pixel


def case(kind: str, output: str, settings: dict | None = None, step: float = 1 / 16, **inputs: Any) -> Case:
    named = {name.replace("_", " "): value for name, value in inputs.items()}
    return Case(kind, output, named, settings or {}, step)


DIMENSIONS = ("1D", "2D", "3D", "4D")
FRACTALS = ("FBM", "MULTIFRACTAL", "HYBRID_MULTIFRACTAL", "RIDGED_MULTIFRACTAL", "HETERO_TERRAIN")
METRICS = ("EUCLIDEAN", "MANHATTAN", "CHEBYCHEV", "MINKOWSKI")
GRADIENTS = ("LINEAR", "QUADRATIC", "EASING", "DIAGONAL", "SPHERICAL", "QUADRATIC_SPHERE", "RADIAL")


def noise(output: str, dimensions: str = "3D", kind: str = "FBM", normalize: bool = True, **inputs: Any) -> Case:
    settings = {"noise_dimensions": dimensions, "noise_type": kind, "normalize": normalize}
    return case("Noise", output, settings, **inputs)


def voronoi(
    output: str, feature: str, dimensions: str = "3D", metric: str = "EUCLIDEAN", normalize: bool = False, **inputs: Any
) -> Case:
    settings = {"voronoi_dimensions": dimensions, "feature": feature, "distance": metric, "normalize": normalize}
    return case("Voronoi", output, settings, **inputs)


CASES = {
    **{
        f"white noise {d} {o}": case("WhiteNoise", o, {"noise_dimensions": d})
        for d in DIMENSIONS
        for o in ("Value", "Color")
    },
    **{
        f"checker {o}": case("Checker", o, Scale=3.0, Color1=(0.1, 0.2, 0.3, 1), Color2=(0.8, 0.7, 0.6, 1))
        for o in ("Fac", "Color")
    },
    "checker of a unit": case("Checker", "Fac", Scale=1.0, step=1.0),
    **{f"gradient {k}": case("Gradient", "Fac", {"gradient_type": k}) for k in GRADIENTS},
    **{f"noise {d} {o}": noise(o, d) for d in DIMENSIONS for o in ("Fac", "Color")},
    **{f"noise {d} distorted": noise("Color", d, Distortion=0.7, Detail=1.5) for d in DIMENSIONS},
    **{
        f"noise {k} {n}": noise("Fac", "3D", k, n, Detail=3.3, Roughness=0.6, Lacunarity=2.3, Offset=0.4, Gain=1.7)
        for k in FRACTALS
        for n in (False, True)
    },
    **{f"noise {k} {d}": noise("Color", d, k, Detail=3.0) for k in FRACTALS for d in ("1D", "2D", "4D")},
    "noise driven": noise("Fac", Scale="y", Detail="x", Roughness="y"),
    "noise hybrid driven": noise("Fac", kind="HYBRID_MULTIFRACTAL", Detail="x", Roughness="y", Gain="x", Offset="y"),
    "noise far away": noise("Fac", Scale=60_000.0, Detail=0.0),
    "noise very far away": noise("Fac", Scale=1e7, Detail=0.0),
    "noise, detail of 20": noise("Fac", Detail=20.0, Roughness=1.0),
    "noise, negative": noise("Fac", Detail=-1.0, Roughness=-0.5, Scale=-3.0, Lacunarity=-1.5),
    **{
        f"voronoi {f} {d} {o}": voronoi(o, f, d)
        for f in ("F1", "F2", "SMOOTH_F1")
        for d in DIMENSIONS
        for o in {"1D": ("Distance", "Color", "W"), "4D": ("Distance", "Color", "Position", "W")}.get(
            d, ("Distance", "Color", "Position")
        )
    },
    **{
        f"voronoi {f} {d}": voronoi("Distance" if f != "N_SPHERE_RADIUS" else "Radius", f, d, Randomness=0.8)
        for f in ("DISTANCE_TO_EDGE", "N_SPHERE_RADIUS")
        for d in DIMENSIONS
    },
    **{
        f"voronoi {f} {m} normalized": voronoi(
            "Distance", f, "3D", m, True, Randomness=0.7, Exponent=1.3, Smoothness=0.6
        )
        for f in ("F1", "F2", "SMOOTH_F1")
        for m in METRICS
    },
    **{
        f"voronoi {f} {d} normalized": voronoi("Distance", f, d, "EUCLIDEAN", True, Randomness=0.7)
        for f in ("F1", "F2", "SMOOTH_F1", "DISTANCE_TO_EDGE")
        for d in DIMENSIONS
    },
    **{
        f"voronoi {f} octaves {o} {n}": voronoi(o, f, normalize=n, Detail=2.6, Roughness=0.7, Lacunarity=2.2)
        for f in ("F1", "F2", "SMOOTH_F1")
        for o in ("Distance", "Color", "Position")
        for n in (False, True)
    },
    **{
        f"voronoi edge octaves {n}": voronoi(
            "Distance", "DISTANCE_TO_EDGE", normalize=n, Detail=2.6, Roughness=0.7, Lacunarity=2.2
        )
        for n in (False, True)
    },
    "voronoi driven": voronoi("Distance", "F1", Scale="y", Detail="x", Roughness="y", Randomness="x"),
    "voronoi smooth driven": voronoi("Distance", "SMOOTH_F1", Smoothness="x", Randomness="y"),
    "voronoi sharp": voronoi("Color", "SMOOTH_F1", Smoothness=0.0),
    "voronoi far away": voronoi("Distance", "F1", Scale=1e5),
    **{
        f"wave bands {d} {p}": case(
            "Wave", "Fac", {"wave_type": "BANDS", "bands_direction": d, "wave_profile": p}, Scale=0.7, Phase_Offset=0.3
        )
        for d, p in (("X", "SIN"), ("Y", "SAW"), ("Z", "TRI"), ("DIAGONAL", "SIN"))
    },
    **{
        f"wave rings {d} {p}": case(
            "Wave", "Color", {"wave_type": "RINGS", "rings_direction": d, "wave_profile": p}, Scale=0.7
        )
        for d, p in (("X", "SIN"), ("Y", "SAW"), ("Z", "TRI"), ("SPHERICAL", "SIN"))
    },
    "wave distorted": case(
        "Wave", "Fac", Scale=0.7, Distortion=3.0, Detail=2.5, Detail_Scale=1.3, Detail_Roughness=0.6
    ),
    "wave driven": case("Wave", "Fac", Scale="y", Distortion="x", Detail=1.5, Phase_Offset="x"),
    **{f"magic {n}": case("Magic", "Color", {"turbulence_depth": n}, Distortion=1.3) for n in range(11)},
    "magic fac": case("Magic", "Fac", Distortion="x"),
    **{
        f"brick {o}": case(
            "Brick",
            o,
            {"offset": 0.3, "offset_frequency": 3, "squash": 0.6, "squash_frequency": 2},
            Scale=2.0,
            Color1=(0.1, 0.2, 0.3, 1),
            Color2=(0.8, 0.7, 0.6, 1),
            Mortar=(0.9, 0, 0, 1),
            Mortar_Size=0.06,
            Mortar_Smooth=0.4,
        )
        for o in ("Color", "Fac")
    },
    "black body": case("Blackbody", "Color", Temperature="x"),
    "normal": case("Normal", "Dot"),
    "brick driven": case(
        "Brick", "Color", Scale=2.0, Mortar_Size=0.03, Mortar_Smooth="x", Bias="y", Mortar=(1, 0, 0, 1)
    ),
    "brick sharp": case("Brick", "Color", Scale=2.0, Mortar_Smooth=0.0, Color1=(0.1, 0.2, 0.3, 1)),
    "white noise of -0": case("WhiteNoise", "Color", {"noise_dimensions": "4D"}, W=-0.0),
    **{
        f"{kind} far away": case(kind, output, Scale=4096.0)
        for kind, output in (("Wave", "Fac"), ("Magic", "Color"), ("Checker", "Fac"), ("Brick", "Color"))
    },
    **{
        f"{kind} of scale 0": case(kind, output, Scale=0.0)
        for kind, output in (
            ("Noise", "Color"),
            ("Voronoi", "Color"),
            ("Voronoi", "Position"),
            ("Wave", "Fac"),
            ("Magic", "Color"),
            ("Checker", "Fac"),
            ("Brick", "Color"),
        )
    },
    "magic undistorted": case("Magic", "Color", Distortion=0.0),
    "voronoi minkowski 0": voronoi("Distance", "F1", metric="MINKOWSKI", Exponent=0.0),
    "voronoi of lacunarity 0": voronoi("Position", "F1", Detail=2.0, Lacunarity=0.0),
    "brick without offset": case("Brick", "Color", {"offset_frequency": 0}, Row_Height=0.125, Mortar_Size=0.0),
}
PLACES = {name: (i % COLUMNS, i // COLUMNS) for i, name in enumerate(CASES)}


def material(case: Case):
    """Emits a texture at (x, y, x / 2 + y / 4) with W = x / 4 - y, where x and y are pixels times the step."""
    made = new_material()
    tree = made.node_tree
    place = node(tree, "ShaderNodeTexCoord").outputs["Object"]
    corner = node(tree, "ShaderNodeVectorMath", {"Vector": place}, operation="FLOOR").outputs[0]
    middle = {"Vector": corner, "Vector_001": (-SIDE / 4, -SIDE / 2, 0)}
    pixel = node(tree, "ShaderNodeVectorMath", middle, operation="ADD").outputs[0]

    def dot(*weights: float):
        inputs = {"Vector": pixel, "Vector_001": weights}
        return node(tree, "ShaderNodeVectorMath", inputs, operation="DOT_PRODUCT").outputs["Value"]

    step = case.step
    x, y, z, w = dot(step, 0, 0), dot(0, step, 0), dot(step / 2, step / 4, 0), dot(step / 4, -step, 0)
    vector = node(tree, "ShaderNodeCombineXYZ", {"X": x, "Y": y, "Z": z}).outputs[0]
    kind = case.kind if case.kind in ("Blackbody", "Normal") else f"Tex{case.kind}"
    texture = node(tree, f"ShaderNode{kind}", **case.settings)
    driven = {"x": dot(1 / SIDE, 0, 0), "y": dot(0, 1 / SIDE, 0)}  # from -1/4 to 3/4, from -1/2 to 1/2
    for socket in texture.inputs:
        value = case.inputs.get(socket.identifier, {"Vector": vector, "Normal": vector, "W": w}.get(socket.identifier))
        if value in driven:
            value = driven[value]
            factor, start = {"Scale": (4, 0), "Detail": (4, 0), "Temperature": (8192, 4096)}.get(
                socket.identifier, (1, 0)
            )
            scaled = {"Value": value, "Value_001": factor, "Value_002": start}
            value = node(tree, "ShaderNodeMath", scaled, operation="MULTIPLY_ADD").outputs[0]
        if isinstance(value, bpy.types.NodeSocket):
            tree.links.new(value, socket)
        elif value is not None:
            socket.default_value = value
    shown = node(tree, "ShaderNodeEmission", {"Color": texture.outputs[case.output]}).outputs[0]
    node(tree, "ShaderNodeOutputMaterial", {"Surface": shown})
    return made


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """By case: pixels (SIDE, SIDE, 3) of Cycles and of the expression."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pointsplat_addon.register()
    bpy.context.scene.pointsplat.use_indirect = False  # direct light alone
    scene, rows = bpy.context.scene, -(-len(CASES) // COLUMNS)
    center = np.arange(SIDE) + 0.5
    position = np.stack([*np.meshgrid(center, center), np.zeros((SIDE, SIDE))], axis=-1).reshape(-1, 3)
    samples = SampleInputs(position=position.astype(np.float32))
    ours = {}
    for name, (column, row) in PLACES.items():
        square = mesh_object(name, [(0, 0, 0), (SIDE, 0, 0), (SIDE, SIDE, 0), (0, SIDE, 0)], [(0, 1, 2, 3)])
        square.location = column * SIDE, row * SIDE, 0
        made = material(CASES[name])
        square.data.materials.append(made)
        converted = convert_material(made)
        assert not converted.warnings, converted.warnings
        assert converted.graph is not None, name
        assert converted.graph.emission is not None, name
        ours[name] = evaluate(converted.graph.emission, samples).reshape(SIDE, SIDE, 3)
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", max(COLUMNS, rows) * SIDE
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location = COLUMNS * SIDE / 2, rows * SIDE / 2, 5
    scene.collection.objects.link(scene.camera)
    render, cycles = scene.render, scene.cycles
    render.engine, render.resolution_x, render.resolution_y = "CYCLES", SIDE * COLUMNS, SIDE * rows
    if bpy.app.version >= (5, 0, 0):
        render.image_settings.media_type = "IMAGE"
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode, render.film_transparent = "RGBA", True
    cycles.device, cycles.samples, cycles.max_bounces, cycles.filter_width = "CPU", 1, 0, 0.01
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    pixels = picture(scene, tmp_path_factory.mktemp("cycles"))
    squares = pixels.reshape(rows, SIDE, COLUMNS, SIDE, 4).swapaxes(1, 2)
    pointsplat_addon.unregister()
    return {name: (squares[row, column, ..., :3], ours[name]) for name, (column, row) in PLACES.items()}


# Measured: no white noise, checker, cell or colour of a cell differs. Blender 4.5 / 5.2: gradients 1.2e-7, Voronoi
# 6.9e-7 / 6.8e-7, waves 1.9e-6 / 9.5e-7, magic 1.1e-6, bricks 9e-8 / 3.7e-6. Green, blue and distortions of noise are
# read at distances of 100 to 200, where float32 has steps of 1.5e-5; Blender 4.5 rounds them twice and Blender 5.2
# once, as is done here: 1.0e-4 / 1.6e-5, all else of noise 1.2e-6 / 1.1e-6. Black bodies from 2048 to 10,048 K, of
# which Cycles' colours are a fit: 0.043 of up to 2.4.
TOLERANCE = {"Noise": 1.5e-4, "WhiteNoise": 0.0, "Checker": 1e-7, "Blackbody": 0.05}


@pytest.mark.parametrize("name", CASES)
def test_textures_have_the_values_of_cycles(drawn, name):
    truth, ours = drawn[name]
    assert np.abs(ours - truth).max() <= TOLERANCE.get(CASES[name].kind, 5e-6)


def test_a_texture_without_a_vector_reads_generated_coordinates(empty_file):
    made = new_material()
    texture = node(made.node_tree, "ShaderNodeTexGradient", gradient_type="DIAGONAL")
    shown = node(made.node_tree, "ShaderNodeEmission", {"Color": texture.outputs["Fac"]}).outputs[0]
    node(made.node_tree, "ShaderNodeOutputMaterial", {"Surface": shown})
    converted = convert_material(made)
    assert not converted.warnings
    assert converted.graph is not None
    assert needs(converted.graph) == Needs(generated=True)
