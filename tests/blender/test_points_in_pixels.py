"""Points whose radius counts in pixels: as many pixels near and far, in final pictures of both kinds of cameras."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
import bpy
import numpy as np
import pytest

from tests.support.blender.scenes import alpha, pointcloud

pytestmark = pytest.mark.usefixtures("empty_file")

PIXELS = 6.0


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
@pytest.mark.parametrize("technique", ["AUTO", "IMAGE_SPACE"])
def test_balls_near_and_far_cover_as_many_pixels(kind, technique, tmp_path):
    # In halves of the picture: at 5, and at 50 units of depth, in an object that is scaled.
    near, far = ((-0.5, 5.0), (5.0, 50.0)) if kind == "PERSP" else ((-1.0, 5.0), (1.0, 50.0))
    ob = pointcloud("Scan", [(near[0] / 2, 0, -near[1] / 2), (far[0] / 2, 0, -far[1] / 2)])
    ob.scale = 2, 2, 2
    ob.pointsplat.radius, ob.pointsplat.radius_unit = PIXELS, "PIXELS"
    scene = bpy.context.scene
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.type, camera.data.ortho_scale = kind, 4.0
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.pointsplat.technique = technique
    scene.render.film_transparent = True
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    scene.render.image_settings.file_format = "OPEN_EXR"
    found = alpha(scene, tmp_path, "POINTSPLAT")
    areas = found[:, :32].sum(), found[:, 32:].sum()
    # Off the axis a ball's picture is an ellipse: by the third power of the cosine of a tenth of a radian, the tangent.
    expected = np.pi * PIXELS**2 * (1.01**1.5 if kind == "PERSP" else 1.0)
    np.testing.assert_allclose(areas, expected, rtol=0.01)  # measured 0.6 % in image space, 0.4 % by the buffer
