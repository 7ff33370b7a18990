#!/usr/bin/env python3
"""Evaluation in Python, beside the same work of `bench`.

    cargo build --release -p strat-bench
    python3 tests/peers/bench.py target/release/bench --data SET --raw KITTI_RAW --model model.onnx

SET is a prepared Eigen set whose scans are below KITTI_RAW. Three comparisons, each in turns on the same
machine, best of the repeats:

session   one run of the model: onnxruntime's Python package beside `bench latency`, the same threads
table     `bench --table 3.3` from files to rows, beside the bare session time of as many images
saved     saved predictions to metrics: the published scripts' way (OpenCV resizes, numpy masks and
          metrics, one process), with the ground truth made of each scan as they do it, and with ground
          truth that was made before; beside `bench --predictions`. The figures must agree.

Needs numpy, opencv-python-headless, onnxruntime and PyYAML.
"""

import argparse
import csv
import pathlib
import subprocess
import tempfile
import time

import cv2
import numpy as np
import onnxruntime
import yaml

from prep import calibration, projection, scan_depth


def bench(binary, *words):
    done = subprocess.run([binary, *map(str, words)], capture_output=True, text=True)
    if done.returncode not in (0, 1):
        raise SystemExit(done.stderr)
    return done


def seconds_of(out):
    return yaml.safe_load((out / "run.yaml").read_text())["models"][0]["seconds"]


def python_session(model, threads, runs, spinning):
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.intra_op.allow_spinning", spinning)
    options.intra_op_num_threads = threads
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    wanted = session.get_inputs()[0]
    shape = [1 if isinstance(side, str) else side for side in wanted.shape]
    image = np.random.default_rng(0).random(shape, dtype=np.float32)
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        session.run(None, {wanted.name: image})
        times.append(time.perf_counter() - start)
    return float(np.median(times[2:])) * 1e3


def metrics(gt, pred):
    ratio = np.maximum(gt / pred, pred / gt)
    return [
        np.mean(np.abs(gt - pred) / gt),
        np.mean((gt - pred) ** 2 / gt),
        np.sqrt(np.mean((gt - pred) ** 2)),
        np.sqrt(np.mean((np.log(gt) - np.log(pred)) ** 2)),
        *(np.mean(ratio < 1.25**k) for k in (1, 2, 3)),
    ]


def python_evaluation(disparities, samples, images, raw, ground_truth):
    """The Eigen evaluation, 80 m and Garg crop, as the published scripts go about it."""
    rows = []
    for disparity, sample in zip(disparities, samples):
        drive, frame = sample["id"].split("/")
        day = raw / drive[:10]
        if ground_truth is None:
            matrix = projection(day)[0]
            scan = day / f"{drive}_sync" / "velodyne_points" / "data" / f"{frame}.bin"
            # The size is that of the image, which monodepth's script decodes for it.
            height, width = cv2.imread(str(images / sample["left_full"])).shape[:2]
            gt = scan_depth(scan, matrix, width, height)
        else:
            gt = np.load(ground_truth / f"{sample['id'].replace('/', '_')}.npz")["depth"]
        height, width = gt.shape
        pixels = width * cv2.resize(disparity, (width, height), interpolation=cv2.INTER_LINEAR)
        cam = calibration(day / "calib_cam_to_cam.txt")
        p2, p3 = (cam[f"P_rect_0{k}"].reshape(3, 4) for k in (2, 3))
        baseline = p3[0, 3] / -p3[0, 0] - p2[0, 3] / -p2[0, 0]
        depth = p2[0, 0] * baseline / pixels
        depth[np.isinf(depth)] = 0
        depth[depth < 1e-3] = 1e-3
        depth[depth > 80] = 80
        mask = np.logical_and(gt > 1e-3, gt < 80)
        box = np.array([0.40810811 * height, 0.99189189 * height, 0.03594771 * width, 0.96405229 * width])
        top, bottom, left, right = box.astype(np.int32)
        crop = np.zeros(mask.shape)
        crop[top:bottom, left:right] = 1
        mask = np.logical_and(mask, crop)
        rows.append(metrics(gt[mask], depth[mask]))
    return np.array(rows)


