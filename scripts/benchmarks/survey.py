"""Makes a survey of any size of a tile from the air, for measurements of large scans.

    python -m scripts.benchmarks.survey TILE.laz FOLDER --points 100000000

The tile is repeated on a square grid, every other one mirrored so that neighbours fit, and each copy jittered by some
centimetres, so that no two are alike and LAZ packs them as it packs real ones. One file a copy; coordinates stay as
large as the tile's.
"""

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import laspy
import numpy as np

JITTER = 0.05  # standard deviation in units of the file
KEPT = ("intensity", "return_number", "number_of_returns", "classification", "gps_time", "red", "green", "blue")


def copy(source: Path, folder: Path, number: int, column: int, row: int, count: int) -> None:
    """Writes copy `number` of the tile, in a place of the grid, with its first `count` points."""
    path = folder / f"tile_{number:05}.laz"
    if path.exists():
        return
    tile = laspy.read(source)
    random = np.random.default_rng(number)
    header = laspy.LasHeader(point_format=7, version="1.4")
    low, high = np.array(tile.header.mins), np.array(tile.header.maxs)
    header.scales, header.offsets = np.array([0.01, 0.01, 0.01]), np.floor(low)
    header.vlrs += [record for record in tile.header.vlrs if record.user_id == "LASF_Projection"]
    made = laspy.LasData(header)
    position = np.array(tile.xyz)[:count]
    for axis, odd in enumerate((column % 2, row % 2)):
        if odd:
            position[:, axis] = low[axis] + high[axis] - position[:, axis]
    position[:, :2] += (high - low)[:2] * [column, row]
    position += random.normal(scale=JITTER, size=position.shape)
    made.x, made.y, made.z = position.T
    for name in KEPT:
        made[name] = np.asarray(tile[name])[:count]
    unfinished = path.with_suffix(".part.laz")
    made.write(str(unfinished))
    unfinished.replace(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tile", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--points", type=int, required=True)
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    with laspy.open(args.tile) as file:
        each = file.header.point_count
    tiles = math.ceil(args.points / each)
    side = math.ceil(math.sqrt(tiles))
    with ProcessPoolExecutor() as pool:
        waiting = [
            pool.submit(copy, args.tile, args.folder, i, i % side, i // side, min(each, args.points - i * each))
            for i in range(tiles)
        ]
        for one in waiting:
            one.result()


if __name__ == "__main__":
    main()
