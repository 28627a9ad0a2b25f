"""Declarations and GLSL text, without a GPU."""

import numpy as np
import pytest

from pointsplat_addon.shading import sources
from pointsplat_addon.shading.interface import Block, Interface
from tests.support import devices_suite as suite

FIELDS = (("float", "a"), ("vec2", "b"), ("float", "c"), ("vec4", "d"), ("int", "e"), ("mat4", "f"), ("ivec2", "g"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setattr(sources, "FOLDER", tmp_path)
    sources.load.cache_clear()
    yield tmp_path
    sources.load.cache_clear()


def test_a_block_follows_std140():
    """Scalars align to 4 bytes, vec2 to 8, vec4 and matrices to 16; the size is a multiple of 16."""
    dtype = Block("B", "b", FIELDS).dtype()
    offsets = {name: field[1] for name, field in (dtype.fields or {}).items()}
    assert offsets == {"a": 0, "b": 8, "c": 16, "d": 32, "e": 48, "f": 64, "g": 128}
    assert dtype.itemsize == 144


def test_a_record_holds_matrices_by_column_and_refuses_unknown_names():
    block = Block("B", "b", FIELDS)
    matrix = np.arange(16.0).reshape(4, 4)
    record = block.record(f=matrix, d=(1, 2, 3, 4))
    assert record["f"][0].tolist() == matrix.T.ravel().tolist()
    assert record["c"][0] == 0.0
    with pytest.raises(ValueError, match="nothing"):
        block.record(nothing=1.0)


def test_a_header_declares_for_each_stage_what_it_may_use():
    interface = Interface(
        "all",
        fragment="x.frag",
        block=Block("B", "b", (("float", "a"),)),
        samplers=(("FLOAT_2D", "s"),),
        images=(("R32UI", "i"),),
        varyings=(("flat", "int", "v"),),
        outputs=(("vec4", "o"), ("uint", "p")),
        local_size=32,
    ).with_defines("FAST")
    vertex, fragment, compute = (interface.header(stage, 430) for stage in ("vertex", "fragment", "compute"))
    for text in (vertex, fragment, compute):
        assert text.startswith("#version 430 core\n#define FAST 1\n")
        assert "uniform sampler2D s;" in text
        assert "layout(std140) uniform B_block { B b; };" in text
    assert "flat out int v;" in vertex
    assert "flat in int v;" in fragment
    assert "layout(location = 1) out uint p;" in fragment
    assert "out uint p" not in vertex
    assert "uniform uimage2D i;" in compute
    assert "local_size_x = 32" in compute
    assert "image2D" not in vertex + fragment


def test_includes_are_taken_once_and_lines_lead_back_to_their_files(folder):
    (folder / "lib").mkdir()
    (folder / "lib/a.glsl").write_text('#include "lib/b.glsl"\nA\n')
    (folder / "lib/b.glsl").write_text('#include "lib/a.glsl"\nB1\nB2\n')
    (folder / "main.frag").write_text('M1\n#include "lib/a.glsl"\n  #include "lib/b.glsl"\nM4\n')
    source = sources.load("main.frag")
    assert source.text.split() == ["M1", "B1", "B2", "A", "M4"]
    places = ["main.frag:1", "lib/b.glsl:2", "lib/b.glsl:3", "lib/a.glsl:2", "main.frag:4"]
    assert [source.location(line) for line in range(1, 6)] == places


@pytest.mark.parametrize(
    ("log", "explained"),
    [
        ("0:1001(3): error: `x' undeclared", "main.frag:1: error: `x' undeclared"),
        ("0(1002) : error C1503: undefined", "lib/a.glsl:1 : error C1503: undefined"),
        ("ERROR: 0:1003: 'y' : undeclared", "ERROR: main.frag:3: 'y' : undeclared"),
        ("0:2(10): error: no type T", "declarations:2: error: no type T"),
        ("GLSL 4.30 is too old", "GLSL 4.30 is too old"),
    ],
)
def test_messages_of_all_drivers_are_explained(folder, log, explained):
    (folder / "lib").mkdir()
    (folder / "lib/a.glsl").write_text("A\n")
    (folder / "main.frag").write_text('M1\n#include "lib/a.glsl"\nM3\n')
    assert sources.load("main.frag").explain(log) == explained


def test_a_missing_file_is_named_with_the_line_that_wants_it(folder):
    (folder / "main.frag").write_text('\n#include "lib/none.glsl"\n')
    with pytest.raises(sources.ShaderError, match=r"main\.frag:2: cannot read the shader lib/none\.glsl"):
        sources.load("main.frag")
    with pytest.raises(sources.ShaderError, match=r"other\.frag"):
        sources.load("other.frag")


def test_shaders_declare_nothing_themselves():
    """The interface declares; a body that does so too would not compile on the other device."""
    for file in [*sources.FOLDER.rglob("*.*"), *suite.SHADERS.iterdir()]:
        if file.suffix == ".md":
            continue
        words = [line.split("//")[0].split() for line in file.read_text(encoding="utf-8").splitlines()]
        first = {line[0] for line in words if line}
        assert not first & {"#version", "#extension", "uniform", "layout", "varying", "attribute"}, file
