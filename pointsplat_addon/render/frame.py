"""One picture: prepare the scene for its view, plan, draw samples, average, report."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..core import sampling
from ..core.appearance import digest
from ..core.environment import build_atlas
from ..core.lighting import light_texture
from ..core.scene import Camera, Scene, Settings
from .device import Device, Target, Texture
from .filtering import cryptomatte, offsets
from .outputs import BACKGROUND_DEPTH, BY_KEY, CRYPTO
from .packing import paged
from .passes import polygons as polygon_pass
from .passes import shade as shade_pass
from .passes.common import GBuffer, Variant, frame_record
from .passes.points import Page, PageDraw, Projection, blocks, instance_rows, programs, resolve, with_origin
from .passes.pyramid import Pyramid, levels
from .plan import Plan, make_plan
from .prepare import STORE, PointSet, Prepared, prepare

OWN_PAGE = 4 << 20  # splats: larger sets get a page of their own, so that small changes upload little
DEVICE_LIMIT = 4 << 30  # bytes of geometry that stay on the device after their frame


@dataclass(frozen=True)
class Request:
    """What one picture needs."""

    camera: Camera
    settings: Settings
    passes: frozenset[str]  # keys of outputs.PASSES; combined is always there
    samples: int
    crypto_levels: int = 6
    interactive: bool = False  # drawn again and again, and at once: see prepare


@dataclass(frozen=True)
class Result:
    """Pictures (H, W, C) float32 by pass, bottom row first, and the report."""

    pixels: dict[str, np.ndarray]
    report: dict[str, Any]
    cancelled: bool = False


@dataclass
class Clock:
    """Time by pass; each reading waits for the device."""

    device: Device
    spent: dict[str, float] = field(default_factory=dict)
    _open: list[tuple[str, Any]] = field(default_factory=list)

    def run(self, name: str, work: Callable[[], None]) -> None:
        timer = self.device.start_timer()
        try:
            work()
        finally:  # a shader that fails must not leave the device timing
            self.device.stop_timer(timer)
        self._open.append((name, timer))

    def settle(self) -> None:
        for name, timer in self._open:
            self.spent[name] = self.spent.get(name, 0.0) + timer.milliseconds()
        self._open.clear()


class Renderer:
    """Draws scenes on one device and keeps there what the next frame can use."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self._kept: dict[tuple, Any] = {}

    def render(
        self,
        scene: Scene,
        request: Request,
        *,
        progress: Callable[[float, str], None] = lambda fraction, text: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> Result:
        """All samples of a picture. DeviceError, ShaderError: the device cannot draw it."""
        started = time.perf_counter()
        progress(0.0, "Preparing points")
        frame = self.start(scene, request)
        try:
            while frame.done < request.samples:
                if cancelled():
                    return Result({}, frame.report(time.perf_counter() - started), cancelled=True)
                frame.sample()
                frame.clock.settle()
                progress(frame.done / request.samples, f"Sample {frame.done}/{request.samples}")
            return Result(frame.pixels(), frame.report(time.perf_counter() - started))
        finally:
            frame.release()

    def start(self, scene: Scene, request: Request) -> Frame:
        """A picture that is drawn sample by sample."""
        return Frame(self, scene, request)

    def keep(self, key: tuple, make: Callable[[], Any]) -> Any:
        """What `make` puts on the device, made once for `key`."""
        if key not in self._kept:
            self._kept[key] = make()
        self._kept[key] = self._kept.pop(key)
        return self._kept[key]

    def forget(self, used: set[tuple]) -> None:
        """Free what no frame used lately, oldest first, until the rest fits."""
        for key in list(self._kept):
            if self.device.bytes_allocated() <= DEVICE_LIMIT:
                return
            if key not in used:
                self._kept.pop(key).release()

    def release(self) -> None:
        """Free everything that is kept on the device."""
        for item in self._kept.values():
            item.release()
        self._kept.clear()


class Surfels:
    """A G-buffer of one variant, with the pyramid that closes it."""

    def __init__(self, frame: Frame, variant: Variant) -> None:
        self.frame, self.variant, device = frame, variant, frame.device
        size, plan = frame.request.camera.window[2:], frame.plan
        self.buffer = GBuffer(device, variant, size, depth=plan.polygons)
        self.pyramid = None
        if plan.points:
            self.resolve_program = programs(variant, plan.options).resolve
            self.pyramid = Pyramid(device, variant, self.buffer, levels(frame.prepared.largest, size))

    def draw(self, record: np.ndarray, shared: dict[str, Texture]) -> None:
        """One sample: points resolved, polygons rasterised, holes filled."""
        frame, device, run = self.frame, self.frame.device, self.frame.clock.run

        def resolve_points() -> None:
            device.clear(self.buffer.target)
            if frame.projection is not None:
                ids = frame.projection.ids
                resolve(device, self.resolve_program, ids, frame.draws, record.copy(), shared, self.buffer)

        run("resolve", resolve_points)
        if frame.plan.polygons:
            run("polygons", lambda: self._draw_polygons(record.copy(), shared))
        if self.pyramid is not None:
            pyramid = self.pyramid
            run("pull", lambda: pyramid.pull(record.copy()))
            run("push", lambda: pyramid.push(record.copy()))

    def _draw_polygons(self, record: np.ndarray, shared: dict[str, Texture]) -> None:
        frame = self.frame
        instances = frame.scene.instances
        for instance in frame.prepared.polygons.tolist():
            polygon_pass.draw(
                frame.device,
                self.variant,
                frame.meshes[int(instances.geometry[instance])],
                frame.prepared.view_from_object[instance],
                instance,
                bool(instances.holdout is not None and instances.holdout[instance]),
                record,
                shared,
                self.buffer,
            )

    def release(self) -> None:
        self.buffer.release()
        if self.pyramid is not None:
            self.pyramid.release()


class Frame:
    """One picture in the making. Every call comes from the device's thread."""

    def __init__(self, renderer: Renderer, scene: Scene, request: Request) -> None:
        self.renderer, self.scene, self.request = renderer, scene, request
        self.device = renderer.device
        self.done = 0
        self.clock = Clock(self.device)
        self.prepared = prepare(
            scene, request.camera, request.settings, request.samples, interactive=request.interactive
        )
        self.plan = make_plan(scene, self.prepared, request.passes)
        self._owned: list[Any] = []
        self._used: set[tuple] = set()
        self._identities: list[np.ndarray] = []
        self._data: dict[str, np.ndarray] = {}
        self._trivial = not (self.plan.points or self.plan.polygons) and scene.world.image is None
        if not self._trivial:
            try:
                self._allocate()
                self._upload()
            except Exception:
                self.release()
                raise

    # What is on the device

    def _allocate(self) -> None:
        device, plan, passes = self.device, self.plan, self.request.passes
        size = self.request.camera.window[2:]
        self.projection = self._own(Projection(device, plan.options, size)) if plan.points else None
        self.surfels = self._own(Surfels(self, plan.variant))
        self.sums = [self._own(device.texture(size, "RGBA32F")) for _ in range(1 + len(shade_pass.averaged(passes)))]
        self.sum_target: Target = self._own(device.target(self.sums))
        device.clear(self.sum_target)
        self.data_textures: list[Texture] = []
        if plan.data:
            self.data_textures = [self._own(device.texture(size, "RGBA32F")) for _ in shade_pass.data(passes)]
            self.data_target: Target = self._own(device.target(self.data_textures))
            # Identities cannot be averaged, and motion and positions are asked for once: they have a G-buffer of their
            # own, so that no sample carries what only one of them needs.
            same = plan.data_variant == plan.variant
            self.data_surfels = self.surfels if same else self._own(Surfels(self, plan.data_variant))
        self.shade = shade_pass.shade_program(plan.variant, plan.lighting, passes)
        self.background = shade_pass.background_program(plan.lighting, self.scene.transparent, passes)

    def _upload(self) -> None:
        scene, camera, plan, device = self.scene, self.request.camera, self.plan, self.device
        table = shade_pass.material_rows(scene.materials)
        self.materials = self._own(device.texture((4, len(table)), "RGBA32F", table.reshape(-1)))
        lights = light_texture(scene.lights, scene.world, camera.view_from_world) if plan.lighting else None
        self.lights = None
        if lights is not None:
            size = (lights.shape[1], lights.shape[0])
            self.lights = self._own(device.texture(size, "RGBA32F", lights.reshape(-1)))
        self.environment = None
        if "PS_HAS_ENVIRONMENT" in plan.lighting and scene.world.image is not None:
            self.environment = self._environment(scene.world.image)
        self.draws = self._point_draws() if plan.points else []
        self.meshes = self._polygon_meshes() if plan.polygons else {}
        if "vector" in shade_pass.data(self.request.passes):
            self.previous = self._own(self._motion())
        self.renderer.forget(self._used)

    def _environment(self, image: np.ndarray) -> Texture:
        def make() -> Texture:
            atlas = build_atlas(image)
            rgba = np.concatenate([atlas[..., :3], np.ones((*atlas.shape[:2], 1), np.float32)], axis=2)
            return self.device.texture((atlas.shape[1], atlas.shape[0]), "RGBA32F", rgba.reshape(-1))

        # The array itself is part of the key, so that its identity is not given to another one.
        key = ("environment", Same(image))
        self._used.add(key)
        return self.renderer.keep(key, make)

    def _point_draws(self) -> list[PageDraw]:
        prepared, scene, device, plan = self.prepared, self.scene, self.device, self.plan
        instances = scene.instances
        origin = np.zeros((len(instances), 3))
        for row, points in prepared.point_sets.items():
            origin[instances.geometry == row] = points.cloud.origin
        one = int(prepared.cut.instance[0]) if plan.options.one_instance else None
        self.instance_texture = None
        if one is None:
            rows = instance_rows(prepared.view_from_object, origin, instances.holdout)
            size, data = paged(rows, 4)
            self.instance_texture = self._own(device.texture(size, "RGBA32F", data))
        draws, index = [], 0
        for group in _pages(prepared.point_sets, self.device.limits.texture_size):
            page = self._page(group)
            first = {row: page.first[points.key] for row, points in group.items()}
            rows, shift = blocks(prepared, instances.geometry, first)
            if len(rows) == 0:
                continue
            size, data = paged(rows, 4)
            uniforms: dict[str, Any] = {}
            if one is not None:
                matrix = with_origin(prepared.view_from_object[one : one + 1], origin[one : one + 1])[0]
                uniforms["view_from_object"] = matrix.T.reshape(-1)
            texture = self._own(device.texture(size, "RGBA32F", data))
            draws.append(PageDraw(page, texture, len(rows), shift, index, uniforms))
            index += len(rows) << shift
        return draws

    def _page(self, group: dict[int, PointSet]) -> Page:
        plan, table = self.plan, self.scene.materials
        sets = list({points.key: points for points in group.values()}.values())
        filled = _fill_key(self.scene) if plan.variant.color or plan.variant.emission else b""
        key = ("page", tuple(p.key for p in sets), plan.variant, plan.options.shading_normal, filled)  # fmt: skip
        self._used.add(key)
        return self.renderer.keep(key, lambda: Page(self.device, sets, plan.variant, plan.options, table))

    def _polygon_meshes(self) -> dict[int, polygon_pass.PolygonMesh]:
        scene, plan, meshes = self.scene, self.plan, {}
        for row in np.unique(scene.instances.geometry[self.prepared.polygons]).tolist():
            geometry = scene.geometries[row]
            mesh = geometry.mesh
            assert mesh is not None
            ok, _ = STORE.lookup(("valid", geometry.key), lambda mesh=mesh: sampling.validate(mesh))
            look = (digest(mesh, scene.materials), plan.variant, _fill_key(scene))
            key = ("polygons", geometry.key, *look, scene.materials.cull.tobytes())
            self._used.add(key)
            meshes[row] = self.renderer.keep(
                key,
                lambda mesh=mesh, ok=ok: polygon_pass.PolygonMesh(self.device, mesh, ok, scene.materials, plan.variant),
            )
        return meshes

    def _motion(self) -> Texture:
        """Clip space a frame before from today's view space, four rows for each instance."""
        camera, instances = self.request.camera, self.scene.instances
        view = camera.view_from_world if camera.previous_view_from_world is None else camera.previous_view_from_world
        clip = camera.clip_from_view if camera.previous_clip_from_view is None else camera.previous_clip_from_view
        before = instances.world_from_object if instances.previous is None else instances.previous
        with np.errstate(all="ignore"):
            still = clip @ view @ np.linalg.inv(camera.view_from_world)
            rows = np.broadcast_to(still, (len(instances), 4, 4)).copy()
            good = np.abs(np.linalg.det(self.prepared.view_from_object[:, :3, :3])) > 1e-30
            good &= np.isfinite(self.prepared.view_from_object).all(axis=(1, 2))
            rows[good] = clip @ view @ before[good] @ np.linalg.inv(self.prepared.view_from_object[good])
        size, data = paged(np.nan_to_num(rows).reshape(-1, 4), 4)
        return self.device.texture(size, "RGBA32F", data)

    # Drawing

    def sample(self) -> bool:
        """Draw one more sample; False when there were enough."""
        if self.done >= self.request.samples:
            return False
        if not self._trivial:
            record = self._record(self.done)
            shared = {"ps_materials": self.materials}
            if self.plan.points and self.instance_texture is not None:
                shared["ps_instances"] = self.instance_texture
            if self.projection is not None:
                projection = self.projection
                self.clock.run("project", lambda: projection.run(self.draws, record.copy(), shared))
            self.surfels.draw(record, shared)
            first = self.done == 0
            if self.plan.data and (first or self._wants_identities):
                if self.data_surfels is not self.surfels:
                    self.data_surfels.draw(record, shared)
                self.clock.run("data", lambda: self._draw_data(record))
                self._read_data(first)
            self.clock.run("shade", lambda: self._shade(record))
            if self.plan.background:
                self.clock.run("background", lambda: self._draw_background(record))
        self.done += 1
        return self.done < self.request.samples

    @property
    def color(self) -> Texture:
        """Sum of the samples so far, premultiplied, scene-linear; `present` averages."""
        return self.sums[0]

    def _record(self, index: int) -> np.ndarray:
        camera, mist = self.request.camera, self.scene.mist
        x, y = offsets(self.request.samples)[index] if self.request.samples > 1 else (0.0, 0.0)
        record = frame_record(camera, (float(x), float(y)))
        record["mist"][0] = mist.start, 1 / max(mist.depth, 1e-6), shade_pass.MIST_EXPONENT[mist.falloff], 0.0
        record["page"][0, 3] = len(self.scene.lights)
        return record

    def _shade(self, record: np.ndarray) -> None:
        textures = self.surfels.buffer.bound()
        textures |= shade_pass.textures(materials=self.materials, lights=self.lights, environment=self.environment)
        self.device.draw(self.shade, self.sum_target, uniforms=record, textures=textures, blend=True)

    def _draw_background(self, record: np.ndarray) -> None:
        textures = {"ps_place": self.surfels.buffer.textures["place"]}
        textures |= shade_pass.textures(lights=self.lights, environment=self.environment)
        self.device.draw(self.background, self.sum_target, uniforms=record, textures=textures, blend=True)

    def _draw_data(self, record: np.ndarray) -> None:
        camera = self.request.camera
        record = record.copy()
        x0, y0, _, _ = camera.window
        record["previous"][0] = *camera.resolution, x0, y0
        textures = self.data_surfels.buffer.bound()
        if "vector" in shade_pass.data(self.request.passes):
            textures["ps_previous"] = self.previous
        program = shade_pass.data_program(self.plan.data_variant, self.request.passes)
        self.device.draw(program, self.data_target, uniforms=record, textures=textures)

    @property
    def _wants_identities(self) -> bool:
        return bool(self.request.passes & set(CRYPTO))

    def _read_data(self, first: bool) -> None:
        for name, texture in zip(shade_pass.data(self.request.passes), self.data_textures, strict=True):
            if first or name == "index":
                array = self.device.read(texture)
                if first:
                    self._data[name] = array
                if name == "index" and self._wants_identities:
                    self._identities.append(array[..., :2].astype(np.int32))

    def present(self) -> None:
        """Draw the average so far and its depth into the framebuffer that is bound, in the viewport that is set."""
        if self._trivial:
            self._present_constant()
            return
        m = self.request.camera.clip_from_view
        record = self._record(0)
        record["mist"][0, 3] = 1 / max(self.done, 1)
        record["previous"][0] = m[2, 2], m[2, 3], m[3, 2], m[3, 3]
        textures = {"ps_combined": self.sums[0], "ps_place": self.surfels.buffer.textures["place"]}
        self.device.draw(shade_pass.PRESENT, None, uniforms=record, textures=textures)

    def _present_constant(self) -> None:
        """A world of one colour needs no picture: one texel does."""
        color = self._constant()
        texel = self.device.texture((1, 1), "RGBA32F", color.astype(np.float32))
        nothing = self.device.texture((1, 1), "RGBA32F", np.zeros(4, np.float32))
        record = self._record(0)
        record["mist"][0, 3] = 1.0
        record["size"][0, :2] = 1, 1
        self.device.draw(
            shade_pass.PRESENT, None, uniforms=record, textures={"ps_combined": texel, "ps_place": nothing}
        )
        texel.release()
        nothing.release()

    # Results

    def _constant(self) -> np.ndarray:
        return np.zeros(4) if self.scene.transparent else np.append(np.asarray(self.scene.world.color), 1.0)

    def pixels(self) -> dict[str, np.ndarray]:
        """Every requested pass."""
        _, _, width, height = self.request.camera.window
        wanted = self.request.passes | {"combined"}
        if self._trivial:
            return self._empty_pixels(wanted, width, height)
        out: dict[str, np.ndarray] = {}
        names = ("combined", *shade_pass.averaged(self.request.passes))
        for name, texture in zip(names, self.sums, strict=True):
            mean = self.device.read(texture) / max(self.done, 1)
            out[name] = np.ascontiguousarray(mean[..., : BY_KEY[name].channels])
        data = self._data
        if "position" in data:
            out["depth"], out["position"] = data["position"][..., 3:], data["position"][..., :3]
        if "vector" in data:
            out["vector"] = data["vector"]
        if "index" in data:
            instance, material = (data["index"][..., i].astype(np.int64) for i in range(2))
            out["object_index"] = _looked_up(self.scene.instances.pass_index, instance)
            out["material_index"] = _looked_up(self.scene.materials.pass_index, material)
        if self._identities:
            for key, column, table in (
                ("crypto_object", 0, self.scene.instances.object_hash),
                ("crypto_material", 1, self.scene.materials.hash),
            ):
                if key in wanted:
                    out |= self._cryptomatte(key, column, table)
        found = {key: array for key, array in out.items() if key in wanted or key.startswith(CRYPTO)}
        missing = frozenset(key for key in wanted if not {key, f"{key}00"} & found.keys())
        return found | self._empty_pixels(missing, width, height)

    def _cryptomatte(self, key: str, column: int, table: np.ndarray | None) -> dict[str, np.ndarray]:
        known = np.zeros(len(self.scene.instances), np.uint32) if table is None else table.astype(np.uint32)
        padded = np.append(known, np.uint32(0))  # -1 looks up the last: no identity
        hashes = padded[np.stack([ids[..., column] for ids in self._identities])]
        pictures = cryptomatte(hashes, self.request.crypto_levels)
        return {f"{key}{i:02d}": picture for i, picture in enumerate(pictures)}

    def _empty_pixels(self, wanted: frozenset[str], width: int, height: int) -> dict[str, np.ndarray]:
        out = {}
        for key in wanted:
            channels = BY_KEY[key].channels
            if key in CRYPTO:
                for i in range((self.request.crypto_levels + 1) // 2):
                    out[f"{key}{i:02d}"] = np.zeros((height, width, 4), np.float32)
                continue
            out[key] = np.zeros((height, width, channels), np.float32)
            if key == "combined":
                out[key][:] = self._constant()
            elif key == "depth":
                out[key][:] = BACKGROUND_DEPTH
            elif key == "mist":
                out[key][:] = 1.0
        return out

    def report(self, seconds: float) -> dict[str, Any]:
        """What was done, as scripts/render.py writes it."""
        self.clock.settle()
        cut, prepared = self.prepared.cut, self.prepared
        geometries, polygons = self.scene.geometries, self.prepared.polygons
        rows = self.scene.instances.geometry[polygons] if len(polygons) else []
        triangles = sum(len(g.mesh.triangles) for g in (geometries[int(r)] for r in rows) if g.mesh is not None)
        return {
            "device": f"{self.device.name}: {self.device.limits.renderer}",
            "seconds": seconds,
            "passes": [{"name": name, "ms": round(ms, 3)} for name, ms in self.clock.spent.items()],
            "skipped": [{"name": name, "because": why} for name, why in self.plan.skipped],
            "points": {"total": prepared.total, "cut": cut.splats, "drawn": cut.splats * self.done},
            "triangles": triangles,
            "bytes": {"cpu": STORE.nbytes, "gpu": self.device.bytes_allocated()},
            "warnings": list(prepared.warnings),
        }

    def release(self) -> None:
        """Free what only this picture needed."""
        for item in self._owned:
            item.release()
        self._owned.clear()

    def _own(self, item: Any) -> Any:
        self._owned.append(item)
        return item


@dataclass(frozen=True)
class Same:
    """An array as a key: equal to itself only."""

    array: np.ndarray = field(compare=False)

    def __hash__(self) -> int:
        return id(self.array)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Same) and other.array is self.array


def _looked_up(table: np.ndarray | None, index: np.ndarray) -> np.ndarray:
    """(H, W, 1) float32: table[index], 0 where the index is negative or there is no table."""
    if table is None or len(table) == 0:
        return np.zeros((*index.shape, 1), np.float32)
    return np.where(index >= 0, table[np.maximum(index, 0)], 0).astype(np.float32)[..., None]


def _fill_key(scene: Scene) -> bytes:
    """The constants that fill attributes which a cloud lacks."""
    table = scene.materials
    return b"".join(a.tobytes() for a in (table.base_color, table.roughness, table.metallic, table.emission))


def _pages(point_sets: dict[int, PointSet], texture_size: int) -> list[dict[int, PointSet]]:
    """Point sets by geometry row, grouped: large ones alone, small ones together as long as a page holds them."""
    limit = 4096 * texture_size
    pages: list[dict[int, PointSet]] = []
    small: dict[int, PointSet] = {}
    for row, points in point_sets.items():
        if len(points) >= OWN_PAGE:
            pages.append({row: points})
            continue
        if sum(len(p) for p in small.values()) + len(points) > limit:
            pages.append(small)
            small = {}
        small[row] = points
    return [*pages, small] if small else pages


__all__ = ["Frame", "Plan", "Prepared", "Renderer", "Request", "Result"]
