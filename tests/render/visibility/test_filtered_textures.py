"""Pictures on polygons are filtered over what sub-samples span: grey from afar, sharp from near, equally bright."""

from dataclasses import replace

import numpy as np
import pytest

from pointsplat_addon.core.material.graph import MaterialGraph
from pointsplat_addon.core.material.image import Image
from pointsplat_addon.core.material.levels import Stored, shown_light, smaller_levels
from pointsplat_addon.core.material.nodes import color_nodes, input_nodes, texture_nodes
from pointsplat_addon.core.numeric.pixel_filter import FILTER_SIZE, blackman_harris
from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.scene import Geometry
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.null import NullDevice
from pointsplat_addon.render.cache.store import Store
from pointsplat_addon.render.frame.frame import Frame
from pointsplat_addon.render.renderer import Renderer
from scripts.scenes import build, cameras, meshes
from scripts.scenes.case import Case
from scripts.scenes.drawing import render
from scripts.studies import checkerboard

COMBINED = frozenset({"combined"})
LAID = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])  # planes stand upright
SIZE = 96, 96


def squares(texels: int) -> Image:
    """Two by two squares of so many texels a side."""
    place = np.arange(2 * texels) // texels
    light = (place[:, None] + place) % 2
    return Image(np.stack([light, light, light, np.ones_like(light)], axis=2).astype(np.float32))


def shown(
    mesh, image: Image, interpolation: str, camera, technique: str, samples: int, matrix: np.ndarray = LAID
) -> np.ndarray:
    """(H, W): what a mesh that glows shows of an image."""
    texture = texture_nodes.ImageTexture(input_nodes.UV(), image, interpolation)
    table = build.materials(graphs=(MaterialGraph(emission=color_nodes.Color(texture)),))
    table = replace(table, base_color=np.zeros_like(table.base_color), specular=np.zeros_like(table.specular))
    scene = build.scene((build.mesh(mesh, "POLYGONS"), matrix), lights=[], world=World(np.zeros(3)), table=table)
    settings = Settings(technique=technique, use_adaptive_sampling=False, use_shadows=False)
    found = render(Case(scene, camera, settings), COMBINED, samples).pixels["combined"]
    return found[..., 0].astype(float)


@pytest.mark.parametrize(
    ("technique", "samples"), [("VISIBILITY", 4), ("VISIBILITY", 16), ("IMAGE_SPACE", 1), ("IMAGE_SPACE", 4)]
)
@pytest.mark.parametrize(("texels", "interpolation"), [(1, "Closest"), (16, "Linear")])
def test_a_checkerboard_is_grey_towards_the_horizon(technique, samples, texels, interpolation):
    plane = meshes.plane_mesh("board to the horizon", 40.0)
    plane = replace(plane, uv={"UV": plane.uv["UV"] * 160})  # squares of a quarter, as those of the study
    seen = replace(checkerboard.camera(), view_from_world=_from_the_edge())
    found = shown(plane, squares(texels), interpolation, seen, technique, samples)
    far = found[_rows_between(18.0, 37.0), 130:190]
    # measured 0.0200 with one sample, 0.0195 at most with four, 0.0048 with sixteen; the finest level alone has 0.98 to
    # 1, 0.40 to 0.43, and 0.085 to 0.088. The board itself, with 1,024 samples, has 0.004.
    assert far.std() < {1: 0.022, 4: 0.02, 16: 0.006}[samples] * far.mean()
    assert far.mean() == pytest.approx(0.5, abs=0.001)  # measured 0.0003


@pytest.mark.parametrize("samples", [4, 16])
def test_holes_of_a_checkerboard_are_a_half_towards_the_horizon(samples):
    """Squares of alpha, of which cells cover a share at random."""
    plane = meshes.plane_mesh("board of holes", 40.0)
    plane = replace(plane, uv={"UV": plane.uv["UV"] * 160})
    holes = np.ones((32, 32, 4), np.float32)
    holes[..., 3] = squares(16).texels[..., 0]
    texture = texture_nodes.ImageTexture(input_nodes.UV(), Image(holes))
    table = build.materials(graphs=(MaterialGraph(alpha=color_nodes.Component(texture, 3)),))
    scene = build.scene((build.mesh(plane, "POLYGONS"), LAID), lights=[], table=table, transparent=True)
    seen = replace(checkerboard.camera(), view_from_world=_from_the_edge())
    settings = Settings(technique="VISIBILITY", use_adaptive_sampling=False)
    alpha = render(Case(scene, seen, settings), COMBINED, samples).pixels["combined"][..., 3].astype(float)
    far = alpha[_rows_between(18.0, 37.0), 130:190]
    # measured 0.133 and 0.076; the finest level alone has 0.41 and 0.100
    assert far.std() < {4: 0.14, 16: 0.08}[samples] * far.mean()
    assert far.mean() == pytest.approx(0.5, abs=0.007)  # measured 0.0056


