"""What every device must do: each case draws, asserts what geometry and arithmetic say, and returns its pixels.

`tests/render` runs the cases on moderngl, `tests/blender` on Blender's gpu as well and compares the
pixels, and so does the desktop's run, which has no pytest: hence plain functions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pointsplat_addon.core.material.baking import BORDER
from pointsplat_addon.core.material.levels import Stored, laid_out, shown_normals, shown_slopes, smaller_levels
from pointsplat_addon.render.device.packing import paged
from pointsplat_addon.render.device.protocol import EMPTY, Device, Timer
from pointsplat_addon.render.passes.shadow.kept_depths import depths_form, kept
from pointsplat_addon.shading.interface import Block, Interface
from tests.reference import textures

Pixels = dict[str, np.ndarray]
SHADERS = Path(__file__).resolve().parent / "shaders"
CASES: list[Callable[[Device], Pixels]] = []
SIZES = ((1, 1), (1, 16384), (333, 77))  # width, height

ECHO = Block(
    "Echo",
    "u",
    (
        ("float", "a"),
        ("vec2", "b"),
        ("int", "c"),
        ("uint", "d"),
        ("vec4", "e"),
        ("float", "f"),
        ("mat4", "g"),
        ("ivec2", "h"),
        ("float", "k"),
        ("ivec4", "j"),
    ),
)
COUNT = Block("Count", "u", (("int", "count"),))
SOLID = Block("Solid", "u", (("vec4", "color"),))


def path(name: str) -> str:
    return str(SHADERS / name)


def case(function: Callable[[Device], Pixels]) -> Callable[[Device], Pixels]:
    CASES.append(function)
    return function


def equal(actual: np.ndarray, expected: np.ndarray, what: str = "") -> None:
    np.testing.assert_array_equal(actual, expected, err_msg=what)


def scatter(device: Device, columns: np.ndarray):
    """(N, 4) rows as a texture 256 wide, for shaders/points.vert."""
    rows = -(-len(columns) // 256)
    data = np.zeros((rows * 256, 4), np.float32)
    data[: len(columns)] = columns
    return device.texture((256, rows), "RGBA32F", data)


def clip_from_pixel(pixel: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """(N, 2) pixel coordinates (0 at the lower left corner) to clip space."""
    return pixel / np.array(size) * 2.0 - 1.0


POINTS = Interface(
    "points",
    vertex=path("points.vert"),
    fragment=path("points.frag"),
    samplers=(("FLOAT_2D", "source"),),
    varyings=(("smooth", "float", "level"), ("flat", "int", "index")),
    outputs=(("uint", "id"),),
)
ADDED = replace(POINTS, outputs=(("vec4", "color"),)).with_defines("ADD")


@case
def uniform_block(device: Device) -> Pixels:
    """Each field of a std140 block arrives as numpy put it there."""
    g = np.arange(16.0).reshape(4, 4) * 0.25
    values = {"a": 0.1, "b": (1.5, 2.5), "c": -3, "d": 16777215, "e": (4.0, 5.0, 6.0, 7.0), "f": 8.125, "g": g}
    values |= {"h": (-9, 10), "k": 11.0, "j": (12, -13, 14, 15)}
    echo = Interface("echo", fragment=path("echo.frag"), block=ECHO, outputs=(("vec4", "color"),))
    image = device.texture((11, 1), "RGBA32F")
    device.draw(echo, device.target([image]), uniforms=ECHO.record(**values))
    seen = device.read(image)[0]
    expected = np.zeros((11, 4), np.float32)
    expected[0, 0] = 0.1
    expected[1, :2] = 1.5, 2.5
    expected[2, :2] = -3, 16777215
    expected[3] = 4, 5, 6, 7
    expected[4, 0] = 8.125
    expected[5:9] = g.T  # a matrix's rows in GLSL are its columns
    expected[9, :3] = -9, 10, 11
    expected[10] = 12, -13, 14, 15
    equal(seen, expected)
    return {"echo": seen}


@case
def formats(device: Device) -> Pixels:
    """What is uploaded is read back, and copied by a shader, in each format and at awkward sizes."""
    found: Pixels = {}
    random = np.random.default_rng(1)
    copy = Interface(
        "copy", fragment=path("copy.frag"), samplers=(("FLOAT_2D", "source"),), outputs=(("vec4", "color"),)
    )
    for width, height in SIZES:
        for format, channels in (("RGBA32F", 4), ("RGBA16F", 4), ("RG32F", 2), ("R32F", 1)):
            what = f"{format} {width}x{height}"
            data = random.normal(scale=100.0, size=(height, width, channels)).astype(np.float32)
            data[0, 0, 0] = 65504.0  # the largest half float
            source = device.texture((width, height), format, data)
            copied = device.texture((width, height), format)
            device.draw(copy, device.target([copied]), textures={"source": source})
            found[what] = device.read(source)
            assert found[what].shape == (height, width, channels)
            assert found[what].dtype == np.float32
            equal(found[what], data.astype(np.float16) if format == "RGBA16F" else data, what)
            equal(device.read(copied), found[what], f"copy of {what}")
    return found


@case
def content_that_is_written(device: Device) -> Pixels:
    """A function is asked for all texels, in slices of any size, and they come to lie where they belong."""
    width, height = 700, 1601  # more than are asked for at once
    for format, channels in (("RGBA16F", 4), ("R32F", 1)):
        data = (np.arange(width * height * channels) % 2039).astype(np.float32).reshape(-1, channels)
        asked = []

        def write(out: np.ndarray, texels: slice, data: np.ndarray = data, asked: list[slice] = asked) -> None:
            out[:] = data[texels]
            asked.append(texels)

        seen = device.read(device.texture((width, height), format, write))
        equal(seen.reshape(-1, channels), data, format)
        assert sum(texels.stop - texels.start for texels in asked) == width * height
    return {}


LEVELS = Interface(
    "levels",
    fragment=path("levels.frag"),
    samplers=(("FLOAT_2D", "rows"), ("FLOAT_2D", "picture"), ("FLOAT_2D", "levels")),
    outputs=(("vec4", "color"),),
).with_defines("PS_UV", "PS_LEVELS")
BORDERED = ("PS_PICTURE_BORDER", str(BORDER))
EXTENSIONS = {"REPEAT": (), "MIRROR": (("PS_PICTURE_MIRROR", "1"),), "EXTEND": (BORDERED,), "CLIP": (BORDERED,)}


@case
def pictures_over_footprints(device: Device) -> Pixels:
    """Pictures of odd sizes are filtered as in float64, in every way in which they go on beyond the unit square."""
    rng, count, found = np.random.default_rng(8), 2048, {}
    uv = rng.uniform(-1.7, 2.7, (count, 2)).astype(np.float32)
    sides = (rng.normal(size=(count, 4)) * 10.0 ** rng.uniform(-3, 0.3, (count, 1))).astype(np.float32)
    rows = np.zeros((2, count, 4), np.float32)
    rows[0, :, :2], rows[1] = uv, sides
    bound = {"rows": device.texture((count, 2), "RGBA32F", rows.reshape(-1))}
    target = device.target([device.texture((count, 1), "RGBA32F")])
    for width, height in ((1, 5), (37, 22), (64, 64)):
        inner = rng.random((height, width, 4)).astype(np.float32)
        over = textures.footprint(sides[:, :2].astype(float), sides[:, 2:].astype(float), (width, height))
        for extension, defines in EXTENSIONS.items():
            ring = BORDER if defines == (BORDERED,) else 0
            padding = (ring, ring), (ring, ring), (0, 0)
            texels = np.pad(inner, padding, mode="constant" if extension == "CLIP" else "edge") if ring else inner
            smaller = smaller_levels(texels, ring)
            size, data = paged(laid_out(smaller), 4)
            bound["picture"] = device.texture((texels.shape[1], texels.shape[0]), "RGBA32F", texels.reshape(-1))
            bound["levels"] = device.texture(size, "RGBA32F", data)
            for closest in (False, True):
                more = (*defines, *((("PS_PICTURE_CLOSEST", "1"),) if closest else ()))
                device.draw(replace(LEVELS, defines=(*LEVELS.defines, *more)), target, textures=bound)
                name = f"{width}x{height} {extension} {'closest' if closest else 'linear'}"
                found[name] = device.read(target.colors[0])
                pyramid = textures.levels(inner[..., 0].astype(float), extension)
                twin = textures.filtered(pyramid, uv.astype(float), over, extension, closest)
                off = np.abs(found[name][0, :, 0] - twin)
                assert off.max() < 1e-4, name  # measured 2.7e-5
    return found


@case
def bent_normals_over_footprints(device: Device) -> Pixels:
    """Moments of normals and of heights in pictures are filtered as in float64."""
    rng, count, found, size = np.random.default_rng(9), 2048, {}, (37, 22)
    uv = rng.uniform(-1.7, 2.7, (count, 2)).astype(np.float32)
    sides = (rng.normal(size=(count, 4)) * 10.0 ** rng.uniform(-3, 0.3, (count, 1))).astype(np.float32)
    rows = np.zeros((2, count, 4), np.float32)
    rows[0, :, :2], rows[1] = uv, sides
    target = device.target([device.texture((count, 1), "RGBA32F")])
    over = textures.footprint(sides[:, :2].astype(float), sides[:, 2:].astype(float), size)
    normals = np.dstack([rng.uniform(-0.5, 0.5, (*size[::-1], 2)), np.ones(size[::-1]), np.zeros(size[::-1])])
    heights = np.dstack([rng.uniform(0, 0.02, size[::-1]), np.ones(size[::-1])])
    stored = Stored(False, False, False, False, "wrap")
    for name, held, moments, shown, worst in (
        ("normal", normals, lambda texels: shown_normals(texels, stored), textures.shown_normals, 1e-4),
        ("height", heights, lambda texels: shown_slopes(texels[..., 0], 0, stored), textures.shown_slopes, 2e-4),
    ):
        texels = held.astype(np.float32)
        levels = moments(texels)
        at, data = paged(laid_out(smaller_levels(levels, 0)), 4)
        picture = f"ps_baked_{name}"
        program = Interface(
            "bends",
            fragment=path("bends.frag"),
            samplers=(("FLOAT_2D", "rows"), ("FLOAT_2D", picture), ("FLOAT_2D", f"{picture}_levels")),
            outputs=(("vec4", "color"),),
        ).with_defines("PS_UV", "PS_LEVELS", "PS_SPREAD", picture.upper())
        bound = {
            "rows": device.texture((count, 2), "RGBA32F", rows.reshape(-1)),
            picture: device.texture(size, "RGBA32F" if name == "normal" else "RG32F", texels.reshape(-1)),
            f"{picture}_levels": device.texture(at, "RGBA32F", data),
        }
        device.draw(program, target, textures=bound)
        found[name] = device.read(target.colors[0])
        first = texels[..., :3] if name == "normal" else texels[..., 0]
        for i in range(3 if name == "normal" else 4):

            def finest(at: np.ndarray, i: int = i, first: np.ndarray = first, shown=shown) -> np.ndarray:
                return shown(first, at)[:, i]

            pyramid = textures.levels(levels[..., i].astype(float), "REPEAT")
            twin = textures.filtered(pyramid, uv.astype(float), over, finest=finest)
            off = np.abs(found[name][0, :, i] - twin) / max(np.abs(twin).max(), 1e-30)
            assert off.max() < worst, f"{name} {i}: {off.max():.1e}"
    return found


@case
def unsigned_integers(device: Device) -> Pixels:
    """R32UI: filled with EMPTY, read by a shader and written by one, to the last bit."""
    found: Pixels = {}
    copy = Interface(
        "copy of integers",
        fragment=path("copy_uint.frag"),
        samplers=(("UINT_2D", "source"),),
        outputs=(("uint", "color"),),
        defines=(("OFFSET", "5u"),),
    )
    for width, height in SIZES:
        source, copied = (device.texture((width, height), "R32UI") for _ in range(2))
        device.fill(source)
        seen = device.read(source)
        assert seen.shape == (height, width)
        assert seen.dtype == np.uint32
        equal(seen, np.full((height, width), EMPTY, np.uint32))
        device.draw(copy, device.target([copied]), textures={"source": source})
        found[f"{width}x{height}"] = device.read(copied)
        equal(found[f"{width}x{height}"], np.full((height, width), 4, np.uint32), "2^32 - 1 + 5 wraps to 4")
    return found


@case
def depths_from_files(device: Device) -> Pixels:
    """Bits of depths that a cache has kept are what they were."""
    bits = np.random.default_rng(2).uniform(0, 1e30, (77, 333)).astype(np.float32).view(np.uint32)
    bits[20:40], bits[:, 64:200], bits[50, 7], bits[0, 0] = EMPTY, EMPTY, 0x00800000, 0
    found = kept(bits)
    assert found is not None
    form = depths_form(device)
    texture = form.load(found)
    assert form.settle(texture) == 4 * bits.size
    again = device.read(texture)
    equal(again, bits)
    saved = form.save(texture)
    assert saved is not None
    equal(saved["runs"], found["runs"])
    texture.release()
    return {"depths": again}


@case
def clear(device: Device) -> Pixels:
    """A target's colours, its integers and its depth are set, whatever was drawn before."""
    size = (33, 7)
    color, ids = device.texture(size, "RGBA16F"), device.texture(size, "R32UI")
    target = device.target([color, ids], depth=True)
    found = {}
    for value in ((0.25, 0.5, -1.0, 2.0), (0.0, 0.0, 0.0, 0.0)):
        device.clear(target, value)
        found[f"color {value}"] = device.read(color)
        equal(found[f"color {value}"], np.broadcast_to(np.array(value, np.float32), (7, 33, 4)))
        equal(device.read(ids), np.full((7, 33), EMPTY, np.uint32))
    return found