def compare_model(args, samples, folder):
    """The comparisons `session` and `table`; returns the predictions."""
    python, spinning, ours = [], [], []
    for repeat in range(args.repeats):
        python.append(python_session(args.model, args.threads, 15, "0"))
        spinning.append(python_session(args.model, args.threads, 15, "1"))
        out = folder / f"latency{repeat}"
        bench(args.bench, "latency", "--model", args.model, "--data", args.data, "--out", out, "--threads",
              args.threads, "--seconds", 4, "--queries", 10, "--runtime", "ort", "--quiet")
        rows = list(csv.DictReader((out / "latency.csv").open()))
        ours += [float(r["p50_ms"]) for r in rows if r["stage"] == "session" and r["scenario"] == "single_stream"]
    session = min(ours)
    print(
        f"session   onnxruntime in Python {min(python):.1f} ms, bench {session:.1f} ms: {session / min(python):.3f}; "
        f"Python with threads that spin, its default, {min(spinning):.1f} ms: {session / min(spinning):.3f}"
    )

    words = ["--table", "3.3", "--data", args.data, "--model", args.model, "--threads", args.threads, "--jobs",
             args.threads, "--runtime", "ort", "--quiet"]
    table = []
    for repeat in range(args.repeats):
        out = folder / f"table{repeat}"
        bench(args.bench, *words, "--out", out)
        table.append(seconds_of(out))
    # What is saved costs time of its own.
    bench(args.bench, *words, "--out", folder / "saving", "--save-predictions")
    bare = session / 1e3 * len(samples)
    print(f"table     {len(samples)} images: bench {min(table):.2f} s, the session alone {bare:.2f} s: {min(table) / bare:.3f}")
    return folder / "saving" / "predictions.npy"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("bench")
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--raw", type=pathlib.Path, required=True)
    parser.add_argument("--model")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--saved", metavar="FILE.npy", type=pathlib.Path,
                        help="leave out the other two comparisons and score these predictions")
    args = parser.parse_args()
    if not (args.model or args.saved):
        parser.error("--model or --saved is needed")
    samples = list(csv.DictReader((args.data / "test.csv").open()))
    cv2.setNumThreads(args.threads)
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)

        saved = args.saved or compare_model(args, samples, folder)
        disparities = np.load(saved)
        truth = folder / "truth"
        truth.mkdir()
        for sample in samples:
            drive, frame = sample["id"].split("/")
            day = args.raw / drive[:10]
            scan = day / f"{drive}_sync" / "velodyne_points" / "data" / f"{frame}.bin"
            depth = scan_depth(scan, *projection(day))
            np.savez_compressed(truth / f"{sample['id'].replace('/', '_')}.npz", depth=depth)
        scripts, before, ours = [], [], []
        for repeat in range(args.repeats):
            for times, ground_truth in ((scripts, None), (before, truth)):
                start = time.perf_counter()
                for _ in ("eigen-80", "eigen-50"):  # the script runs once for each cap
                    found = python_evaluation(disparities, samples, args.data, args.raw, ground_truth)
                times.append(time.perf_counter() - start)
            out = folder / f"saved{repeat}"
            bench(args.bench, "--table", "3.3", "--data", args.data, "--predictions", saved, "--out", out, "--jobs",
                  args.threads, "--quiet")
            ours.append(seconds_of(out))
        rows = [r for r in csv.DictReader((out / "rows.csv").open()) if r["protocol"] == "eigen-80"]
        names = ("abs_rel", "sq_rel", "rmse", "rmse_log", "a1", "a2", "a3")
        mine = np.array([[float(row[name]) for name in names] for row in rows])
        each = 1e3 / len(samples)
        print(
            f"saved     two caps, per image: scripts {min(scripts) * each:.1f} ms, with ground truth made before "
            f"{min(before) * each:.1f} ms, bench {min(ours) * each:.2f} ms: "
            f"{min(scripts) / min(ours):.1f} and {min(before) / min(ours):.1f} times; "
            f"largest difference {np.abs(mine - found).max():.1e}"
        )


if __name__ == "__main__":
    main()
