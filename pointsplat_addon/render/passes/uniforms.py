"""The uniform block and the G-buffer that all passes share."""

from __future__ import annotations

import numpy as np

from ...core.scene.camera import Camera
from ...shading.interface import Block

FRAME = Block(
    "PsFrame",
    "frame",
    (
        ("mat4", "view_from_object"),  # of the polygons, or of the only instance of points
        ("mat4", "world_from_view"),
        ("vec4", "focal"),  # fx, fy, cx, cy: core.scene.Camera.pixel_from_view
        ("vec4", "lens"),  # near, far, 1 for perspective, 1 or -1: sense of front faces
        ("vec4", "mist"),  # start, 1 / range, exponent, 1 / samples so far
        (
            "vec4",
            "previous",
        ),  # Vector: size and corner of the picture. Present: clip z and w from view z. backdrop.glsl
        ("vec4", "focus"),  # depth of field: core/lens/defocus.py, width of the aperture over its height; else zeros
        ("vec4", "tile"),  # side of a tile as a part of the target's sides; threshold: render/passes/tiles.py
        ("ivec4", "size"),  # width, height, level, instance
        ("ivec4", "page"),  # points: first index, blocks, log2 of a block. polygons: corner, material, holdout. lights
    ),
)


def frame_record(camera: Camera, offset: tuple[float, float] = (0.0, 0.0)) -> np.ndarray:
    """The block for one sample whose rays pass `offset` pixels beside the pixels' centres."""
    fx, fy, cx, cy = camera.pixel_from_view()
    _, _, width, height = camera.window
    return FRAME.record(
        world_from_view=np.linalg.inv(camera.view_from_world),
        focal=(fx, fy, cx - offset[0], cy - offset[1]),
        lens=(camera.near, camera.far, float(camera.perspective), 1.0),
        size=(width, height, 0, 0),
    )
