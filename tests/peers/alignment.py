#!/usr/bin/env python3
"""Models without a scale in Python, beside the same work of `bench`.

    cargo build --release -p strat-bench -p strat-prep
    python3 tests/peers/alignment.py target/release [--images 40]

Makes an Eigen set of KITTI's native size (frames, scans, ground truth and maps of inverse depth by closed
formulas), prepares it with `prep`, and evaluates the saved maps in turns, best of the repeats:

scripts   one process, as the public scripts of such models do it: a 16-bit PNG of ground truth and a .npy an
          image, the benchmark crop of both, masks, least squares of scale and shift over the masked pixels by
          numpy.linalg.lstsq (and torch.linalg.lstsq where torch is there), a clip, twelve metrics, each over
          whole planes whose pixels outside the mask are set to zero
bench     `bench --table eigen-652`, two threads, the seconds of run.yaml: the same numbers, which must agree
cost      of alignment and further metrics in `bench`, as a share of the evaluation without: two protocols with
          and without alignment beside table 3.3, and table 3.3 with and without --metrics

Needs numpy, opencv-python-headless and PyYAML.
"""

import argparse
import csv
import pathlib
import subprocess
import sys
import tempfile
import time

import cv2
import numpy as np
import yaml

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tests" / "oracle"))
import aligned  # noqa: E402

try:
    import torch
except ModuleNotFoundError:
    torch = None

EIGEN = (0.3324324, 0.91351351, 0.0359477, 0.96405229)
COLUMNS = "abs_rel sq_rel rmse rmse_log a1 a2 a3 silog log10 irmse mae sq_rel_2 scale shift".split()


def run(*words):
    done = subprocess.run([*map(str, words)], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stdout + done.stderr)


def frames(count):
    """Test frames of the day whose images are 1242x375, from the published list."""
    found = []
    for line in (ROOT / "splits" / "data" / "eigen_test_697.txt").read_text().splitlines():
        drive, frame = line.split()[0].split("/")[-2:]
        if drive.startswith("2011_09_26"):
            found.append((drive.removesuffix("_sync"), int(frame)))
    return found[:count]


def solved(q, y, solver):
    design = np.stack([q, np.ones_like(q)], axis=1)
    if solver == "torch":
        return torch.linalg.lstsq(torch.from_numpy(design), torch.from_numpy(y[:, None])).solution[:, 0].numpy()
    return np.linalg.lstsq(design, y, rcond=None)[0]


def script(truth_file, map_file, solver):
    gt = cv2.imread(str(truth_file), cv2.IMREAD_UNCHANGED).astype(np.float32) / 256.0
    pred = np.load(map_file)
    height, width = gt.shape
    top, left = height - 352, (width - 1216) // 2
    gt, pred = (plane[top : top + 352, left : left + 1216] for plane in (gt, pred))
    mask = np.logical_and(gt > 1e-5, gt < 80)
    crop = np.zeros_like(mask)
    crop[int(EIGEN[0] * 352) : int(EIGEN[1] * 352), int(EIGEN[2] * 1216) : int(EIGEN[3] * 1216)] = True
    mask = np.logical_and(mask, crop)
    disparity = np.zeros_like(gt)
    np.divide(1.0, gt, out=disparity, where=gt > 0)
    used = mask & (pred > 0)
    scale, shift = solved(pred[used].astype(np.float64), disparity[used].astype(np.float64), solver)
    # As the scripts do it: whole planes, single precision, a pass for each metric, zeros outside the mask.
    p = np.clip(1.0 / np.maximum(scale * pred + shift, 1e-3), 1e-5, 80).astype(np.float32)
    g = np.where(mask, gt, 1).astype(np.float32)
    count = mask.sum()

    def mean(plane):
        plane[~mask] = 0
        return plane.sum(dtype=np.float64) / count

    return [
        mean(np.abs(p - g) / g),
        mean((p - g) ** 2 / g),
        np.sqrt(mean((p - g) ** 2)),
        np.sqrt(mean((np.log(p) - np.log(g)) ** 2)),
        *(mean((np.maximum(p / g, g / p) < 1.25**k).astype(np.float32)) for k in (1, 2, 3)),
        100 * np.sqrt(max(mean((np.log(p) - np.log(g)) ** 2) - mean(np.log(p) - np.log(g)) ** 2, 0)),
        mean(np.abs(np.log10(p) - np.log10(g))),
        np.sqrt(mean((1000 / p - 1000 / g) ** 2)),
        mean(np.abs(p - g)),
        mean(((p - g) / g) ** 2),
        scale,
        shift,
    ]


