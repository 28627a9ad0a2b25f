"""Blender's gpu, moderngl, and moderngl without image atomics draw every scene alike."""

import pytest

from tests.support.blender.devices import agree, pictures

bpy = pytest.importorskip("bpy")
gpu = pytest.importorskip("gpu")

from scripts.scenes.cases import CASES


@pytest.mark.parametrize("name", CASES)
def test_blenders_gpu_and_moderngl_agree(blender, opengl, name):
    case = CASES[name]()
    agree(opengl(case, True), pictures(blender, case))


@pytest.mark.parametrize("name", CASES)
def test_with_and_without_image_atomics_agree(opengl, name):
    case = CASES[name]()
    agree(opengl(case, True), opengl(case, False))
