"""What is drawn, as plain frozen dataclasses: no Blender, no GPU.

Transforms are named destination_from_source and are (4, 4) float64 for column vectors. Colours are
scene-linear. Lengths are Blender units in world space unless said otherwise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from .cloud import PointCloud
from .strands import Lines

TECHNIQUES = ("AUTO", "IMAGE_SPACE", "EWA", "PAINTER")
DOF_METHODS = ("SPLAT", "LENS_SAMPLES")
BUDGETS = ("NONE", "TIME", "ERROR")
DEVICES = ("AUTO", "BLENDER_GPU", "OPENGL")
PRIMITIVES = ("AUTO", "POINTS", "POLYGONS", "LINES")


@dataclass(frozen=True)
class Settings:
    """The only defaults and ranges: Blender's properties (scene.pointsplat) are made from this table."""

    technique: str = "AUTO"  # one of TECHNIQUES
    tolerance: float = 1.0  # pixels: projected size below which a node is drawn instead of its children
    samples: int = 16  # sub-pixel samples averaged in a final render
    viewport_samples: int = 16  # the same in the viewport, when it is still
    use_adaptive_sampling: bool = True  # parts of the picture whose samples agree get fewer of them
    adaptive_threshold: float = 1 / 64  # over the root of the brightness: what a display of 8 bits just shows
    use_shadows: bool = True  # lights cast shadows, through translucent matter too
    shadow_resolution: int = 1024  # cells of a light's shadow table per half turn
    dof_method: str = "SPLAT"  # one of DOF_METHODS
    budget: str = "NONE"  # one of BUDGETS
    time_budget: float = 100.0  # milliseconds that a picture may take
    error_budget: float = 1 / 128  # root mean square error that a picture may have, scene-linear
    device: str = "AUTO"  # one of DEVICES

    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "tolerance": (0.05, 64.0),
        "samples": (1, 4096),
        "viewport_samples": (1, 1024),
        "adaptive_threshold": (0.0, 1.0),
        "shadow_resolution": (16, 16384),
        "time_budget": (1.0, 3_600_000.0),
        "error_budget": (0.0001, 1.0),
    }


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one evaluated mesh, in object space. Per-corner attributes are (T, 3, ...)."""

    key: str  # content key: equal keys mean equal arrays
    name: str  # the object's name, for messages
    position: np.ndarray  # (V, 3) float32
    triangles: np.ndarray  # (T, 3) int32, rows of position
    vertex_normal: np.ndarray | None = None  # (V, 3) float32; set when every corner of a vertex shares it
    corner_normal: np.ndarray | None = None  # (T, 3, 3) float32; set otherwise
    uv: dict[str, np.ndarray] = field(default_factory=dict)  # map name to (T, 3, 2) float32
    colors: dict[str, np.ndarray] = field(default_factory=dict)  # attribute name to (T, 3, 4) float32, scene-linear
    active_uv: str | None = None  # the map that a texture node without a UV Map node reads
    material: np.ndarray | None = None  # (T,) uint16, rows of Scene.materials; None: all `materials[0]`
    materials: tuple[int, ...] = (0,)  # the rows in use
    topology: str = ""  # content key of all but positions and normals: equal keys mean that samples can be kept

    @property
    def nbytes(self) -> int:
        arrays = [self.position, self.triangles, self.vertex_normal, self.corner_normal, self.material]
        arrays += [*self.uv.values(), *self.colors.values()]
        return sum(a.nbytes for a in arrays if a is not None)


@dataclass(frozen=True, eq=False)
class Volume:
    """Active voxels of one evaluated volume object, sparse, in index space: an integer index is a voxel's centre."""

    key: str  # content key of the voxels
    name: str  # the object's name, for messages
    index: np.ndarray  # (N, 3) int32
    object_from_index: np.ndarray  # (4, 4) float64
    # Grids by name, (N,) or (N, 3) float32: density, temperature, color, ... Voxels that a grid lacks hold 0.
    grids: dict[str, np.ndarray] = field(default_factory=dict)
    material: int = 0  # row of Scene.materials
    transfer: Transfer | None = None  # instead of what the material says


@dataclass(frozen=True, eq=False)
class Transfer:
    """A transfer function: a colour ramp over the values of one grid."""

    grid: str
    low: float  # the value at the ramp's left end
    high: float  # and at its right end
    ramp: np.ndarray  # (R, 4) float32: scene-linear colour, opacity in [0, 1], evenly spaced over [low, high]
    density: float = 1.0  # extinction per object unit where the ramp's opacity is 1