@case
def point_coverage(device: Device) -> Pixels:
    """A point of size 1 covers the one pixel that its centre lies in; more than 65,536 are counted rightly."""
    size = (512, 384)
    random = np.random.default_rng(2)
    cells = random.permutation(size[0] * size[1])[:150_000]
    # GPUs keep 8 bits below the pixel, so stay 1/128 off its edges.
    inside = random.uniform(1 / 128, 1 - 1 / 128, (len(cells), 2))
    pixel = np.stack([cells % size[0], cells // size[0]], axis=1)
    points = np.zeros((len(cells), 4))
    points[:, :2] = clip_from_pixel(pixel + inside, size)
    ids = device.texture(size, "R32UI")
    target = device.target([ids])
    device.clear(target)
    device.draw(POINTS, target, textures={"source": scatter(device, points)}, vertices=len(points), primitive="POINTS")
    expected = np.full(size[0] * size[1], EMPTY, np.uint32)
    expected[cells] = np.arange(len(cells))
    seen = device.read(ids)
    equal(seen, expected.reshape(size[1], size[0]))
    return {"ids": seen}


def crowd(count: int, size: tuple[int, int], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Points at pixel centres, several to a pixel, of depths among which some are equal: pixels (N,2), depths (N,)."""
    random = np.random.default_rng(seed)
    return random.integers(0, size, (count, 2)), random.integers(1, 64, count) / 64.0


def nearest(pixel: np.ndarray, depth: np.ndarray, size: tuple[int, int], reverse: bool = False) -> np.ndarray:
    """Per pixel the index of the point of least (reverse: largest) depth, the first of equals."""
    cell = pixel[:, 1] * size[0] + pixel[:, 0]
    order = np.lexsort((np.arange(len(cell)), -depth if reverse else depth, cell))
    first = np.unique(cell[order], return_index=True)
    image = np.full(size[0] * size[1], EMPTY, np.uint32)
    image[first[0]] = order[first[1]]
    return image.reshape(size[1], size[0])


@case
def depth_test(device: Device) -> Pixels:
    """The nearest point remains, of equals the one drawn first; gl_FragDepth replaces the depth where asked."""
    size = (61, 47)
    pixel, depth = crowd(20_000, size, seed=3)
    points = np.zeros((len(pixel), 4))
    points[:, :2] = clip_from_pixel(pixel + 0.5, size)
    points[:, 2] = 2.0 * depth - 1.0
    source = scatter(device, points)
    ids = device.texture(size, "R32UI")
    target = device.target([ids], depth=True)
    reverse = replace(POINTS, depth=True).with_defines("WRITE_DEPTH")
    found: Pixels = {}
    for name, interface in (("near", POINTS), ("far", reverse)):
        device.clear(target)
        device.draw(
            interface,
            target,
            textures={"source": source},
            vertices=len(points),
            primitive="POINTS",
            depth_test=True,
        )
        found[name] = device.read(ids)
        equal(found[name], nearest(pixel, depth, size, reverse=name == "far"), name)
    return found


@case
def depth_precision(device: Device) -> Pixels:
    """Depths close to 0 are told apart as 32-bit floats tell them apart; 24 bits would call them equal."""
    size = (1, 1)
    ids = device.texture(size, "R32UI")
    target = device.target([ids], depth=True)
    device.clear(target)
    points = np.zeros((8, 4))
    points[:, 3] = 2.0**-26 * np.arange(8.0, 0.0, -1.0)
    source = scatter(device, points)
    interface = replace(POINTS, fragment=path("level_depth.frag"), depth=True)
    device.draw(interface, target, textures={"source": source}, vertices=8, primitive="POINTS", depth_test=True)
    seen = device.read(ids)
    assert seen[0, 0] == 7
    return {"ids": seen}


@case
def additive_blend(device: Device) -> Pixels:
    """Colours are added, alpha too; without `blend` the last one remains."""
    size = (61, 47)
    pixel, level = crowd(20_000, size, seed=4)
    points = np.zeros((len(pixel), 4))
    points[:, :2] = clip_from_pixel(pixel + 0.5, size)
    points[:, 3] = level
    source = scatter(device, points)
    colors = np.stack([level, 2 * level, -level, np.ones(len(level))], axis=1)
    cell = pixel[:, 1] * size[0] + pixel[:, 0]
    found: Pixels = {}
    for format in ("RGBA32F", "RGBA16F"):
        image = device.texture(size, format)
        target = device.target([image])
        for blend in (True, False):
            device.clear(target)
            device.draw(
                ADDED,
                target,
                textures={"source": source},
                vertices=len(points),
                primitive="POINTS",
                blend=blend,
            )
            expected = np.zeros((size[0] * size[1], 4), np.float32)
            if blend:
                np.add.at(expected, cell, colors)  # multiples of 1/64 below 32: exact in half a float as well
            else:
                expected[cell] = colors
            found[f"{format} {blend}"] = device.read(image)
            equal(found[f"{format} {blend}"], expected.reshape(size[1], size[0], 4), f"{format} {blend}")
    return found


@case
def culling(device: Device) -> Pixels:
    """Back faces, clockwise on the screen, are dropped only where asked."""
    size = (40, 20)
    image = device.texture(size, "RGBA32F")
    target = device.target([image])
    solid = Interface(
        "solid", vertex=path("triangles.vert"), fragment=path("solid.frag"), block=SOLID, outputs=(("vec4", "color"),)
    )
    found: Pixels = {}
    for cull in (False, True):
        device.clear(target)
        device.draw(solid, target, uniforms=SOLID.record(color=(1, 2, 3, 4)), vertices=6, cull=cull)
        found[f"cull {cull}"] = seen = device.read(image)
        covered = seen[..., 3] == 4.0
        assert covered[:, :20].sum() == 144  # half of 0.8 by 1.8 in clip space, 200 pixels to the unit square
        assert covered[:, 20:].sum() == (0 if cull else 144)
        assert not covered[0, 0]
        assert covered[1, 3]  # the triangle's wide end is at the bottom, which is row 0
    return found


@case
def lines(device: Device) -> Pixels:
    """A line is one pixel wide and covers the pixels that it passes."""
    image = device.texture((16, 16), "RGBA32F")
    target = device.target([image])
    device.clear(target)
    solid = Interface(
        "line", vertex=path("line.vert"), fragment=path("solid.frag"), block=SOLID, outputs=(("vec4", "color"),)
    )
    device.draw(solid, target, uniforms=SOLID.record(color=(1, 1, 1, 1)), vertices=6, primitive="LINES")
    expected = np.zeros((16, 16), np.float32)
    expected[[1, 3, 5], 2:14] = 1.0
    seen = device.read(image)
    equal(seen[..., 0], expected)
    return {"lines": seen}


@case
def several_outputs(device: Device) -> Pixels:
    """One draw writes textures of different formats; varyings are interpolated; defines are seen."""
    size = (333, 77)
    textures = [device.texture(size, format) for format in ("RGBA32F", "RGBA16F", "R32UI", "R32F")]
    interface = Interface(
        "gradient",
        vertex=path("gradient.vert"),
        fragment=path("gradient.frag"),
        varyings=(("smooth", "vec4", "shade"), ("flat", "int", "number")),
        outputs=(("vec4", "first"), ("vec4", "second"), ("uint", "third"), ("float", "fourth")),
        defines=(("FACTOR", "0.25"),),
    )
    device.draw(interface, device.target(textures))
    first, second, third, fourth = (device.read(texture) for texture in textures)
    x, y = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    green, blue = x / size[0] / 2, y / size[1] / 2
    expected = np.stack([1 - green - blue, green, blue, np.ones_like(x)], axis=-1)
    np.testing.assert_allclose(first, expected, atol=1e-6)  # measured 1.8e-7
    equal(second, np.broadcast_to(np.array([0.5, 1.0, 7.0, 0.25], np.float32), second.shape))
    equal(third, (np.floor(x) + 1000 * np.floor(y)).astype(np.uint32))
    equal(fourth[..., 0], x.astype(np.float32))
    return {"first": first, "second": second, "third": third, "fourth": fourth}


@case
def many_uniforms(device: Device) -> Pixels:
    """Draws that follow each other without a read in between keep their own uniforms."""
    solid = Interface("solid", fragment=path("solid.frag"), block=SOLID, outputs=(("vec4", "color"),))
    images = [device.texture((3, 2), "RGBA32F") for _ in range(100)]
    targets = [device.target([image]) for image in images]
    for number, target in enumerate(targets):
        device.draw(solid, target, uniforms=SOLID.record(color=(number, 0, 0, 1)))
    seen = np.stack([device.read(image) for image in images])
    equal(seen[..., 0], np.broadcast_to(np.arange(100.0)[:, None, None], (100, 2, 3)))
    return {"images": seen}


@case
def declared_but_unused(device: Device) -> Pixels:
    """A shader need not use all that its interface declares."""
    block = Block("Unused", "unused", (("vec4", "color"),))
    interface = Interface(
        "copy",
        fragment=path("copy.frag"),
        block=block,
        samplers=(("UINT_2D", "nothing"), ("FLOAT_2D", "source")),
        outputs=(("vec4", "color"),),
    )
    source = device.texture((2, 1), "RGBA32F", np.arange(8, dtype=np.float32))
    nothing, image = device.texture((1, 1), "R32UI"), device.texture((2, 1), "RGBA32F")
    device.draw(
        interface,
        device.target([image]),
        uniforms=block.record(color=(1, 2, 3, 4)),
        textures={"source": source, "nothing": nothing},
    )
    equal(device.read(image).ravel(), np.arange(8.0))
    return {"image": device.read(image)}


@case
def work_groups(device: Device) -> Pixels:
    """Each index is met once, for one group, for a row of them, and for more than one row holds."""
    found: Pixels = {}
    if not device.limits.image_atomics:
        return found
    for local_size, count in ((64, 1), (64, 1000), (1, 65_535), (1, 70_001), (1, 200_000)):
        interface = Interface(
            "count", compute=path("count.comp"), block=COUNT, images=(("R32UI", "counter"),), local_size=local_size
        )
        counter = device.texture((512, 400), "R32UI")
        device.fill(counter)
        groups = -(-count // local_size)
        device.dispatch(interface, groups, uniforms=COUNT.record(count=count), images={"counter": counter})
        seen = device.read(counter)
        expected = np.full(512 * 400, EMPTY, np.uint32)
        expected[:count] = 0  # EMPTY + 1
        equal(seen.ravel(), expected, f"{count} of {local_size}")
        found[str(count)] = seen
    return found


@case
def image_atomics(device: Device) -> Pixels:
    """The nearest depth by imageAtomicMin, then the lowest index that has it: each dispatch sees the one before."""
    if not device.limits.image_atomics:
        return {}
    size, count = (61, 47), 100_000
    pixel, depth = crowd(count, size, seed=5)
    points = np.zeros((count, 4))
    points[:, :2], points[:, 2] = pixel, depth
    source = scatter(device, points)
    depths, ids = device.texture(size, "R32UI"), device.texture(size, "R32UI")
    seen = run_atomics(device, source, count, depths, ids)
    equal(seen["ids"], nearest(pixel, depth, size))
    least = np.full(size[0] * size[1], np.inf, np.float32)
    np.minimum.at(least, pixel[:, 1] * size[0] + pixel[:, 0], depth.astype(np.float32))
    covered = np.isfinite(least)
    equal(seen["depths"].ravel()[covered], least[covered].view(np.uint32))
    return seen


def run_atomics(device: Device, source, count: int, depths, ids) -> Pixels:
    """Project `count` points of `source` (pixel x, y, depth) in two dispatches."""
    samplers, uniforms = (("FLOAT_2D", "points"),), COUNT.record(count=count)
    first = Interface(
        "nearest", compute=path("nearest.comp"), block=COUNT, samplers=samplers, images=(("R32UI", "depth"),)
    )
    second = Interface(
        "winner",
        compute=path("winner.comp"),
        block=COUNT,
        samplers=(*samplers, ("UINT_2D", "depth")),
        images=(("R32UI", "id"),),
    )
    device.fill(depths)
    device.fill(ids)
    groups = -(-count // 64)
    device.dispatch(first, groups, uniforms=uniforms, textures={"points": source}, images={"depth": depths})
    textures = {"points": source, "depth": depths}
    device.dispatch(second, groups, uniforms=uniforms, textures=textures, images={"id": ids})
    return {"depths": device.read(depths), "ids": device.read(ids)}


@case
def image_of_floats(device: Device) -> Pixels:
    """A compute shader reads and writes an image of floats that a draw has cleared and another then samples."""
    if not device.limits.image_atomics:
        return {}
    size = (33, 7)
    image, copied = device.texture(size, "RGBA32F"), device.texture(size, "RGBA32F")
    device.clear(device.target([image]), (1.0, 2.0, 3.0, 4.0))
    store = Interface("store", compute=path("store.comp"), images=(("RGBA32F", "result"),))
    copy = Interface(
        "copy", fragment=path("copy.frag"), samplers=(("FLOAT_2D", "source"),), outputs=(("vec4", "color"),)
    )
    device.dispatch(store, -(-size[0] * size[1] // 64), images={"result": image})
    device.draw(copy, device.target([copied]), textures={"source": image})
    x, y = np.meshgrid(np.arange(size[0]), np.arange(size[1]))
    expected = np.stack([x + 2, y + 4, y * size[0] + x + 6, np.full_like(x, 9)], axis=-1)
    seen = device.read(copied)
    equal(seen, expected.astype(np.float32))
    return {"image": seen}


@case
def memory(device: Device) -> Pixels:
    """Bytes are counted while textures live and not after; releasing twice does no harm."""
    before = device.bytes_allocated()
    color, ids = device.texture((10, 20), "RGBA16F"), device.texture((10, 20), "R32UI")
    target = device.target([color, ids], depth=True)
    assert device.bytes_allocated() - before == 200 * (8 + 4 + 4)
    for thing in (target, color, ids, target, color):
        thing.release()
    assert device.bytes_allocated() == before
    return {}


@case
def timers(device: Device) -> Pixels:
    """A timer measures what lies between its start and its stop, and can be used again and again."""
    image = device.texture((64, 64), "RGBA32F")
    target = device.target([image])
    solid = Interface("solid", fragment=path("solid.frag"), block=SOLID, outputs=(("vec4", "color"),))
    for _ in range(3):
        timer = device.start_timer()
        device.draw(solid, target, uniforms=SOLID.record(color=(1, 0, 0, 1)))
        device.stop_timer(timer)
        first = timer.milliseconds()
        assert first >= 0.0
        assert timer.milliseconds() == first
    return {}


@case
def timers_that_nobody_reads(device: Device) -> Pixels:
    """A timer that is released before it is read gives back what it measured with, and the next ones measure."""
    image = device.texture((64, 64), "RGBA32F")
    target = device.target([image])
    solid = Interface("solid", fragment=path("solid.frag"), block=SOLID, outputs=(("vec4", "color"),))

    def timed() -> Timer:
        timer = device.start_timer()
        device.draw(solid, target, uniforms=SOLID.record(color=(1, 0, 0, 1)))
        device.stop_timer(timer)
        return timer

    timed().milliseconds()
    free = len(getattr(device, "free_queries", ()))
    for _ in range(20):
        timer = timed()
        timer.release()
        timer.release()
    assert len(getattr(device, "free_queries", ())) == free
    assert timed().milliseconds() >= 0.0
    return {}


def run(device: Device, function: Callable[[Device], Pixels]) -> Pixels:
    """Run one case and free what it made."""
    kept = set(device.alive)  # type: ignore[attr-defined]
    try:
        return function(device)
    finally:
        for thing in set(device.alive) - kept:  # type: ignore[attr-defined]
            thing.release()


def compare(name: str, first: Pixels, second: Pixels) -> None:
    """The same pixels from two devices: to the last bit, except where a case says why not."""
    assert first.keys() == second.keys(), name
    for key in first:
        assert first[key].dtype == second[key].dtype, f"{name}, {key}"
        equal(first[key], second[key], f"{name}, {key}")
