"""Every number of a scene has a rule, and what it says is done."""

# pyright: reportOptionalSubscript=false, reportOptionalMemberAccess=false, reportArgumentType=false
# pyright: reportCallIssue=false
# Attributes may be None by type; what is tested here has those that are asked for.
from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from types import NoneType
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest

from pointsplat_addon.core.scene import validation as v
from pointsplat_addon.core.scene.camera import Aperture, Camera
from pointsplat_addon.core.scene.cloud import ATTRIBUTES, PointCloud
from pointsplat_addon.core.scene.lights import Light
from pointsplat_addon.core.scene.materials import CoatTable, HairTable, MaterialTable, default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.strands import Strands
from pointsplat_addon.core.scene.world import World

F = np.float32
# Fields of whole numbers and booleans; what they refer to is the converters' own.
COUNTED = {
    PointCloud: {"material", "kernel", "disconnected", "facets"},
    Mesh: {"triangles", "material"},
    Strands: {"start", "material"},
    MaterialTable: {"cull", "pass_index", "hash", "translucent", "glass"},
    HairTable: {"used"},
    Instances: {"geometry", "pass_index", "holdout", "matte", "casts", "seen", "scatters", "mirrored", "object_hash"},
    v.Volume: {"index"},
}


def numeric(kind: type) -> set[str]:
    """Names of the fields that hold numbers."""
    hints = get_type_hints(kind, vars(__import__(kind.__module__, fromlist=["_"])))

    def holds(hint: Any) -> bool:
        parts = [p for p in get_args(hint) if p is not NoneType]
        return hint is float or hint is np.ndarray or any(holds(p) for p in parts)

    return {f.name for f in fields(kind) if holds(hints[f.name])} - COUNTED.get(kind, set())


def scene_parts() -> list[type]:
    """The dataclasses that a scene and a camera are made of."""
    found: list[type] = []

    def look(kind: Any) -> None:
        if is_dataclass(kind) and isinstance(kind, type) and kind not in found:
            found.append(kind)
            for hint in get_type_hints(kind, vars(__import__(kind.__module__, fromlist=["_"]))).values():
                look(hint)
        for part in get_args(kind):
            look(part)

    look(Scene)
    look(Camera)
    return found


def test_every_number_has_a_rule():
    for kind in scene_parts():
        if kind is Scene:
            continue
        assert set(v.RULES.get(kind, {})) == numeric(kind), kind.__name__


def test_the_table_of_attributes_is_that_of_the_fields():
    assert set(ATTRIBUTES) == {f.name for f in fields(PointCloud)} - {"origin"}


def light() -> Light:
    return Light("AREA", np.ones(3), np.zeros(3), np.array([0, 0, -1.0]), axis_u=np.eye(3)[0], axis_v=np.eye(3)[1])


def hair() -> HairTable:
    one = np.full(1, 0.5, F)
    return HairTable(np.ones(1, bool), one, one, one, np.full((1, 3), 0.5, F))


def coat() -> CoatTable:
    one = np.full(1, 0.5, F)
    return CoatTable(one, one, one, np.full((1, 3), 0.5, F))


def cloud() -> PointCloud:
    def filled(name: str) -> np.ndarray:
        shape, dtype = ATTRIBUTES[name]
        return np.full((4, *((1,) if shape is None else shape)), 0.5).astype(dtype)

    return PointCloud(**{name: filled(name) for name in ATTRIBUTES})


def mesh() -> Mesh:
    position = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], F)
    return Mesh("m", "m", position, np.array([[0, 1, 2], [0, 2, 3]], np.int32), topology="t")


def strands() -> Strands:
    position = np.arange(18, dtype=F).reshape(6, 3)
    return Strands("s", "s", position, np.array([0, 3, 6]), np.full(6, 0.1, F), color=np.ones((6, 3), F),
                   surface=np.ones((6, 2), F), emission=np.ones((6, 3), F))  # fmt: skip


def camera() -> Camera:
    clip = np.array([[2.0, 0, 0, 0], [0, 2, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]])
    return Camera(np.eye(4), clip, (8, 8), previous_view_from_world=np.eye(4), previous_clip_from_view=clip,
                  aperture=Aperture(0.1, 2.0))  # fmt: skip