def wobbling(true):
    """Inverse depth in no unit that no fit brings back exactly."""
    y, x = np.mgrid[: true.shape[0], : true.shape[1]]
    depth = np.where(true > 0, true, 30).astype(np.float64) * (1 + 0.1 * np.sin(x / 23) * np.cos(y / 17))
    return (300 / depth + 11).astype("<f4")


class Bench:
    def __init__(self, folder, binary, maps):
        self.folder, self.binary, self.maps = folder, binary, maps

    def seconds(self, table, meaning, *words):
        (self.maps / "predictions.yaml").write_text(f"meaning: {meaning}\n")
        out = self.folder / "out"
        run(self.binary, "--table", table, "--data", self.folder / "set", "--predictions", f"m={self.maps}",
            "--out", out, "--force", "--jobs", 2, "--quiet", *words)
        self.rows = list(csv.DictReader((out / "rows.csv").open()))
        return yaml.safe_load((out / "run.yaml").read_text())["models"][0]["seconds"]


def best(repeats, *works):
    """The least seconds of each work, all in turns."""
    times = [[] for _ in works]
    for _ in range(repeats):
        for work, own in zip(works, times):
            own.append(work())
    return [min(own) for own in times]


def measure(args, folder):
    wanted = frames(args.images)
    raw, annotated, maps = folder / "kitti_raw", folder / "annotated", folder / "maps"
    maps.mkdir()
    aligned.make_frames(raw, wanted)
    pairs = []
    for drive, number in wanted:
        true = aligned.improved(raw, raw / drive[:10] / f"{drive}_sync/velodyne_points/data/{number:010}.bin")
        truth = annotated / f"val/{drive}_sync/proj_depth/groundtruth/image_02/{number:010}.png"
        aligned.write_png(truth, np.rint(true * 256))
        saved = maps / f"{drive}_{number:010}.npy"
        np.save(saved, wobbling(true))
        pairs.append((truth, saved))
    run(args.programs / "prep", "eigen", "--raw", raw, "--annotated", annotated, "--out", folder / "set",
        "--allow-missing", "--test-only", "--quiet")
    bench = Bench(folder, args.programs / "bench", maps)
    found = {}

    def scripts(solver):
        def work():
            start = time.perf_counter()
            found[solver] = [script(truth, saved, solver) for truth, saved in pairs]
            return time.perf_counter() - start

        return work

    solvers = ["numpy", "torch"] if torch else ["numpy"]
    ours, *theirs = best(args.repeats, lambda: bench.seconds("eigen-652", "inverse_depth"),
                         *(scripts(solver) for solver in solvers))
    each = 1e3 / len(pairs)
    by_image = {row["image"]: [float(row[name]) for name in COLUMNS] for row in bench.rows}
    mine = np.array([by_image[f"{drive}/{number:010}"] for drive, number in wanted])
    for solver, seconds in zip(solvers, theirs):
        other = np.array(found[solver])
        print(f"{solver:<9} scripts {seconds * each:.2f} ms an image, bench {ours * each:.2f} ms: "
              f"{seconds / ours:.1f} times; largest relative difference "
              f"{np.max(np.abs(mine - other) / np.maximum(np.abs(other), 1e-6)):.1e}")
    copies = []
    for name in ("eigen-80", "eigen-50"):
        file = folder / f"{name}-again.yaml"
        file.write_text(f"name: {name}-again\nbase: {name}\n")
        copies += ["--protocol", file]
    fits = ["--protocol", "eigen-80-affine-disparity", "--protocol", "eigen-50-affine-disparity"]
    meaning = "inverse_depth_per_m"
    plain, further, twice, fitted = best(
        args.repeats,
        lambda: bench.seconds("3.3", meaning),
        lambda: bench.seconds("3.3", meaning, "--metrics"),
        lambda: bench.seconds("3.3", meaning, *copies),
        lambda: bench.seconds("3.3", meaning, *fits),
    )
    print(f"cost      evaluation without {plain * each:.2f} ms an image; further metrics {100 * (further / plain - 1):+.1f} %, "
          f"alignment {100 * (fitted - twice) / plain:+.1f} %")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("programs", type=pathlib.Path, help="the folder of prep and bench")
    parser.add_argument("--images", type=int, default=40)
    parser.add_argument("--repeats", type=int, default=5)
    args = parser.parse_args()
    cv2.setNumThreads(2)
    with tempfile.TemporaryDirectory() as folder:
        measure(args, pathlib.Path(folder))


if __name__ == "__main__":
    main()
