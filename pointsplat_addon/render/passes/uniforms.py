"""Uniforms of one sample that several passes read, and the blocks that passes declare of them and of fields of their
own.

Each pass declares its own block, named `u` in its shaders, with the fields that these read and no others.
"""

from __future__ import annotations

import numpy as np

from ...core.numeric.record import value_record
from ...core.scene.camera import Camera
from ...core.splat.blur import defocus_blur
from ...shading.interface import Block

Fields = tuple[tuple[str, str], ...]  # (GLSL type, name)
Values = dict[str, object]

# What lib/geometry/camera.glsl reads.
CAMERA_FIELDS: Fields = (
    ("vec2", "focal"),  # pixels: fx, fy of core.scene.Camera.pixel_from_view
    ("vec2", "principal_point"),  # pixels: cx, cy, moved by the sample's offset
    ("ivec2", "size"),  # of the picture in pixels
    ("float", "near"),
    ("float", "far"),
    ("int", "perspective"),  # 0 or 1
)
# What lib/splat/defocus.glsl reads beside the camera.
LENS_FIELDS: Fields = (
    ("float", "confusion_scale"),  # pixels: radius of the circle of confusion at infinity
    ("float", "inverse_focus_distance"),
    ("float", "aperture_aspect"),  # width of the aperture over its height
)
# What common/rectangle.vert reads: low and high corner, from 0 to 1 over the target.
RECTANGLE_FIELDS: Fields = (("vec4", "rectangle"),)
# What lib/geometry/instance.glsl reads where there is only one instance.
ONE_INSTANCE_FIELDS: Fields = (("mat4", "view_from_object"),)
# What readers of pictures with levels have (lib/data/levels.glsl): a footprint's side, in pixels of
# the picture or of the target.
FOOTPRINT_FIELDS: Fields = (("float", "footprint"),)
# What lib/light/backdrop.glsl reads.
BACKDROP_FIELDS: Fields = (("vec2", "backdrop_texels"),)  # texels of the backdrop that a pixel spans


def block(name: str, *groups: Fields) -> Block:
    """The uniform block `u` of a pass: the fields of all groups in order. `name`: of its struct, after the prefix
    Ps."""
    return Block(f"Ps{name}", "u", tuple(field for group in groups for field in group))


@value_record
class SampleView:
    """The camera of one sample, and which sample it is."""

    camera: Camera
    near: float  # of what is drawn: no nearer than the camera's
    far: float
    offset: tuple[float, float] = (0.0, 0.0)  # pixels: rays pass beside the pixels' centres by so much
    sample: int = 0

    @property
    def principal_point(self) -> tuple[float, float]:
        """Of the rays through the pixels' centres moved by `offset`, in pixels."""
        _, _, cx, cy = self.camera.pixel_from_view()
        return cx - self.offset[0], cy - self.offset[1]

    @property
    def footprint(self) -> float:
        """Pixels along a side of what the sample stands for: later ones narrow what earlier ones have covered, so that
        no picture so far aliases, and the mean of all is as sharp as it can be."""
        return (self.sample + 1) ** -0.5

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture in pixels."""
        _, _, width, height = self.camera.window
        return width, height

    @property
    def world_from_view(self) -> np.ndarray:
        """(4, 4) float64."""
        return np.linalg.inv(self.camera.view_from_world)

    @property
    def camera_values(self) -> Values:
        """Values of CAMERA_FIELDS."""
        return {
            "focal": self.camera.pixel_from_view()[:2],
            "principal_point": self.principal_point,
            "size": self.size,
            "near": self.near,
            "far": self.far,
            "perspective": int(self.camera.perspective),
        }

    @property
    def lens_values(self) -> Values:
        """Values of LENS_FIELDS; the camera has an aperture."""
        blur, aperture = defocus_blur(self.camera), self.camera.aperture
        assert blur is not None
        assert aperture is not None
        return {
            "confusion_scale": blur.scale,
            "inverse_focus_distance": 1 / blur.focus,
            "aperture_aspect": 1 / aperture.ratio,
        }

    def values(self, block: Block) -> Values:
        """Values of those fields of a block that depend on the sample's view alone."""
        known: Values = dict(self.camera_values)
        names = {name for _, name in block.fields}
        if "confusion_scale" in names:
            known |= self.lens_values
        if "world_from_view" in names:
            known["world_from_view"] = self.world_from_view
        if "sample_index" in names:
            known["sample_index"] = self.sample
        if "footprint" in names:
            known["footprint"] = self.footprint
        return {name: value for name, value in known.items() if name in names}

    def record(self, block: Block, **own: object) -> np.ndarray:
        """The record of a pass: what depends on the view alone, and its `own` values. ValueError: a field without
        one."""
        values = {**self.values(block), **own}
        if missing := [name for _, name in block.fields if name not in values]:
            raise ValueError(f"{block.type}: no value for {', '.join(missing)}")
        return block.record(**values)

    def record_of(self, block: Block | None, **own: object) -> np.ndarray:
        """As `record`, for a variant of a pass: of its `own` values those that the variant's block has a field for."""
        assert block is not None
        names = {name for _, name in block.fields}
        return self.record(block, **{name: value for name, value in own.items() if name in names})


def view_of(camera: Camera, offset: tuple[float, float] = (0.0, 0.0), sample: int = 0) -> SampleView:
    """The view of a sample whose rays pass `offset` pixels beside the pixels' centres."""
    return SampleView(camera, camera.near, camera.far, offset, sample)
