#!/usr/bin/env python3
"""The Python package beside the published scripts' way in numpy, and beside `bench --predictions`.

    (cd bench/python && maturin build --release) && pip install target/wheels/strat_depth-*.whl
    cargo build --release -p strat-bench
    python3 tests/peers/python.py target/release/bench --data SET

SET is a prepared Eigen set. Two comparisons, in turns on the same machine, best of the repeats:

image   `strat.evaluate_all` under eigen-80 and eigen-50 of a map of 192x640 in memory, beside the same in OpenCV
        and numpy: resize, clip, mask, Garg crop, seven metrics under each cap; one thread each. The values must
        agree.
run     `strat.Run.add` for all test images from as many threads as `bench --predictions` has, beside the seconds
        that `bench` reports for the same maps. The rows must be equal byte for byte.

Needs numpy, opencv-python-headless and PyYAML.
"""

import argparse
import pathlib
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import yaml

import strat

NAMES = ["abs_rel", "sq_rel", "rmse", "rmse_log", "a1", "a2", "a3"]


def published_way(disparity, gt, focal_baseline):
    """Both caps, as the scripts go about it, which run once for each; seven metrics each."""
    height, width = gt.shape
    found = []
    for cap in (80, 50):
        pixels = width * cv2.resize(disparity, (width, height), interpolation=cv2.INTER_LINEAR)
        depth = focal_baseline / pixels
        depth[np.isinf(depth)] = 0
        depth[depth < 1e-3] = 1e-3
        depth[depth > cap] = cap
        mask = np.logical_and(gt > 1e-3, gt < cap)
        box = np.array([0.40810811 * height, 0.99189189 * height, 0.03594771 * width, 0.96405229 * width])
        top, bottom, left, right = box.astype(np.int32)
        crop = np.zeros(mask.shape)
        crop[top:bottom, left:right] = 1
        mask = np.logical_and(mask, crop)
        true, predicted = gt[mask], depth[mask]
        ratio = np.maximum(true / predicted, predicted / true)
        found.append([
            np.mean(np.abs(true - predicted) / true),
            np.mean((true - predicted) ** 2 / true),
            np.sqrt(np.mean((true - predicted) ** 2)),
            np.sqrt(np.mean((np.log(true) - np.log(predicted)) ** 2)),
            *(np.mean(ratio < 1.25**k) for k in (1, 2, 3)),
        ])
    return found


def disparity(index):
    rows, columns = np.mgrid[0:192, 0:640]
    return (0.01 + 0.09 * (rows / 192) ** 2 + 0.004 * np.sin(columns / 30 + index)).astype(np.float32)


def milliseconds(work, repeats):
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times) * 1e3


def compare_images(samples, repeats):
    cv2.setNumThreads(1)
    ours, theirs = [], []
    for index, sample in enumerate(samples):
        map, truth = disparity(index), sample["depth_velodyne"]
        camera = {"focal_px": sample["focal_px"], "baseline_m": sample["baseline_m"]}
        words = {"protocols": ["eigen-80", "eigen-50"], "meaning": "disparity_fraction", **camera}
        focal_baseline = np.float32(sample["focal_px"] * sample["baseline_m"])
        for score, values in zip(strat.evaluate_all(map, truth, **words), published_way(map, truth, focal_baseline)):
            np.testing.assert_allclose([score[name] for name in NAMES[:4]], values[:4], rtol=1e-4)
        ours.append(milliseconds(lambda: strat.evaluate_all(map, truth, **words), repeats))
        theirs.append(milliseconds(lambda: published_way(map, truth, focal_baseline), repeats))
    ours, theirs = np.mean(ours), np.mean(theirs)
    print(f"image   {len(samples)} images: numpy {theirs:.2f} ms, strat {ours:.2f} ms: {theirs / ours:.1f} times faster")


def compare_runs(args, folder):
    maps = {}
    saved = folder / "maps"
    for index, name in enumerate(strat.PreparedSet(args.data).test.ids):
        maps[name] = disparity(index)
        path = saved / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, maps[name])
    (saved / "predictions.yaml").write_text("meaning: disparity_fraction\n")
    ours, theirs = [], []
    for repeat in range(args.repeats):
        run = strat.Run(args.data, model="m", meaning="disparity_fraction")
        with ThreadPoolExecutor(args.threads) as pool:
            start = time.perf_counter()
            list(pool.map(run.add, maps, maps.values()))
            ours.append(time.perf_counter() - start)
        run.rows().write(folder / "rows.csv")
        out = folder / f"out{repeat}"
        line = [args.bench, "--table", "3.3", "--data", args.data, "--predictions", f"m={saved}", "--out", out]
        subprocess.run([*line, "--jobs", str(args.threads), "--quiet"], check=True, stdout=subprocess.DEVNULL)
        theirs.append(yaml.safe_load((out / "run.yaml").read_text())["models"][0]["seconds"])
        assert (out / "rows.csv").read_bytes() == (folder / "rows.csv").read_bytes()
    print(
        f"run     {len(maps)} images: bench {min(theirs):.3f} s, strat.Run {min(ours):.3f} s: "
        f"{min(ours) / min(theirs):.2f}"
    )


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bench")
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=8)
    args = parser.parse_args()
    compare_images(list(strat.PreparedSet(args.data).test), args.repeats)
    with tempfile.TemporaryDirectory() as folder:
        compare_runs(args, pathlib.Path(folder))


if __name__ == "__main__":
    main()