def whole() -> Scene:
    geometries = (
        Geometry("c", "Cloud", cloud=cloud()),
        Geometry("m", "Mesh", mesh=mesh()),
        Geometry("s", "Strands", strands=strands()),
    )
    matrices = np.tile(np.eye(4), (3, 1, 1))
    table = replace(
        default_materials(),
        hair=hair(),
        coat=coat(),
        anisotropy=np.zeros(1, F),
        backlit=np.zeros((1, 3), F),
        tint=np.ones((1, 3), F),
        diffuse_roughness=np.zeros(1, F),
        sheen=np.zeros((1, 4), F),
        toon=-np.ones((1, 2), F),
        holdout=np.zeros(1, F),
    )
    return Scene(geometries, Instances(np.arange(3, dtype=np.int32), matrices, matrices.copy()), table, (light(),))


def broken(owner: Any, name: str, bad: float) -> Any:
    """The dataclass with one bad number in a field."""
    value = getattr(owner, name)
    if isinstance(value, np.ndarray):
        value = value.copy()
        value.reshape(-1)[-1] = bad
        return replace(owner, **{name: value})
    return replace(owner, **{name: bad})


def cases(action: str, *kinds: type):
    return [(kind, name) for kind in kinds for name, rule in v.RULES[kind].items() if rule.action == action]


BAD = pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e38])


def test_a_valid_scene_is_not_copied():
    given, seen = whole(), camera()
    found, same = v.validate(given, seen)
    assert same is seen
    assert found.warnings == ()
    for name in ("geometries", "instances", "materials", "lights", "world"):
        assert getattr(found, name) is getattr(given, name)
    assert v.validate(found, seen)[0] is found


@BAD
@pytest.mark.parametrize(("kind", "name"), cases(v.REMOVE, PointCloud))
def test_points_are_removed(kind, name, bad):
    rule = v.RULES[kind][name]
    given = whole()
    with np.errstate(over="ignore"):
        points = broken(given.geometries[0].cloud, name, bad)
    given = replace(given, geometries=(replace(given.geometries[0], cloud=points), *given.geometries[1:]))
    found, _ = v.validate(given, camera())
    fits = rule.low <= bad <= rule.high
    left = 4 if fits else 0 if name == "origin" else 3
    assert len(found.geometries[0].cloud) == left
    lost = 4 - left
    assert found.warnings == ((f"Cloud: {lost} points that are not finite were left out",) if lost else ())
    assert found.geometries[1:] == given.geometries[1:]
    assert np.isfinite(found.geometries[0].cloud.origin).all()


@BAD
def test_triangles_are_removed(bad):
    given = whole()
    bad_mesh = broken(given.geometries[1].mesh, "position", bad)
    given = replace(given, geometries=(given.geometries[0], replace(given.geometries[1], mesh=bad_mesh)))
    found, _ = v.validate(given, camera())
    assert len(found.geometries[1].mesh.triangles) == 1
    assert np.abs(found.geometries[1].mesh.position).max() <= v.LARGEST
    assert found.warnings[0].startswith("Mesh: 1 triangle is not drawn (1 ")


@BAD
@pytest.mark.parametrize(("kind", "name"), cases(v.REMOVE, Strands))
def test_strands_lose_points(kind, name, bad):
    rule = v.RULES[kind][name]
    given = whole()
    bad_strands = broken(given.geometries[2].strands, name, bad)
    given = replace(given, geometries=(*given.geometries[:2], replace(given.geometries[2], strands=bad_strands)))
    found, _ = v.validate(given, camera())
    left = found.geometries[2].strands
    count = 6 if rule.low <= bad <= rule.high else 0 if name == "origin" else 5
    assert len(left.position) == count
    assert bool(found.warnings) == (count < 6)
    for array in (left.position, left.radius, left.origin, left.color, left.surface, left.emission):
        assert np.isfinite(array).all()


@BAD
@pytest.mark.parametrize(("kind", "name"), cases(v.LEAVE_OUT, Light))
def test_lights_are_left_out_and_named(kind, name, bad):
    given = replace(whole(), lights=(light(), broken(replace(light(), name="Odd"), name, bad)))
    found, _ = v.validate(given, camera())
    assert found.lights == given.lights[:1]
    assert found.warnings == (f'Light "Odd": its {name} cannot be drawn, so it gives no light',)


