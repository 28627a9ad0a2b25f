"""What a device offers, found by trying it. Answers are kept: a GPU does not change while the program runs."""

from __future__ import annotations

from ..render.device.protocol import Device
from ..shading.interface import Interface

ATOMICS = Interface("probe of image atomics", compute="device/probe_atomics.comp", images=(("R32UI", "cell"),))
BLEND = Interface("probe of blending", fragment="device/probe_blend.frag", outputs=(("vec4", "color"),))

_answers: dict[tuple[str, str], tuple[bool, bool]] = {}


def capabilities(device: Device, compute: bool) -> tuple[bool, bool]:
    """(image atomics, blending into RGBA32F) of a device; `compute`: it claims to have compute shaders."""
    key = device.name, device.limits.renderer
    if key not in _answers:
        _answers[key] = compute and _image_atomics(device), _float_blend(device)
    return _answers[key]


def _image_atomics(device: Device) -> bool:
    cell = device.texture((1, 1), "R32UI")
    try:
        device.fill(cell)
        device.dispatch(ATOMICS, 2, images={"cell": cell})
        return int(device.read(cell)[0, 0]) == 7
    except RuntimeError:  # a ShaderError, or the driver's own
        return False
    finally:
        cell.release()


def _float_blend(device: Device) -> bool:
    pixel = device.texture((1, 1), "RGBA32F")
    target = device.target([pixel])
    try:
        device.clear(target)
        for _ in range(2):
            device.draw(BLEND, target, blend=True)
        return bool((device.read(pixel) == 200000.5).all())
    finally:
        target.release()
        pixel.release()
