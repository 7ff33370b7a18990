#!/usr/bin/env python3
"""What `bench` must find for predictions by closed formulas, computed from KITTI's own files.

    python3 tests/oracle/expected.py DATA IDS OUT

DATA holds `kitti_raw/` and `kitti2015/`, as KITTI or `prep synth` lays them out; IDS is a text with an image id
a line, all of one split. Writes OUT/predictions.npy with its ids and description, as
`bench --predictions` reads them, and OUT/expected.json: one record for each row that `bench` writes.
Nothing is read from a prepared set. The test `oracle` of strat-tests compares.
"""

import json
import pathlib
import sys

import numpy as np

import evaluation
import geometry
import inputs

EIGEN = {
    "eigen-80": {},
    "eigen-50": {"far": 50.0},
    "eigen-50-min1": {"near": 1.0, "far": 50.0},
    "eigen-80-median": {"median": True},
    "eigen-80-nocrop": {"crop": None},
    "eigen-80-eigencrop": {"crop": "eigen"},
}


def predictions(count, height=96, width=320):
    """Disparities as fractions of the width, different for each image; every second has zeros in it."""
    y, x = np.mgrid[0:height, 0:width].astype(float)
    maps = []
    for k in range(count):
        near = np.maximum(y - 20 - k % 7, 0) / height
        plane = 0.002 + 0.05 * near + 0.001 * np.sin(x / (9 + k) + k) * np.cos(y / 7)
        if k % 2 == 1:
            plane[60:66, 100:120] = 0
        maps.append(plane)
    return np.asarray(maps, "<f4")


def record(protocol, image, at, true, depth, group=None, d1=None):
    values = evaluation.metrics(true[at], depth[at])
    return {
        "protocol": protocol,
        "image": image,
        "group": group,
        "metrics": values,
        "d1": d1,
        "pixels": int(at.sum()),
    }


def kitti(folder, image, fraction):
    number = image.split("/")[1]

    def file(kind, extension="png", suffix="_10"):
        path = folder / "kitti2015" / "training" / kind / f"{number}{suffix}.{extension}"
        return path if path.is_file() else None

    calibration = file("calib_cam_to_cam", "txt", "")
    own = geometry.stereo(inputs.calibration(calibration)) if calibration else None
    for kind, protocols in (
        ("disp_noc_0", ["kitti2015", "kitti2015-calibrated"]),
        ("disp_occ_0", ["kitti2015-occ"]),
    ):
        if not (path := file(kind)):
            continue
        true_px = inputs.disparity_px(path)
        # Rendered images may have widths that KITTI has not.
        focal_px = geometry.NOMINAL_FOCAL_PX.get(true_px.shape[1]) or own[0]
        nominal = (focal_px, geometry.NOMINAL_BASELINE_M)
        for protocol in protocols:
            camera = own if protocol == "kitti2015-calibrated" else nominal
            if camera is None:
                continue
            at, true, depth, *px = evaluation.stereo_pixels(true_px, fraction, camera)
            d1 = evaluation.d1_all(px[0][at], px[1][at])
            yield record(protocol, image, at, true, depth, d1=d1)
            if protocol != "kitti2015":
                continue
            for name, inside in evaluation.by_distance(at, true):
                yield record("kitti2015-distance", image, inside, true, depth, name)
            if labels := file("semantic"):
                for name, inside in evaluation.by_group(at, inputs.png(labels)):
                    yield record("semantic", image, inside, true, depth, name)


def eigen(folder, image, fraction):
    drive, frame = image.split("/")
    day = folder / "kitti_raw" / drive[:10]
    camera = inputs.calibration(day / "calib_cam_to_cam.txt")
    matrix = geometry.scanner_to_image(camera, inputs.calibration(day / "calib_velo_to_cam.txt"))
    width, height = (int(number) for number in camera["S_rect_02"])
    points = inputs.scan(day / f"{drive}_sync" / "velodyne_points" / "data" / f"{frame}.bin")
    rig = geometry.stereo(camera)
    for axis in ("velodyne", "camera"):
        truth = geometry.scan_depth(points, matrix, width, height, axis)
        for protocol, rules in EIGEN.items() if axis == "velodyne" else list(EIGEN.items())[:2]:
            at, true, depth = evaluation.eigen_pixels(truth, fraction, rig, **rules)
            name = protocol if axis == "velodyne" else protocol.replace("eigen", "eigen-cameraz")
            yield record(name, image, at, true, depth)
            if name == "eigen-80":
                for group, inside in evaluation.by_distance(at, true):
                    yield record("eigen-80-distance", image, inside, true, depth, group)


def main(folder, ids_file, out):
    ids = ids_file.read_text().split()
    planes = predictions(len(ids))
    np.save(out / "predictions.npy", planes)
    (out / "predictions.ids.txt").write_text("\n".join(ids) + "\n")
    (out / "predictions.yaml").write_text("meaning: disparity_fraction\n")
    found = []
    for image, plane in zip(ids, planes):
        found += (
            kitti(folder, image, plane) if image.startswith("kitti2015/") else eigen(folder, image, plane)
        )
    (out / "expected.json").write_text(json.dumps(found))


if __name__ == "__main__":
    main(*map(pathlib.Path, sys.argv[1:]))
