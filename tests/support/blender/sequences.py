"""Writes numbered PLY files, and imports them as one object that follows the scene's frame."""

# pyright: reportOptionalMemberAccess=false, reportArgumentType=false
import bpy
import numpy as np

from tests.support.scan_files import write_ply


def frame_file(path, number, offset=0.0, color=True, velocity=False, radius=False, count=None):
    """A file of 10 + number points, whose x is its number."""
    count = 10 + number if count is None else count
    fields = [("x", "f4"), ("y", "f4"), ("z", "f4")]
    fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")] if color else []
    fields += [("vx", "f4"), ("vy", "f4"), ("vz", "f4")] if velocity else []
    fields += [("radius", "f4")] if radius else []
    found = np.zeros(count, fields)
    found["x"], found["y"], found["z"] = number + offset, np.arange(count), 0.5 * np.arange(count)
    if color:
        found["red"] = 200
    if velocity:
        found["vx"], found["vy"], found["vz"] = 1.5, np.arange(count), -2
    if radius:
        found["radius"] = 0.125
    write_ply(path, found, "binary_little_endian")


def frames(folder, numbers=(1, 2, 3, 12), pattern="frame_{:04d}.ply", **settings):
    for number in numbers:
        frame_file(folder / pattern.format(number), number, **settings)
    return folder / pattern.format(numbers[0])


def imported(path):
    assert bpy.ops.pointsplat.import_points(filepath=str(path), sequence=True) == {"FINISHED"}
    return bpy.context.object
