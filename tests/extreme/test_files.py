"""Files from anywhere: truncated, with flipped bits, and with headers that claim what is not there.

A reader gives what the file holds or an error that it is said to raise; it takes no longer, and no more memory, than
the bytes that are there account for. `tests/formats/test_hierarchy_cache.py` and `tests/formats/test_dense.py` have the
named cases.
"""

from __future__ import annotations

import gzip
import json
import struct
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pointsplat_addon.core.lod import hierarchy
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.formats import hierarchy_cache
from pointsplat_addon.formats.volumes import dense
from scripts.scenes.clouds import sphere_cloud
from tests.support.files import nifti

SMALL = 1 << 24  # bytes that Python, NumPy and zlib take for themselves
ARRAY = np.arange(60, dtype=np.int16).reshape(3, 4, 5)
SHAPES = [(1 << 40,) * 3, (1 << 31, 1, 1), (1 << 20, 1 << 20, 4), (30000, 30000, 30000), (0, 1, 1), (-3, 4, 5), (1,)]


def npy(shape: object, dtype: object = "<f4", data: bytes = b"", extra: str = "") -> bytes:
    """NumPy's format, version 1, with any header."""
    head = f"{{'descr': {dtype!r}, 'fortran_order': False, 'shape': {shape!r}, {extra}}}".encode()
    head += b" " * (-(len(head) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head + data


def plain_npy() -> bytes:
    return npy(ARRAY.shape, "<i2", ARRAY.tobytes())


def gzipped() -> bytes:
    return gzip.compress(nifti(ARRAY))


FILES: dict[str, Callable[[], bytes]] = {".npy": plain_npy, ".nii": lambda: nifti(ARRAY), ".nii.gz": gzipped}


def read_within(path: Path, content: bytes, most: int | None = None) -> dense.Dense | None:
    """What `dense.read` makes of a file, None where it refuses it as it should, in as much memory as the file is long,
    times what its compression can hold."""
    path.write_bytes(content)
    tracemalloc.start()
    try:
        found = dense.read(path)
        assert found.value.dtype == np.float32
        assert np.isfinite(found.object_from_index).all()
        return found
    except (OSError, ValueError) as error:
        assert str(error)  # noqa: PT017 - its absence is no fault
        return None
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak <= (most or 16 * len(content) + SMALL), f"{peak} bytes for a file of {len(content)}"


@pytest.mark.parametrize("suffix", FILES)
def test_every_truncation_is_refused_or_read(tmp_path, suffix):
    """An archive's checksum comes last."""
    whole = FILES[suffix]()
    for size in range(len(whole)):
        assert read_within(tmp_path / f"cut{suffix}", whole[:size]) is None, size


@settings(max_examples=100)
@given(data=st.data())
@pytest.mark.parametrize("suffix", FILES)
def test_flipped_bits_do_no_harm(tmp_path_factory, suffix, data):
    content = bytearray(FILES[suffix]())
    for _ in range(data.draw(st.integers(1, 12))):
        at = data.draw(st.integers(0, min(len(content) - 1, 400)))
        content[at] ^= 1 << data.draw(st.integers(0, 7))
    read_within(tmp_path_factory.getbasetemp() / f"flipped{suffix}", bytes(content))


@settings(max_examples=100)
@given(content=st.binary(max_size=600))
@pytest.mark.parametrize("suffix", FILES)
def test_any_bytes_do_no_harm(tmp_path_factory, suffix, content):
    folder = tmp_path_factory.getbasetemp()
    read_within(folder / f"any{suffix}", content)
    head = {".npy": b"\x93NUMPY\x01\x00", ".nii": b"\x5c\x01\0\0", ".nii.gz": b"\x1f\x8b\x08\0"}[suffix]
    read_within(folder / f"any{suffix}", head + content)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dtype", ["<f4", "<f8", "|u1", "|O", "<U9999999", [("a", "<f4")], "|V0", "V9999999999"])
def test_a_header_that_claims_what_is_not_there(tmp_path, shape, dtype):
    """A few bytes that claim 2^120 voxels are refused before memory is taken."""
    assert read_within(tmp_path / "claims.npy", npy(shape, dtype, b"\0" * 64)) is None


@pytest.mark.parametrize("head", [b"(" * 9000, b"[" * 9000, b"-" * 9000, b"1" * 9000, b"\0" * 100, b"", b"{'descr': "])
@pytest.mark.parametrize("version", [1, 2, 3, 9])
def test_a_header_that_is_no_header(tmp_path, head, version):
    length = struct.pack("<H" if version == 1 else "<I", len(head))
    assert read_within(tmp_path / "odd.npy", b"\x93NUMPY" + bytes([version, 0]) + length + head) is None
    longest = struct.pack("<H" if version == 1 else "<I", 0xFFFF if version == 1 else 0xFFFFFFFF)
    assert read_within(tmp_path / "odd.npy", b"\x93NUMPY" + bytes([version, 0]) + longest + head) is None


@pytest.mark.parametrize("shape", [(32767, 32767, 32767), (32767, 1, 1), (1, 1, 32767)])
@pytest.mark.parametrize("suffix", [".nii", ".nii.gz"])
def test_a_nifti_header_that_claims_what_is_not_there(tmp_path, shape, suffix):
    content = bytearray(nifti(ARRAY))
    struct.pack_into("<8h", content, 40, 3, *shape, 1, 1, 1, 1)
    data = bytes(content)
    assert read_within(tmp_path / f"claims{suffix}", gzip.compress(data) if suffix.endswith("gz") else data) is None


@pytest.mark.parametrize("offset", [np.nan, np.inf, -np.inf, -1.0, 0.0, 1e30, 348.5])
def test_an_offset_that_is_no_place_in_the_file(tmp_path, offset):
    content = bytearray(nifti(ARRAY))
    struct.pack_into("<f", content, 108, offset)
    found = read_within(tmp_path / "offset.nii", bytes(content))
    assert found is None or offset == 348.5


@pytest.mark.parametrize("field", [76, 80, 84, 88, 112, 116, 256, 260, 264, 268, 280, 292, 308])
@pytest.mark.parametrize("odd", [np.nan, np.inf, -3e38, 1e-42])
@pytest.mark.parametrize("form", [{"qform": (0, 0, 0.6, 1, 2, 3)}, {"sform": np.eye(4)[:3]}])
def test_odd_numbers_in_a_header_leave_a_usable_lattice(tmp_path, field, odd, form):
    content = bytearray(nifti(ARRAY, **form))
    struct.pack_into("<f", content, field, odd)
    found = read_within(tmp_path / "odd.nii", bytes(content))
    if found is not None:
        assert np.isfinite(dense.centred(found, 10.0)).all()


def test_an_archive_of_nothing_but_zeros_takes_no_more_than_its_header_claims(tmp_path):
    """Deflate holds a thousandfold: a megabyte that unpacks to a gigabyte, of which the header claims 60 voxels."""
    bomb = gzip.compress(nifti(ARRAY) + bytes(1 << 28), 1)
    found = read_within(tmp_path / "bomb.nii.gz", bomb, 4 * len(bomb) + SMALL)
    assert found is not None
    np.testing.assert_array_equal(found.value, ARRAY)


# Cached hierarchies


def forged(header: bytes, records: bytes) -> bytes:
    """A file whose checksum is right."""
    digest = hierarchy_cache._digest([header, records])
    return (
        hierarchy_cache.FIXED.pack(hierarchy_cache.MAGIC, hierarchy_cache.VERSION, len(header), digest)
        + header
        + records
    )


@pytest.fixture(scope="module")
def cached(tmp_path_factory) -> tuple[Path, dict, bytes]:
    """A file, its header and its records."""
    folder = tmp_path_factory.mktemp("cache")
    path = hierarchy_cache.write(folder, "k", hierarchy.build(sphere_cloud(60)))
    content = path.read_bytes()
    length = hierarchy_cache.FIXED.unpack_from(content)[2]
    start = hierarchy_cache.FIXED.size
    return path, json.loads(content[start : start + length]), content[start + length :]


def read_cached(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    tracemalloc.start()
    try:
        found = hierarchy_cache.read(path.parent, "k")
        assert found is not None
        for array in found.cloud.arrays().values():
            assert np.isfinite(array).all()
    except hierarchy_cache.CacheError as error:
        assert str(path) in str(error)  # noqa: PT017 - its absence is no fault
    finally:
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak <= 64 * len(content) + SMALL, f"{peak} bytes for a file of {len(content)}"


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9) | st.just(10**400),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
    max_leaves=8,
)


@settings(max_examples=200)
@given(data=st.data())
def test_forged_headers_do_no_harm(cached, data):
    path, header, records = cached
    changed = dict(header)
    for name in data.draw(st.lists(st.sampled_from(sorted(header)), min_size=1, max_size=3)):
        changed[name] = data.draw(JSON)
    read_cached(path, forged(json.dumps(changed).encode(), records))


@settings(max_examples=200)
@given(data=st.data())
def test_forged_records_do_no_harm(cached, data):
    path, header, records = cached
    changed = bytearray(records)
    for _ in range(data.draw(st.integers(1, 20))):
        changed[data.draw(st.integers(0, len(changed) - 1))] = data.draw(st.integers(0, 255))
    read_cached(path, forged(json.dumps(header).encode(), bytes(changed)))


@pytest.mark.parametrize(
    "header", [b"[" * 60000, b'{"a":' * 10000, b"1" * 60000, b"[]", b"null", b"\xff\xfe", b"", b'"points"']
)
def test_headers_that_are_no_header(cached, header):
    path, _, records = cached
    read_cached(path, forged(header, records))


@pytest.mark.long
@settings(settings.get_profile("long"), max_examples=5000)
@given(data=st.data())
@pytest.mark.parametrize("suffix", FILES)
def test_long_fuzzing(tmp_path_factory, suffix, data):
    """Bits, bytes and lengths."""
    content = bytearray(FILES[suffix]())
    for _ in range(data.draw(st.integers(1, 6))):
        at = data.draw(st.integers(0, max(len(content) - 1, 0)))
        what = data.draw(st.sampled_from(["bit", "bytes", "cut", "insert"]))
        if what == "bit" and content:
            content[at] ^= 1 << data.draw(st.integers(0, 7))
        elif what == "bytes":
            content[at : at + 4] = data.draw(
                st.sampled_from([b"\xff" * 4, b"\0" * 4, b"\x7f\xff\xff\xff", b"\0\0\x80\x7f"])
            )
        elif what == "cut":
            del content[at : at + data.draw(st.integers(1, 64))]
        else:
            content[at:at] = data.draw(st.binary(max_size=64))
    read_within(tmp_path_factory.getbasetemp() / f"long{suffix}", bytes(content))


def test_a_cloud_of_any_origin_comes_back(tmp_path, within):
    for place in (0.0, 1e8, -1e8, 1e300):
        cloud = PointCloud(sphere_cloud(60).position * np.float32(1e-3), origin=np.full(3, place))
        hierarchy_cache.write(tmp_path, f"{place}", hierarchy.build(cloud))
        found = hierarchy_cache.read(tmp_path, f"{place}")
        assert found is not None
        assert (found.cloud.origin == place).all()
        rows = np.lexsort(found.cloud.position.T), np.lexsort(cloud.position.T)
        apart = np.abs(found.cloud.position[rows[0]] - cloud.position[rows[1]]).max()
        within("a cached cloud of 1e-3 units at 1e8 and 1e300", "largest difference in units", apart, 0.0)