def _from_the_edge() -> np.ndarray:
    """The study's camera, at the near edge of the plane."""
    view = checkerboard.camera().view_from_world.copy()
    view[:3, 3] += view[:3, :3] @ (0, 40.0, 0)
    return view


def _rows_between(near: float, far: float) -> np.ndarray:
    """Rows of the study's picture that show the ground at these distances."""
    width, height = checkerboard.SIZE
    slope = (np.arange(height) + 0.5 - height / 2) / (checkerboard.FOCAL * width / 2)
    down = np.arcsin(checkerboard.DOWN) - np.arctan(slope)
    distance = checkerboard.EYE_HEIGHT / np.tan(np.maximum(down, 1e-6))
    return np.flatnonzero((distance > near) & (distance < far))


def test_what_is_near_is_interpolated_as_ever():
    """Texels wider than pixels, facing the eye: few samples show what many do, and the image's contrast."""
    image = Image(np.random.default_rng(2).random((8, 8, 4)).astype(np.float32))
    camera = cameras.camera((0.0, -1.4, 0.0), resolution=SIZE)
    few = shown(meshes.plane_mesh("near board"), image, "Linear", camera, "VISIBILITY", 16, np.eye(4))
    many = shown(meshes.plane_mesh("near board"), image, "Linear", camera, "VISIBILITY", 272, np.eye(4))
    assert np.abs(few - many).max() < 0.001  # measured 0.00027
    assert few.std() > 0.2  # measured 0.229


@pytest.mark.parametrize("samples", [4, 16])
@pytest.mark.parametrize("tilt", [0, 30, 60, 75, 80, 84, 86, 88, 89])
def test_waves_on_a_tilted_plane_are_what_the_pixel_filter_leaves_of_them(tilt, samples):
    """A cosine of 20 pixels, shortened to 0.35 by a parallel view: its amplitude is the filter's transform."""
    pixel, period, half = 0.01, 20, 60.0
    wave = 0.5 + 0.5 * np.cos(2 * np.pi * (np.arange(64) + 0.5) / 64)
    texels = np.stack([wave, wave, wave, np.ones(64)], axis=1).astype(np.float32)
    plane = meshes.plane_mesh("tilted plane", half)
    plane = replace(plane, uv={"UV": plane.uv["UV"] * np.float32(2 * half / (period * pixel))})
    turn, view = np.eye(4), np.eye(4)
    cosine, sine = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    turn[1:3, 1:3], view[2, 3] = [[cosine, -sine], [sine, cosine]], -200.0
    clip = np.diag([2 / (SIZE[0] * pixel), 2 / (SIZE[1] * pixel), -1 / 300, 1.0])
    camera = Camera(view, clip, SIZE, near=0.1, far=600.0)
    image = Image(np.repeat(texels[:, None], 4, axis=1))
    found = shown(plane, image, "Linear", camera, "VISIBILITY", samples, turn @ LAID)[:, 20:-20]
    frequency, row = 1 / (period * cosine), np.arange(SIZE[1]) + 0.5 - SIZE[1] / 2
    place = (np.arange(-2000, 2000) + 0.5) / 1000
    window = blackman_harris(place, FILTER_SIZE)
    amplitude = (window * np.cos(2 * np.pi * frequency * place)).sum() / window.sum()
    expected = 0.5 + 0.5 * amplitude * np.cos(2 * np.pi * frequency * row)
    # measured 0.0278 at 86 and 88 degrees, where waves are shorter than pixels; 0.0025 from the front
    assert np.sqrt(np.mean((found - expected[:, None]) ** 2)) < 0.03


@pytest.mark.parametrize("border", [0, 4])
@pytest.mark.parametrize("size", [(1, 5), (22, 37), (64, 64)])
def test_levels_keep_the_mean(size, border):
    texels = np.random.default_rng(3).random((*size, 3)).astype(np.float32)
    padded = np.pad(texels, ((border, border), (border, border), (0, 0)), mode="edge")
    levels = smaller_levels(padded, border)
    assert levels[-1].shape[:2] == ((3, 3) if border else (1, 1))
    for level in levels:
        inner = level[1:-1, 1:-1] if border else level
        # measured 7.4e-8
        np.testing.assert_allclose(
            inner.mean(axis=(0, 1), dtype=float), texels.mean(axis=(0, 1), dtype=float), atol=1e-6
        )