@BAD
@pytest.mark.parametrize(("kind", "name"), cases(v.CLAMP, MaterialTable, HairTable, CoatTable))
def test_materials_are_clamped(kind, name, bad):
    given, rule = whole(), v.RULES[kind][name]
    table = given.materials
    part = {HairTable: "hair", CoatTable: "coat"}.get(kind)
    if part is None:
        table = broken(table, name, bad)
    else:
        table = replace(table, **{part: broken(getattr(table, part), name, bad)})
    found = v.validate(replace(given, materials=table), camera())[0]
    owner = found.materials if part is None else getattr(found.materials, part)
    column = getattr(owner, name)
    assert rule.low - 1e-6 <= column.min() <= column.max() <= rule.high * (1 + 1e-6)  # in float32
    assert len(found.warnings) == 1


@BAD
def test_the_world_is_clamped_or_plain(bad):
    world = World(color=np.array([0.5, bad, 1]), world_rotation=np.full((3, 3), bad))
    found = v.validate(replace(whole(), world=world), camera())[0].world
    assert np.abs(found.color).max() <= v.FARTHEST
    assert found.color[0] == 0.5
    np.testing.assert_array_equal(found.world_rotation, np.eye(3))


@BAD
def test_instances_that_were_nowhere_have_not_moved(bad):
    given = whole()
    found = v.validate(replace(given, instances=broken(given.instances, "previous", bad)), camera())[0].instances
    np.testing.assert_array_equal(found.previous, given.instances.world_from_object)


@BAD
@pytest.mark.parametrize(("kind", "name"), cases(v.DEFAULT, Geometry))
def test_geometries_choose_by_default(kind, name, bad):
    rule = v.RULES[kind][name]
    given = whole()
    given = replace(given, geometries=(replace(given.geometries[0], **{name: bad}),))
    found = getattr(v.validate(given, camera())[0].geometries[0], name)
    assert found == (bad if rule.low <= bad <= rule.high else 0)


@BAD
@pytest.mark.parametrize("name", [n for _, n in cases(v.WORLD_ONLY, Camera)])
def test_a_camera_that_is_nowhere_sees_the_world_alone(name, bad):
    found, seen = v.validate(whole(), broken(camera(), name, bad))
    assert (found.geometries, found.lights, len(found.instances)) == ((), (), 0)
    assert len(found.warnings) == 1
    assert np.isfinite(seen.view_from_world).all()
    assert np.isfinite(seen.clip_from_view).all()


@BAD
@pytest.mark.parametrize("name", [n for _, n in cases(v.DEFAULT, Camera) if n.startswith("previous")])
def test_a_camera_that_was_nowhere_has_not_moved(name, bad):
    seen = v.validate(whole(), broken(camera(), name, bad))[1]
    assert seen.previous_view_from_world is None
    assert seen.previous_clip_from_view is None


@BAD
def test_a_camera_of_impossible_pixels_has_those_of_its_picture(bad):
    rule = v.RULES[Camera]["coarseness"]
    seen = v.validate(whole(), replace(camera(), coarseness=bad))[1]
    assert seen.coarseness == (bad if rule.low <= bad <= rule.high else 1)
    assert seen.previous_view_from_world is not None


@BAD
@pytest.mark.parametrize("name", [n for _, n in cases(v.LEAVE_OUT, Aperture)])
def test_a_lens_that_is_none_blurs_nothing(name, bad):
    rule = v.RULES[Aperture][name]
    given = camera()
    found, seen = v.validate(whole(), replace(given, aperture=replace(given.aperture, **{name: bad})))
    fits = rule.low <= bad <= rule.high
    assert (seen.aperture is not None) == fits
    assert len(found.warnings) == (0 if fits else 1)


def test_geometries_are_looked_at_once_by_their_content():
    kept: dict[str, Any] = {}
    made: list[str] = []

    def lookup(keys: Sequence[str], make: Callable[[list[int]], Sequence[Any]]) -> list[Any]:
        rows = [row for row, key in enumerate(keys) if key not in kept]
        made.extend(keys[row] for row in rows)
        kept.update(zip([keys[row] for row in rows], make(rows), strict=True))
        return [kept[key] for key in keys]

    given = whole()
    for _ in range(3):
        v.validate(given, camera(), lookup)
    assert len(made) == len(given.geometries)
    assert all(changed is None for changed, _ in kept.values())
