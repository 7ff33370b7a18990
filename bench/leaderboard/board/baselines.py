"""Saved predictions that look at no image: one depth everywhere, and a flat road below the horizon.

    python baselines.py SET OUT

writes OUT/constant.npy and OUT/flat_road.npy with their descriptions and lists of ids, for
`bench --predictions`. SET is a prepared set; maps have the sizes of its network images.
"""

import csv
import sys
from pathlib import Path

import numpy as np

CAMERA_HEIGHT_M = 1.65  # KITTI's, PROTOCOL 5.3
HORIZON = 0.46  # of the image height: cy / height of KITTI's cameras, PROTOCOL 1.1
FAR_M = 80.0
CONSTANT_M = 15.0
ROWS, COLUMNS = 94, 310


def main(folder: Path, out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    with open(folder / "test.csv", newline="", encoding="utf-8") as file:
        samples = list(csv.DictReader(file))
    roads = []
    for sample in samples:
        height = float(sample["height"])
        rows = (np.arange(ROWS) + 0.5) / ROWS * height
        below = np.maximum(rows - HORIZON * height, 1e-6)
        depth = np.minimum(float(sample["focal_px"]) * CAMERA_HEIGHT_M / below, FAR_M)
        roads.append(np.repeat(depth[:, None], COLUMNS, axis=1))
    maps = {"flat_road": np.array(roads), "constant": np.full((len(samples), ROWS, COLUMNS), CONSTANT_M)}
    for name, values in maps.items():
        np.save(out / f"{name}.npy", values.astype(np.float16))
        (out / f"{name}.yaml").write_text("meaning: depth_m\nstretched: true\n", encoding="utf-8")
        ids = "".join(sample["id"] + "\n" for sample in samples)
        (out / f"{name}.ids.txt").write_text(ids, encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