@dataclass(frozen=True, eq=False)
class Medium:
    """What fills a volume: Blender's Principled Volume, Volume Absorption and Volume Scatter, per object unit.

    Scattering is density times color, absorption is density times (1 - color) times (1 - sqrt(absorption)).
    """

    density: float = 1.0
    density_grid: str = "density"  # empty: the density is the same everywhere
    color: np.ndarray = field(default_factory=lambda: np.full(3, 0.5))  # (3,) float64
    color_grid: str = ""
    absorption: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64
    anisotropy: float = 0.0  # Henyey-Greenstein's g
    emission: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64, radiance per unit of length
    blackbody: float = 0.0  # intensity
    blackbody_tint: np.ndarray = field(default_factory=lambda: np.ones(3))
    temperature: float = 1000.0  # kelvin, times the grid where there is one
    temperature_grid: str = "temperature"


@dataclass(frozen=True, eq=False)
class Geometry:
    """What an instance refers to: a mesh (points or polygons), a cloud or a volume (both points), or strands."""

    key: str  # content key
    name: str
    mesh: Mesh | None = None
    cloud: PointCloud | None = None
    volume: Volume | None = None
    lines: Lines | None = None
    primitive: str = "AUTO"  # one of PRIMITIVES
    spacing: float = 0.0  # distance between samples in object units; 0 chooses
    lattice: str = ""  # clouds of equal keys and attributes have the same points and half-axes; "": no other does
    extinction: float = 0.0  # of this geometry's points, per object unit; 0 takes it from the material


@dataclass(frozen=True, eq=False)
class Instances:
    """One row for each thing that is drawn."""

    geometry: np.ndarray  # (I,) int32, rows of Scene.geometries
    world_from_object: np.ndarray  # (I, 4, 4) float64
    previous: np.ndarray | None = None  # (I, 4, 4) float64: world_from_object a frame before; only for the Vector pass
    pass_index: np.ndarray | None = None  # (I,) int32
    holdout: np.ndarray | None = None  # (I,) bool: cuts a hole into alpha
    casts: np.ndarray | None = None  # (I,) bool: casts shadows; None: all do
    object_hash: np.ndarray | None = None  # (I,) uint32: cryptomatte hash of the object's name
    names: tuple[str, ...] = ()  # object name for each row, for messages

    def __len__(self) -> int:
        return len(self.geometry)


@dataclass(frozen=True, eq=False)
class HairTable:
    """The Principled Hair values of each row of a MaterialTable; rows that are not hair hold Blender's defaults.

    The table's `ior` and `roughness` (the longitudinal one) are hair's too, and its `base_color` is the colour that a
    head of such hair has; `core.pigment` turns that, or a point's own, and the radial roughness into absorption.
    """

    used: np.ndarray  # (M,) bool: this row is hair
    radial: np.ndarray  # (M,) float32, azimuthal roughness in [0, 1]; Huang's model: the longitudinal one
    coat: np.ndarray  # (M,) float32 in [0, 1]: how much smoother the first reflection is
    tilt: np.ndarray  # (M,) float32, radians: of the cuticle's scales, Blender's Offset
    lobes: np.ndarray  # (M, 3) float32: factors of reflection, transmission and second reflection; 1 in Chiang's model


@dataclass(frozen=True, eq=False)
class MaterialTable:
    """Constants for each material (row 0 is the default material). Attributes on points override them."""

    base_color: np.ndarray  # (M, 3) float32
    roughness: np.ndarray  # (M,) float32, Principled roughness (alpha = roughness^2)
    metallic: np.ndarray  # (M,) float32
    ior: np.ndarray  # (M,) float32
    specular: np.ndarray  # (M,) float32, Principled specular IOR level (0.5: F0 from ior; 0: no specular)
    emission: np.ndarray  # (M, 3) float32, emitted radiance
    alpha: np.ndarray  # (M,) float32
    cull: np.ndarray  # (M,) bool: backface culling
    pass_index: np.ndarray  # (M,) int32
    hash: np.ndarray  # (M,) uint32: cryptomatte hash of the name
    names: tuple[str, ...] = ()
    # (M,) float32, Henyey-Greenstein's g of media; None: all 0
    anisotropy: np.ndarray | None = None
    # (M,) bool: light passes through (alpha below 1 somewhere, or transmission), so the material's surfaces are drawn
    # as translucent splats; None: nowhere
    translucent: np.ndarray | None = None
    media: tuple[Medium | None, ...] = ()  # what fills volumes of each material
    graphs: tuple[object | None, ...] = ()  # core.materials.Graph for materials whose inputs vary, else None
    hair: HairTable | None = None  # what strands of the materials are besides; None: none of them is hair

    def __len__(self) -> int:
        return len(self.roughness)


def default_materials() -> MaterialTable:
    """A table with only row 0: Blender's default Principled surface."""
    f = np.float32
    return MaterialTable(
        base_color=np.array([[0.8, 0.8, 0.8]], f),
        roughness=np.array([0.5], f),
        metallic=np.zeros(1, f),
        ior=np.array([1.5], f),
        specular=np.array([0.5], f),
        emission=np.zeros((1, 3), f),
        alpha=np.ones(1, f),
        cull=np.zeros(1, bool),
        pass_index=np.zeros(1, np.int32),
        hash=np.zeros(1, np.uint32),
        names=("Default",),
        graphs=(None,),
    )


