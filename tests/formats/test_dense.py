"""Arrays of voxels from files."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from pointsplat_addon.formats.volumes import dense
from tests.support.files import nifti


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("name", ["a.nii", "a.nii.gz"])
def test_voxels_of_a_nifti_file_are_where_it_says(tmp_path, order, name):
    array = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    rows = [[-2, 0, 0, 10], [0, 0, 3, 20], [0, 1, 0, 30]]
    data = nifti(array, order, sform=rows, slope=2.0, inter=-5.0)
    (tmp_path / name).write_bytes(gzip.compress(data) if name.endswith("gz") else data)
    found = dense.read(tmp_path / name)
    assert found.value.dtype == np.float32
    np.testing.assert_array_equal(found.value, array * 2 - 5)
    np.testing.assert_allclose(found.object_from_index[:3], np.array(rows) * 1e-3)


def test_the_affine_of_a_quaternion(tmp_path):
    half = np.sqrt(0.5)
    data = nifti(
        np.ones((2, 2, 2), np.float32), code=16, qform=(0, 0, half, 7, 8, 9), pixdim=(1, 2, 3), units=1, qfac=-1
    )
    (tmp_path / "a.nii").write_bytes(data)
    # A quarter turn about z takes x to y and y to -x; qfac flips z.
    expected = [[0, -2, 0, 7], [1, 0, 0, 8], [0, 0, -3, 9], [0, 0, 0, 1]]
    np.testing.assert_allclose(dense.read(tmp_path / "a.nii").object_from_index, expected, atol=1e-6)


def test_the_first_of_several_volumes_is_read(tmp_path):
    array = np.arange(48, dtype=np.int16).reshape(2, 3, 4, 2)
    (tmp_path / "a.nii").write_bytes(nifti(array))
    np.testing.assert_array_equal(dense.read(tmp_path / "a.nii").value, array[..., 0])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.nii", b"short", "too short"),
        ("a.nii", nifti(np.ones((4, 4, 4), np.int16))[:400], "ends before"),
        ("a.nii", nifti(np.ones((4, 4, 4), np.int16), code=128), "real numbers"),
        ("a.nii", bytes(400), "no NIfTI-1"),
        ("a.txt", b"", "none of"),
    ],
)
def test_what_is_no_volume_is_told(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        dense.read(tmp_path / name)


def test_a_damaged_archive_is_told(tmp_path):
    data = gzip.compress(nifti(np.arange(4096, dtype=np.int16).reshape(16, 16, 16)))
    (tmp_path / "a.nii.gz").write_bytes(data[:-200])
    with pytest.raises(OSError, match="damaged"):
        dense.read(tmp_path / "a.nii.gz")


@pytest.mark.parametrize("array", [np.ones((2, 2)), np.ones((2, 2, 2), complex), np.ones((0, 2, 2))])
def test_arrays_that_are_no_volumes_are_told(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(ValueError, match=r"a\.npy"):
        dense.read(tmp_path / "a.npy")


def test_the_background_is_left_out():
    value = np.array([[[-3.0, 0, 1, np.nan, np.inf, 5]]], np.float32)
    kept, low, high = dense.without_background(value, 0.5)
    assert (low, high) == (-3, 5)
    np.testing.assert_array_equal(kept, [[[-3, -3, -3, -3, -3, 5]]])
    with pytest.raises(ValueError, match="same value"):
        dense.without_background(np.ones((2, 2, 2), np.float32), 0)


def test_a_centred_lattice_keeps_its_shape():
    matrix = np.diag([-2.0, 1, 1, 1])
    found = dense.centred(dense.Dense(np.zeros((5, 4, 3), np.float32), matrix), 20.0)
    np.testing.assert_allclose(found @ [2, 1.5, 1, 1], [0, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(np.diag(found)[:3], [-4, 2, 2])
