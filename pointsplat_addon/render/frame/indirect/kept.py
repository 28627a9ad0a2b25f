"""The light tree of a scene, kept on the device from picture to picture, and on disk for other processes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from ....core.indirect.triangle_tree import triangle_tree
from ....core.scene.camera import Camera
from ....core.scene.scene import Scene
from ....core.scene.world import World
from ...cache.keys import Key, Kind
from ...cache.on_disk import form_of_records
from ...cache.store import Store
from ...device.clock import Cancelled
from ...device.protocol import Device
from ...indirect.bake import Baker
from ...indirect.known_sites import Slices
from ...indirect.light import BakedLight, IndirectLight, world_names
from ...indirect.media import BakedMedia, scene_media
from ...indirect.surfels import scene_density, scene_surfels, usable_instances
from ...indirect.traced import scene_triangles
from ...passes.indirect.trace import TracedTriangles
from ...passes.shading.terms import OCCLUSION
from ...plan.plan import Plan
from ..uploads.lighting import ArrayIdentity
from ..uploads.uploads import Uploads
from .mirrors import TracedScene

FORM = form_of_records(BakedLight, BakedMedia)
WHITE = ("PS_HAS_WORLD",)
NEAREST, FARTHEST = 1e-30, 1e30  # of what occludes: their inverses are floats, too


def kept_light(
    device: Device,
    uploads: Uploads,
    scene: Scene,
    camera: Camera,
    plan: Plan,
    bounces: int,
    store: Store,
    check: Callable[[], None],
    slices: Slices,
) -> IndirectLight:
    """Returns the indirect light of a scene; where nothing hides or scatters light, all of the sky is open.

    Of the term OCCLUSION: how much of the world what casts shadows leaves open. It depends on the camera only as the
    density of surfels does. Raises what `check` raises. Cancelled: `slices` put
    the rest off; what was made until then stays in the store. Unless they are endless, surfels are made on the store's
    thread, and Cancelled is raised until they are there.
    """
    lighting = tuple(name for name in plan.lighting if name != "PS_SHADOW_NESTED")
    light, within = uploads.lighting, None
    if plan.term is not None and plan.term.light == OCCLUSION:
        scene, lighting, within = _in_white_world(scene), WHITE, _finite(plan.term.within)
    density, origin = scene_density(scene, camera, store)
    geometries, *content = scene_content(scene, store)
    depends_on = density.key, *content, light.shadow_key, lighting, bounces
    depends_on += () if within is None else (within,)
    key = Key(Kind.LIGHT_TREE, geometries, other=depends_on)

    # Each device has its own, for a picture on another thread may need the same.
    of_baker = Key(Kind.LIGHT_BAKER, key.content, other=(*depends_on, id(device)))

    def make_baker() -> Baker | None:
        checked = check if slices.endless else lambda: None
        surfels = scene_surfels(scene, density, origin, store, checked)
        media = scene_media(scene, usable_instances(scene), origin, checked)
        if not len(surfels) and media is None:
            return None
        apart = density.seen_at(surfels.position, origin)
        return Baker(scene, surfels, lighting, bounces, media, apart)

    def bake() -> BakedLight:
        if not slices.endless and not store.made_later(of_baker, make_baker):
            raise Cancelled
        baker: Baker | None = store.lookup(of_baker, make_baker)
        if baker is None:
            return BakedLight(origin, np.zeros((0, 16), np.float32), np.zeros(4, np.float32))
        textures = light.textures
        if scene.lights and bounces > 0:
            shift = np.eye(4)
            shift[:3, 3] = -origin
            textures = light.textures_for_all_cameras(shift)
        baked = baker.bake(device, textures, slices, check)
        store.drop({of_baker} & store.keys())
        return baked

    def make() -> IndirectLight:
        baked = light.on_disk.lookup(key, bake, FORM, device.limits.driver)
        return IndirectLight(device, baked, scene.world, world_names(lighting), key, within)

    found: IndirectLight = uploads.lookup(key, make)
    return found


def _in_white_world(scene: Scene) -> Scene:
    """The scene, in which what casts shadows hides an even world that is 1, and nothing else shines."""
    instances, table = replace(scene.instances, scatters=scene.instances.casts), scene.materials
    if table.glass is not None and table.translucent is not None:
        table = replace(table, translucent=table.translucent & ~table.glass)  # it bends light, but casts shadows
    return replace(scene, instances=instances, materials=table, world=World(np.ones(3)), lights=())


def _finite(distance: float) -> float:
    """The distance, for the device; one that is no number is as good as none."""
    return FARTHEST if np.isnan(distance) else min(max(float(distance), NEAREST), FARTHEST)


def scene_content(scene: Scene, store: Store) -> tuple:
    """Returns what the light of a scene depends on, but for cameras and settings: the keys of its geometries, and
    hashes of all else."""
    instances = scene.instances
    captured = tuple(one.lighting for one in scene.geometries if one.captured is not None)
    return (
        tuple(geometry.key for geometry in scene.geometries), captured,
        _digest(instances.geometry, instances.world_from_object), _digest(*instances.objects.values()),
        _digest(*(() if instances.scatters is None else (instances.scatters,))), _digest(*_values(scene.materials)),
        tuple(_digest(*_values(one)) for one in scene.lights), _world_digest(scene, store),
    )  # fmt: skip


def kept_triangles(device: Device, uploads: Uploads, scene: Scene, origin: np.ndarray) -> TracedScene:
    """Returns the triangles of a scene that rays may meet, in the light tree's space, whose origin (3,) that is."""
    instances = scene.instances
    shown = tuple(None if one is None else _digest(one) for one in (instances.mirrored, instances.matte))
    passes = scene.materials.translucent
    depends_on = (
        _digest(instances.geometry, instances.world_from_object, origin), shown,
        b"" if passes is None else _digest(passes),
    )  # fmt: skip
    key = Key(Kind.TRACED_TRIANGLES, tuple(geometry.key for geometry in scene.geometries), other=depends_on)

    def make() -> TracedScene:
        found = scene_triangles(scene, origin)
        if found is None:
            return TracedScene(None, None)
        triangles, corners = found
        return TracedScene(triangles, TracedTriangles(device, corners, triangle_tree(corners)))

    return uploads.lookup(key, make)


def _values(of: object) -> list[object]:
    """What a record holds."""
    return [getattr(of, f.name) for f in fields(of)]  # type: ignore[arg-type]


def _world_digest(scene: Scene, store: Store) -> bytes:
    world, image = scene.world, scene.world.image
    of_image = b""
    if image is not None:
        of_image = store.lookup(Key(Kind.IMAGE_DIGEST, ArrayIdentity(image)), lambda: _digest(image))
    return _digest(world.color, world.world_rotation, of_image)


def _digest(*of: object) -> bytes:
    """A short hash of arrays, numbers, names and what graphs of materials are."""
    found = hashlib.blake2b(digest_size=16)
    for one in of:
        if isinstance(one, np.ndarray):
            found.update(repr((one.shape, one.dtype.str)).encode() + np.ascontiguousarray(one).tobytes())
        elif isinstance(one, tuple):
            found.update(b"(" + b"".join(_digest(part) for part in one))
        elif isinstance(one, bytes):
            found.update(one)
        else:
            found.update(str(getattr(one, "digest", one)).encode())
    return found.digest()