@dataclass(frozen=True, eq=False)
class Light:
    """A lamp in world space, in radiometric quantities; host/convert turns Blender's power into them."""

    kind: str  # POINT, SUN, SPOT, AREA
    color: (
        np.ndarray
    )  # (3,) float64. POINT/SPOT: radiant intensity W/sr; SUN: irradiance W/m2; AREA: radiance W/(m2 sr)
    position: np.ndarray  # (3,) float64; ignored by SUN
    direction: np.ndarray  # (3,) float64, unit, where the light shines (its local -Z)
    radius: float = 0.0  # sphere radius (POINT, SPOT); SUN: half angle in radians
    spot_cos: float = -1.0  # SPOT: cosine of half the cone angle
    spot_blend: float = 0.0  # SPOT: Blender's blend in [0, 1]
    # AREA: (3,) half-extent vector of the first and second side. SPOT: rows X and Y of the inverse of its matrix,
    # divided by the length of row Z (unit local axes where the scale is uniform; None: a round cone)
    axis_u: np.ndarray | None = None
    axis_v: np.ndarray | None = None
    ellipse: bool = False  # AREA: disk or ellipse instead of a rectangle
    spread: float = float(np.pi)  # AREA: full angle of the beam in radians
    soft: bool = True  # POINT, SPOT: a disk that faces the receiver instead of a sphere (Blender's soft falloff)
    diffuse: float = 1.0  # factor on diffuse light
    specular: float = 1.0  # factor on specular light
    shadow: bool = True
    name: str = ""


@dataclass(frozen=True, eq=False)
class World:
    """Light from infinitely far: a colour, or an equirectangular picture."""

    color: np.ndarray = field(default_factory=lambda: np.zeros(3))  # (3,) float64 radiance; used when image is None
    image: np.ndarray | None = None  # (H, W, 3) float32 radiance, row 0 at the bottom (-Z), Blender's equirect layout
    world_rotation: np.ndarray = field(default_factory=lambda: np.eye(3))  # (3, 3) image_from_world


@dataclass(frozen=True)
class Aperture:
    """The opening of a thin lens, in the plane through the eye that the camera looks along the normal of."""

    radius: float  # world units, along the picture's y
    focus: float  # world units > 0, along the direction of view: what lies there is sharp
    blades: int = 0  # sides of a regular polygon; below three: a disk
    rotation: float = 0.0  # radians, of the polygon
    ratio: float = 1.0  # height over width


@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole or parallel camera. View space looks along -Z, +Y up. Pixels count from the bottom left."""

    view_from_world: np.ndarray  # (4, 4) float64, rigid
    clip_from_view: np.ndarray  # (4, 4) float64, OpenGL's (z from -1 to 1); no skew; shift included
    resolution: tuple[int, int]  # width, height of the full frame in pixels
    region: tuple[int, int, int, int] | None = None  # x0, y0, width, height of the part to draw; None: all
    near: float = 0.1  # clip start; may be negative in a parallel viewport
    far: float = 1000.0
    previous_view_from_world: np.ndarray | None = None  # a frame before; only for the Vector pass
    previous_clip_from_view: np.ndarray | None = None
    aperture: Aperture | None = None  # None: everything is sharp

    @property
    def perspective(self) -> bool:
        return bool(self.clip_from_view[3, 2] != 0.0)

    @property
    def nearest(self) -> float:
        """The least depth that is seen: in a parallel view it may lie behind the camera."""
        return max(self.near, 1e-9) if self.perspective else self.near

    @property
    def window(self) -> tuple[int, int, int, int]:
        return self.region or (0, 0, *self.resolution)

    def pixel_from_view(self) -> tuple[float, float, float, float]:
        """(fx, fy, cx, cy): pixel = c + f * xy / d, with d = -z for perspective and d = 1 for parallel cameras."""
        m, (w, h), (x0, y0, _, _) = self.clip_from_view, self.resolution, self.window
        shift = -m[:2, 2] if self.perspective else m[:2, 3]
        fx, fy = m[0, 0] * w / 2, m[1, 1] * h / 2
        return fx, fy, (1 + shift[0]) * w / 2 - x0, (1 + shift[1]) * h / 2 - y0


@dataclass(frozen=True, eq=False)
class Mist:
    start: float = 5.0
    depth: float = 25.0
    falloff: str = "QUADRATIC"  # QUADRATIC, LINEAR, INVERSE_QUADRATIC


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything that a frame needs but the camera."""

    geometries: tuple[Geometry, ...]
    instances: Instances
    materials: MaterialTable
    lights: tuple[Light, ...] = ()
    world: World = field(default_factory=World)
    transparent: bool = False  # film: the world is not drawn, only shines
    mist: Mist = field(default_factory=Mist)
    warnings: tuple[str, ...] = ()
