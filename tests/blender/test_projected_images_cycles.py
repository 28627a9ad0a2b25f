"""Images that are laid around spheres and tubes, or seen from six sides, beside Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support.blender.scenes import draw_beside_cycles, new_material, node, picture

SIZE = 96, 96
MOST = {"BOX": 0.018, "SPHERE": 0.0085, "TUBE": 0.0135}  # measured 0.0156, 0.0075, 0.0117, at borders between fields


def checks():
    """Each of 8 x 8 fields has a colour of its own."""
    image = bpy.data.images.new("checks", 64, 64)
    texels = np.ones((8, 8, 4))
    texels[..., :3] = np.random.default_rng(4).uniform(0.2, 1, (8, 8, 3))
    image.pixels.foreach_set(np.kron(texels, np.ones((8, 8, 1))).astype(np.float32).ravel())
    image.update()
    return image


@pytest.mark.parametrize("coordinates", ["Object", "Generated"])
@pytest.mark.parametrize(
    ("projection", "blend"), [("BOX", 0.0), ("BOX", 0.3), ("BOX", 1.0), ("SPHERE", 0.0), ("TUBE", 0.0)]
)
def test_projections_are_cycles(empty_file, tmp_path, projection, blend, coordinates):
    """All of a ball of as many pixels as there are texels."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32)
    bpy.context.object.data.shade_smooth()
    made = new_material()
    place = node(made.node_tree, "ShaderNodeTexCoord").outputs[coordinates]
    image = {"image": checks(), "projection": projection, "projection_blend": blend}
    texture = node(made.node_tree, "ShaderNodeTexImage", {"Vector": place}, **image)
    shown = node(made.node_tree, "ShaderNodeEmission", {"Color": texture.outputs[0]})
    node(made.node_tree, "ShaderNodeOutputMaterial", {"Surface": shown.outputs[0]})
    bpy.context.object.data.materials.append(made)
    scene = bpy.context.scene
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2.1
    scene.camera = bpy.data.objects.new("camera", camera)
    scene.camera.location, scene.camera.rotation_euler = (2, -2.5, 2), (1.008, 0, 0.675)
    scene.collection.objects.link(scene.camera)
    scene.render.film_transparent = True
    draw_beside_cycles(scene, SIZE, 256)
    found = []
    for engine in ("CYCLES", "POINTSPLAT"):
        scene.render.engine = engine
        found.append(picture(scene, tmp_path)[..., :3].astype(float))
    assert np.sqrt(((found[0] - found[1]) ** 2).mean()) < MOST[projection]
