"""What EWA leaves out is the same on Blender's gpu and on moderngl."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from tests.support.blender.devices import pictures
from tests.support.hidden_splats import SCENES, case


@pytest.mark.parametrize("name", ["with a hole", "wide, behind wires"])
def test_blenders_gpu_and_moderngl_leave_out_the_same(blender, opengl, name):
    things = SCENES[name][0]
    thing = case(f"left out {name}", *things)
    here, there = opengl(thing, True), pictures(blender, thing)
    assert np.abs(here["combined"] - there["combined"]).max() <= 2 / 255  # measured 0, where both run on one driver
