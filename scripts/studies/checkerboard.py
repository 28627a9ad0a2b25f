"""A checkerboard to the horizon: points in image space and by EWA, beside polygons with 64 samples a pixel.

python -m scripts.studies.checkerboard --output checkerboard.png

The upper row has one sample a pixel, the lower one 16. Prints the root mean square error of each against the polygons.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from pointsplat_addon.core.scene.camera import Camera
from pointsplat_addon.core.scene.cloud import PointCloud
from pointsplat_addon.core.scene.materials import MaterialTable, default_materials
from pointsplat_addon.core.scene.mesh import Mesh
from pointsplat_addon.core.scene.scene import Geometry, Instances, Scene
from pointsplat_addon.core.scene.settings import Settings
from pointsplat_addon.core.scene.world import World
from pointsplat_addon.devices.opengl import OpenGLDevice
from pointsplat_addon.render.plan.request import Request
from pointsplat_addon.render.renderer import Renderer
from scripts.common.images import displayed

CELL = 0.25  # side of a square
HALF_WIDTH, NEAR, FAR = 10.0, 0.5, 40.0  # of the board
STEP = CELL / 10  # between points
EYE_HEIGHT, DOWN = 0.5, 0.133  # of the camera; sine of how far it looks down
SIZE = 320, 140
FOCAL = 1.732  # over half the picture's width
TECHNIQUES = ("IMAGE_SPACE", "EWA")


def dark(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(N,) bool: which squares places lie in."""
    return (np.floor(x / CELL) + np.floor(y / CELL)) % 2 == 0


def points() -> Geometry:
    x, y = np.arange(-HALF_WIDTH, HALF_WIDTH, STEP) + STEP / 2, np.arange(NEAR, FAR, STEP) + STEP / 2
    x, y = (a.ravel() for a in np.meshgrid(x, y))
    normal = np.tile(np.array([[0, 0, 1]], np.float32), (len(x), 1))
    cloud = PointCloud(
        np.stack([x, y, np.zeros_like(x)], axis=1).astype(np.float32),
        normal=normal,
        radii=np.full((len(x), 1), STEP * np.sqrt(0.5), np.float32),
        emission=np.repeat(np.where(dark(x, y), 0, 1)[:, None], 3, axis=1).astype(np.float32),
    )
    return Geometry("checkerboard points", "Board", cloud=cloud)


def polygons() -> Geometry:
    """Two triangles a square."""
    x, y = np.arange(-HALF_WIDTH, HALF_WIDTH + 1e-6, CELL), np.arange(NEAR, FAR + 1e-6, CELL)
    columns = len(x)
    across, along = (a.ravel() for a in np.meshgrid(x, y))
    i, j = (a.ravel() for a in np.meshgrid(np.arange(columns - 1), np.arange(len(y) - 1)))
    a = j * columns + i
    quad = np.stack([a, a + 1, a + columns + 1, a + columns], axis=1).astype(np.int32)
    row = np.where(dark(x[i] + CELL / 2, y[j] + CELL / 2), 0, 1).astype(np.uint16)
    position = np.stack([across, along, np.zeros_like(across)], axis=1).astype(np.float32)
    mesh = Mesh(
        "checkerboard polygons", "Board", position, np.concatenate([quad[:, [0, 1, 2]], quad[:, [0, 2, 3]]]),
        vertex_normal=np.tile(np.array([[0, 0, 1]], np.float32), (len(position), 1)),
        material=np.concatenate([row, row]), materials=(0, 1),
    )  # fmt: skip
    return Geometry(mesh.key, "Board", mesh=mesh, primitive="POLYGONS")


def materials() -> MaterialTable:
    """Black, and glowing white."""
    table = default_materials()
    twice = {name: np.repeat(value, 2, axis=0) for name, value in vars(table).items() if isinstance(value, np.ndarray)}
    twice |= {"base_color": np.zeros((2, 3), np.float32), "specular": np.zeros(2, np.float32)}
    twice |= {"emission": np.array([[0, 0, 0], [1, 1, 1]], np.float32)}
    return replace(table, **twice, names=("Dark", "Light"), graphs=(None, None))


def camera() -> Camera:
    """Above the board's near end, towards +Y and a little down."""
    width, height = SIZE
    along = np.array([0.0, np.sqrt(1 - DOWN**2), -DOWN])
    view = np.eye(4)
    view[:3, :3] = (1, 0, 0), np.cross(-along, (1, 0, 0)), -along
    view[:3, 3] = -view[:3, :3] @ (0, 0, EYE_HEIGHT)
    near, far = 0.05, 200.0
    clip = np.zeros((4, 4))
    clip[0, 0], clip[1, 1] = FOCAL, FOCAL * width / height
    clip[2, 2:] = -(far + near) / (far - near), -2 * far * near / (far - near)
    clip[3, 2] = -1
    return Camera(view, clip, SIZE, near=near, far=far)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, required=True, help="a .png or .jpg")
    options = parser.parse_args()
    device = OpenGLDevice()
    renderer = Renderer(device)

    def picture(geometry: Geometry, technique: str, samples: int) -> np.ndarray:
        board = Scene((geometry,), Instances(np.zeros(1, np.int32), np.eye(4)[None]), materials(), (), World())
        settings = Settings(technique=technique, use_shadows=False, use_adaptive_sampling=False)
        request = Request(camera(), settings, frozenset({"combined"}), samples)
        return renderer.render(board, request).pixels["combined"]

    truth, cloud, rows = picture(polygons(), "AUTO", 64), points(), []
    for samples in (1, 16):
        row = []
        for technique in TECHNIQUES:
            row.append(picture(cloud, technique, samples))
            error = np.sqrt(((row[-1] - truth)[..., :3] ** 2).mean())
            sys.stdout.write(f"{technique:12} {samples:3} samples  RMSE {error:.4f}\n")
        rows.append(np.concatenate([displayed(p)[::-1] for p in (*row, truth)], axis=1))
    sheet = (255 * np.concatenate(rows) + 0.5).astype(np.uint8)
    Image.fromarray(sheet).resize((2 * sheet.shape[1], 2 * sheet.shape[0]), Image.Resampling.NEAREST).save(
        options.output
    )
    renderer.release()
    device.release()


if __name__ == "__main__":
    main()
