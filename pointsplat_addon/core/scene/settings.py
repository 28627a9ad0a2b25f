"""The settings of a render with their defaults and ranges."""

from __future__ import annotations

from typing import ClassVar

from ..numeric.pixel_filter import FILTER_SIZE
from ..numeric.record import value_record

TECHNIQUES = ("AUTO", "VISIBILITY", "IMAGE_SPACE", "EWA", "PAINTER")
DOF_METHODS = ("SPLAT", "LENS_SAMPLES")
BUDGETS = ("NONE", "TIME", "ERROR")
DEVICES = ("AUTO", "BLENDER_GPU", "OPENGL")
PRIMITIVES = ("AUTO", "POINTS", "POLYGONS", "LINES")
SHAPES = ("BALLS", "DISKS", "SURFACE")
RADIUS_UNITS = ("OBJECT", "SPACING", "PIXELS")
BLENDINGS = ("LINEAR", "TRAINED")  # of captured splats
LIGHTINGS = ("CAPTURED", "SHADOWED", "RELIT")  # of captured splats


@value_record
class Settings:
    """The only defaults and ranges: Blender's properties (scene.pointsplat) are made from this table.

    OF_BLENDER: fields that Blender has properties of its own for, in scene.render. IN_BLENDER: what new scenes of
    Blender's have in place of a default: a record that asks for nothing has direct light alone, a person expects all.
    """

    technique: str = "AUTO"  # one of TECHNIQUES
    tolerance: float = 1.0  # pixels: projected size below which a node is drawn instead of its children
    samples: int = 16  # sub-pixel samples averaged in a final render
    viewport_samples: int = 16  # the same in the viewport, when it is still
    use_adaptive_sampling: bool = True  # parts of the picture whose samples agree get fewer of them
    filter_size: float = FILTER_SIZE  # pixels from the centre of the pixel filter to its end
    adaptive_threshold: float = 1 / 64  # over the root of the brightness: what a display of 8 bits just shows
    captured_blending: str = "LINEAR"  # one of BLENDINGS
    use_shadows: bool = True  # lights cast shadows, through translucent matter too
    shadow_resolution: int = 1024  # cells of a light's shadow table per half turn
    use_indirect: bool = False  # what surfaces hide of the world, and what they send to each other
    bounces: int = 3  # of light from surface to surface, before it reaches what is seen
    use_eye_dome: bool = False  # pixels are darker the more their neighbours lie in front of them
    eye_dome_strength: float = 1.0
    eye_dome_radius: int = 1  # pixels from a pixel to the neighbours that it is compared with
    dof_method: str = "SPLAT"  # one of DOF_METHODS
    budget: str = "NONE"  # one of BUDGETS
    time_budget: float = 100.0  # milliseconds that a picture may take
    error_budget: float = 1 / 128  # root mean square error that a picture may have, scene-linear
    memory_budget: int = 2000  # megabytes of scans that are read by pages, and of what is drawn of them
    device: str = "AUTO"  # one of DEVICES

    OF_BLENDER: ClassVar[frozenset[str]] = frozenset({"filter_size"})
    IN_BLENDER: ClassVar[dict[str, bool]] = {"use_indirect": True}
    RANGES: ClassVar[dict[str, tuple[float, float]]] = {
        "tolerance": (0.05, 64.0),
        "samples": (1, 4096),
        "viewport_samples": (1, 1024),
        "filter_size": (0.01, 10.0),
        "adaptive_threshold": (0.0, 1.0),
        "shadow_resolution": (16, 16384),
        "bounces": (0, 32),
        "eye_dome_strength": (0.0, 10.0),
        "eye_dome_radius": (1, 16),
        "time_budget": (1.0, 3_600_000.0),
        "error_budget": (0.0001, 1.0),
        "memory_budget": (16, 1_000_000),
    }
