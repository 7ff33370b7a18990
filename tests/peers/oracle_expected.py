#!/usr/bin/env python3
"""Predictions in closed form and what an independent evaluation in numpy makes of them.

    python3 tests/peers/oracle_expected.py ORACLE SAMPLES IDS OUT

ORACLE is the folder of `oracle.py`, SAMPLES one with `kitti_raw/` and `kitti2015/`, IDS a text with an
image id a line. Writes OUT/predictions.npy with ids and description, as `bench --predictions` reads
them, and OUT/expected.json: the seven metrics, and D1-all, by protocol and image. Ground truth is read
from the published files, not from a prepared set. Called by the test `oracle` of strat-tests.
"""

import json
import pathlib
import sys

import numpy as np

oracle_folder, samples, ids_file, out = map(pathlib.Path, sys.argv[1:])
sys.path.insert(0, str(oracle_folder))
import oracle  # noqa: E402

EIGEN = {
    "eigen-80": {},
    "eigen-50": {"max_depth": 50.0},
    "eigen-50-min1": {"min_depth": 1.0, "max_depth": 50.0},
    "eigen-80-median": {"median_scale": True},
    "eigen-80-nocrop": {"crop": None},
    "eigen-80-eigencrop": {"crop": "eigen"},
}


def predictions(count, height=96, width=320):
    """Disparity fractions, all above the floor of 1e-4, different for each image."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    maps = [
        0.002 + 0.05 * np.maximum(y - 20 - k % 7, 0) / height + 0.001 * np.sin(x / (9 + k) + k) * np.cos(y / 7)
        for k in range(count)
    ]
    return np.asarray(maps, dtype="<f4")


def kitti(image, pred):
    training = samples / "kitti2015" / "training"
    number = image.split("/")[1]
    found = {}
    for protocol, kind in (("kitti2015", "noc"), ("kitti2015-occ", "occ")):
        file = training / f"disp_{kind}_0" / f"{number}_10.png"
        if not file.is_file():
            continue
        gt = oracle.read_png(file).astype(np.float32) / 256
        metrics, d1 = oracle.eval_kitti_image(gt, pred)
        found[protocol] = [*map(float, metrics), float(d1)]
    return found


def eigen(image, pred):
    drive, frame = image.split("/")
    day = samples / "kitti_raw" / drive[:10]
    cam = oracle.read_calib(day / "calib_cam_to_cam.txt")
    velo = oracle.read_calib(day / "calib_velo_to_cam.txt")
    width, height = (int(v) for v in cam["S_rect_02"])
    points = oracle.read_velodyne(day / f"{drive}_sync" / "velodyne_points" / "data" / f"{int(frame):010d}.bin")
    focal, baseline = oracle.stereo_from_calib(cam)
    found = {}
    for axis, prefix in (("velodyne", "eigen"), ("camera", "eigen-cameraz")):
        matrix = oracle.velo_projection(cam, velo)
        gt = oracle.velo_depth_map(points, matrix, height, width, axis).astype(np.float32)
        wanted = EIGEN if axis == "velodyne" else {"eigen-80": {}, "eigen-50": {"max_depth": 50.0}}
        for protocol, options in wanted.items():
            metrics = oracle.eval_eigen_image(gt, pred, focal, baseline, **options)
            found[protocol.replace("eigen", prefix, 1)] = list(map(float, metrics))
    return found


ids = ids_file.read_text().split()
pred = predictions(len(ids))
np.save(out / "predictions.npy", pred)
(out / "predictions.ids.txt").write_text("\n".join(ids) + "\n")
(out / "predictions.yaml").write_text("meaning: disparity_fraction\n")
expected = {}
for image, plane in zip(ids, pred):
    one = kitti(image, plane) if image.startswith("kitti2015/") else eigen(image, plane)
    for protocol, values in one.items():
        expected.setdefault(protocol, {})[image] = values
(out / "expected.json").write_text(json.dumps(expected))
