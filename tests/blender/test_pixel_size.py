"""The pixel size of viewports, which the scene sets for all engines."""

import bpy
import pytest

from pointsplat_addon.host.convert.camera import pixel_size


@pytest.mark.parametrize("size", ["1", "2", "4", "8"])
def test_it_is_the_scene_s(size):
    render = bpy.context.scene.render
    before, render.preview_pixel_size = render.preview_pixel_size, size
    try:
        assert pixel_size(render) == int(size)
    finally:
        render.preview_pixel_size = before


def test_by_itself_it_follows_the_screen():
    render = bpy.context.scene.render
    before, render.preview_pixel_size = render.preview_pixel_size, "AUTO"
    try:
        assert pixel_size(render) == (2 if bpy.context.preferences.system.pixel_size > 1.5 else 1)
    finally:
        render.preview_pixel_size = before