def test_levels_are_as_bright_as_what_the_picture_shows():
    """Stripes of two texels, black under an alpha of 0 and white: between them both are interpolated, and then decoded.

    Alpha t and code t, from 0 to 1 over a texel, show t f(t) for the sRGB curve f: in float64 by 4,096 steps.
    """
    stripes = np.repeat(np.array([[0, 0, 1, 1] * 4] * 8, np.float32)[..., None], 4, axis=2)
    found = shown_light(stripes, Stored(True, False, True, False, "wrap")).mean(axis=(0, 1), dtype=float)
    t = (np.arange(4096) + 0.5) / 4096
    light = np.where(t <= 0.04045, t / 12.92, ((t + 0.055) / 1.055) ** 2.4)
    truth = 0.25 * (2 * (t * light).mean() + 1)  # of four texels two are between stripes, and one is white
    assert found[0] == pytest.approx(truth, abs=0.001)  # measured 0.0007
    assert found[3] == pytest.approx(0.5, abs=1e-6)
    assert truth < 0.42 < 0.5  # what decoded texels would have


def lit(image: Image) -> color_nodes.Color:
    return color_nodes.Color(texture_nodes.ImageTexture(input_nodes.UV(), image))


def fine_board(key: str, row: int = 0, size: float = 1.0) -> Geometry:
    """A board whose picture repeats 64 times a side."""
    board = meshes.plane_mesh(key, size)
    return build.mesh(replace(board, uv={"UV": board.uv["UV"] * 64}, materials=(row,)), "POLYGONS")


def test_what_no_picture_shows_stays_constant():
    """A material whose roughness alone varies, beside one whose colour does."""
    roughness = color_nodes.Component(texture_nodes.ImageTexture(input_nodes.UV(), squares(4)), 0)
    graphs = MaterialGraph(roughness=roughness), MaterialGraph(base_color=lit(squares(4)))
    table = build.materials(2, graphs=graphs, base_color=[(0.2, 0.4, 0.6), (1, 1, 1)], specular=[0, 0])
    things = [(fine_board(f"board {row}", row), build.moved((2.2 * row - 1.1, 0, 0))) for row in (0, 1)]
    camera = cameras.camera((0.0, -6.0, 0.0), resolution=SIZE)
    settings = Settings(technique="VISIBILITY", use_adaptive_sampling=False)
    found = render(Case(build.scene(*things, table=table), camera, settings), COMBINED | {"diffuse_color"}, 16).pixels
    constant, grey = (found["diffuse_color"][40:56, x] for x in (slice(16, 40), slice(56, 80)))
    np.testing.assert_allclose(constant, np.broadcast_to((0.2, 0.4, 0.6), constant.shape), atol=1e-3)
    np.testing.assert_allclose(grey, 0.5, atol=0.02)  # measured 0.0168


def test_views_share_meshes_but_not_what_they_need_of_pictures():
    """A frame from afar is drawn while one from near, which needs no levels, begins and ends."""
    table = build.materials(graphs=(MaterialGraph(emission=lit(squares(4))),))
    scene = build.scene((build.mesh(meshes.plane_mesh("board"), "POLYGONS"), np.eye(4)), lights=[], table=table)
    settings = Settings(technique="VISIBILITY", use_adaptive_sampling=False, use_shadows=False)
    far, near = (
        Case(scene, cameras.camera((0.0, -distance, 0.0), resolution=SIZE), settings).request(COMBINED, 64)
        for distance in (40.0, 1.0)
    )
    device = NullDevice()
    renderer = Renderer(device, Store())

    def filtered(frame: Frame) -> bool:
        device.calls.clear()
        frame.sample()
        (attributes,) = [call.interface for call in device.calls if call.interface.name == "attributes"]
        return ("PS_LEVELS", "1") in attributes.defines

    first, second = renderer.start(scene, far), renderer.start(scene, near)
    assert filtered(first)
    assert not filtered(second)
    first.release()
    third = renderer.start(scene, far)
    assert not filtered(second)
    second.release()
    assert filtered(third)
    third.release()
    renderer.release()
