"""The direction of imports: host → devices, render → stream → formats → shading, core."""

import ast
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "pointsplat_addon"
FILES = sorted(PACKAGE.rglob("*.py"))

# For each room, the tops of what importing it must not load.
FORBIDDEN = {
    "core": {"bpy", "gpu", "moderngl", "glcontext"},
    "shading": {"bpy", "gpu", "moderngl", "glcontext"},
    "formats": {
        "bpy",
        "gpu",
        "moderngl",
        "pointsplat_addon.stream",
        "pointsplat_addon.render",
        "pointsplat_addon.host",
    },
    "stream": {
        "bpy",
        "gpu",
        "moderngl",
        "pointsplat_addon.render",
        "pointsplat_addon.devices",
        "pointsplat_addon.host",
    },
    "render": {"bpy", "gpu", "moderngl", "glcontext", "pointsplat_addon.devices", "pointsplat_addon.host"},
}


def modules(room: str) -> list[str]:
    parts = [f.relative_to(ROOT).with_suffix("").parts for f in sorted((PACKAGE / room).rglob("*.py"))]
    return [".".join(p[:-1] if p[-1] == "__init__" else p) for p in parts]


def imported_names(file: Path) -> set[str]:
    """Absolute names of all modules that a file imports, at its top or inside functions."""
    package = file.relative_to(ROOT).parent.parts
    names: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            stem = ".".join([*base, *([node.module] if node.module else [])])
            names |= {stem} | {f"{stem}.{alias.name}" for alias in node.names}
    return names


def below(name: str, top: str) -> bool:
    return name == top or name.startswith(top + ".")


@pytest.mark.parametrize("room", FORBIDDEN)
def test_importing_a_room_loads_no_module_it_must_not_know(room: str) -> None:
    names = modules(room)
    assert names
    code = f"import importlib, sys\nfor name in {names!r}: importlib.import_module(name)\nprint(*sys.modules)"
    out = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert out.returncode == 0, out.stderr
    loaded = set(out.stdout.split())
    assert set(names) <= loaded
    assert sorted(m for m in loaded for top in FORBIDDEN[room] if below(m, top)) == []


@pytest.mark.parametrize("file", FILES, ids=lambda f: str(f.relative_to(PACKAGE)))
def test_a_file_imports_only_what_its_room_may(file: Path) -> None:
    room = file.relative_to(PACKAGE).parts[0]
    names = imported_names(file)
    if room != "host":
        assert not [n for n in names if below(n, "bpy") or below(n, "bpy_extras")]
    if room not in ("host", "devices"):
        assert not [n for n in names if below(n, "gpu") or below(n, "moderngl")]
    if room not in ("host", "__init__.py"):
        assert not [n for n in names if below(n, "pointsplat_addon.host")]
    if room == "core":
        outside = [n for n in names if below(n, "pointsplat_addon") and not below(n, "pointsplat_addon.core")]
        assert [n for n in outside if n != "pointsplat_addon"] == []


def test_the_package_is_imported_relatively_inside_itself() -> None:
    """An installed extension is called bl_ext.<repository>.pointsplat, so its own absolute name does not exist."""
    absolute = {
        str(file.relative_to(ROOT)): node.lineno
        for file in FILES
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if (isinstance(node, ast.ImportFrom) and node.level == 0 and below(node.module or "", "pointsplat_addon"))
        or (isinstance(node, ast.Import) and any(below(a.name, "pointsplat_addon") for a in node.names))
    }
    assert absolute == {}


# The rooms of a layer, in the order in which they may import each other: each only those before it.
ORDERS = {
    "core": (
        "numeric", "scene", "sky", "material", "light", "splat", "surface", "strand", "volume", "lod", "shadow",
        "indirect", "lens",
    ),
    "render": (
        "device", "cache", "prepare", "shadow", "passes", "indirect", "plan", "frame", "budget", "light_passes",
        "renderer",
    ),
}  # fmt: skip
MOST_FILES = 13  # of a folder: an outline of it fits a screen
# Names that told nobody what was in the file.
ODD_NAMES = {
    "sound", "places", "apart", "covers", "pieces", "pigment", "faint", "blurred", "shot", "last", "leaving",
}  # fmt: skip


def module_graph() -> dict[str, set[str]]:
    """The modules of the package that each of them imports: at the top, for types only, and inside functions."""
    names = {}
    for file in FILES:
        parts = file.relative_to(ROOT).with_suffix("").parts
        names[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = file
    graph = {}
    for name, file in names.items():
        found = {imported for imported in imported_names(file) if imported in names}
        # `from .a import b` names the package a beside its module b: what is meant is the module.
        packages = {n for n in found if names[n].name == "__init__.py" and any(below(m, n) and m != n for m in found)}
        graph[name] = found - packages - {name}
    return graph


def reached(graph: dict[str, set[str]], name: str) -> set[str]:
    """The modules that one of them imports, itself or by way of others."""
    found: set[str] = set()
    new = set(graph[name])
    while new:
        found |= new
        new = set().union(*(graph[n] for n in new)) - found
    return found


def circles(graph: dict[str, set[str]]) -> set[str]:
    """The modules that import themselves by way of others."""
    return {name for name in graph if name in reached(graph, name)}


def test_no_modules_import_each_other_in_a_circle() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == {"b", "c"}
    assert sorted(circles(module_graph())) == []


@pytest.mark.parametrize("layer", ORDERS)
def test_rooms_import_only_rooms_before_them(layer: str) -> None:
    order = {f"pointsplat_addon.{layer}.{room}": number for number, room in enumerate(ORDERS[layer])}

    def rank(name: str) -> int | None:
        return next((number for room, number in order.items() if below(name, room)), None)

    rooms = {p.stem for p in (PACKAGE / layer).iterdir() if p.name not in ("__init__.py", "__pycache__")}
    assert rooms <= set(ORDERS[layer])
    upward = [
        f"{name} imports {imported}"
        for name, imports in module_graph().items()
        for imported in imports
        if (here := rank(name)) is not None and (there := rank(imported)) is not None and there > here
    ]
    assert sorted(upward) == []


def test_folders_are_small() -> None:
    files = [f for top in (PACKAGE, ROOT / "shaders") for f in top.rglob("*") if f.is_file() and f.suffix != ".pyc"]
    number = Counter(str(f.parent.relative_to(ROOT)) for f in files if f.name != "__init__.py")
    assert {folder: count for folder, count in number.items() if count > MOST_FILES} == {}


def test_no_file_has_a_name_that_tells_nothing() -> None:
    files = [f for top in (PACKAGE, ROOT / "shaders") for f in top.rglob("*") if f.is_file() and f.suffix != ".pyc"]
    assert [str(f.relative_to(ROOT)) for f in files if f.stem in ODD_NAMES] == []
