"""Coordinate systems of files, by what x, y and z point to: letters of Right, Left, Up, Down, Front, Back."""

from __future__ import annotations

import numpy as np

# Blender's own, in these words: a camera that looks along y with z upwards.
DIRECTIONS = {"R": (1, 0, 0), "L": (-1, 0, 0), "F": (0, 1, 0), "B": (0, -1, 0), "U": (0, 0, 1), "D": (0, 0, -1)}
Y_DOWN, Y_UP, Z_UP = "RDF", "RUB", "RFU"  # of COLMAP and training, of OpenGL, of Blender


def blender_from(system: str) -> np.ndarray:
    """Returns the orthogonal matrix (3, 3) that takes a file's axes to Blender's; systems of left hands mirror."""
    return np.array([DIRECTIONS[letter] for letter in system], np.float64).T
