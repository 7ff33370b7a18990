#!/usr/bin/env python3
"""Preparation of pictures and scans in Python, beside the same work of `prep`.

    cargo build --release -p strat-prep --examples
    cargo run --release -p strat-prep -- synth --preset demo --out world
    python3 tests/peers/prep.py target/release/examples/frames world/kitti_raw/2011_09_26 [--jobs 2]

Pictures: decode, shrink to 512 x 256 by area means, encode as PNG, write; OpenCV with its default
settings in a pool of processes. Scans: ground truth of the Eigen split as PROTOCOL 3.5 states it, in
numpy with a dictionary of counts and a loop over repeated pixels. The published export (monodepth2) makes
one frame after the other in one process and reads the calibration again for each; it is timed so, and
in the pool with the calibration read once, which is the comparison of equal work.
Both sides run in turns on the same files, each having done them before (the pool keeps its processes,
prep does the work twice), and the best of the repeats counts;
depth is not written while the time is taken. The results are compared too. Needs numpy and
opencv-python-headless.
"""

import argparse
import collections
import itertools
import multiprocessing
import os
import pathlib
import subprocess
import tempfile
import time

# The product of a 3 x 4 matrix with the points gains nothing from threads and loses where cores are busy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np

SIZE = (512, 256)


def picture(job):
    source, target = job
    image = cv2.imread(source)
    cv2.imwrite(target, cv2.resize(image, SIZE, interpolation=cv2.INTER_AREA))


def calibration(path):
    values = {}
    for line in path.read_text().splitlines():
        key, _, numbers = line.partition(":")
        try:
            values[key] = np.array([float(word) for word in numbers.split()])
        except ValueError:
            pass  # dates
    return values


def projection(day):
    cam = calibration(day / "calib_cam_to_cam.txt")
    velo = calibration(day / "calib_velo_to_cam.txt")
    rectify, transform = np.eye(4), np.eye(4)
    rectify[:3, :3] = cam["R_rect_00"].reshape(3, 3)
    transform[:3, :3] = velo["R"].reshape(3, 3)
    transform[:3, 3] = velo["T"]
    width, height = cam["S_rect_02"].astype(int)
    return cam["P_rect_02"].reshape(3, 4) @ rectify @ transform, width, height


def scan_depth(source, matrix, width, height):
    points = np.fromfile(source, dtype=np.float32).reshape(-1, 4)
    points[:, 3] = 1.0
    points = points[points[:, 0] >= 0]
    seen = (matrix @ points.T).T
    seen[:, :2] /= seen[:, 2:]
    column = np.round(seen[:, 0]).astype(np.int64) - 1
    row = np.round(seen[:, 1]).astype(np.int64) - 1
    inside = (column >= 0) & (row >= 0) & (column < width) & (row < height)
    column, row, value = column[inside], row[inside], points[inside, 0].astype(np.float64)
    depth = np.zeros((height, width))
    depth[row, column] = value
    keys = row * (width - 1) + column - 1
    for key in [key for key, count in collections.Counter(keys).items() if count > 1]:
        same = np.where(keys == key)[0]
        depth[row[same[0]], column[same[0]]] = value[same].min()
    depth[depth < 0] = 0
    return depth.astype(np.float32)


def scan(job):
    source, target, placed = job
    depth = scan_depth(source, *placed)
    if target:
        depth.tofile(target)


def published(scans, day):
    start = time.perf_counter()
    depths = []
    for file in scans:
        depths.append(scan_depth(str(file), *projection(day)))
    return time.perf_counter() - start


def alone():
    # One thread per process: the pool already uses every worker asked for.
    cv2.setNumThreads(1)


def of_python(pool, work, jobs):
    start = time.perf_counter()
    pool.map(work, jobs, chunksize=max(1, len(jobs) // 32))
    return time.perf_counter() - start


def of_prep(program, what, jobs, out, files, day=None):
    command = [program, what, str(jobs), str(out)] + ([str(day)] if day else [])
    run = subprocess.run(command + [str(f) for f in files], check=True, capture_output=True, text=True)
    return float(run.stdout.split()[1])


def measured(name, count, repeat, python, prep):
    times = [(python(), prep()) for _ in range(repeat)]
    slow, fast = (min(side) for side in zip(*times))
    print(f"{name}: {count} files, Python {count / slow:.1f}/s, prep {count / fast:.1f}/s, ratio {slow / fast:.1f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", help="the example `frames` of strat-prep, built for release")
    parser.add_argument("day", type=pathlib.Path, help="a recording day in KITTI raw's layout")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--limit", type=int, default=120, help="pictures and scans taken at most, if at least 60")
    args = parser.parse_args()
    pictures = sorted(args.day.glob("*_sync/image_0[23]/data/*.*g"))
    scans = sorted(args.day.glob("*_sync/velodyne_points/data/*.bin"))
    if not pictures or not scans:
        parser.error(f"{args.day} has no pictures or no scans")
    # A few files are taken again and again: memory of a first file is dearer than that of later ones.
    pictures, scans = (
        list(itertools.islice(itertools.cycle(files), max(60, min(len(files), args.limit))))
        for files in (pictures, scans)
    )

    with tempfile.TemporaryDirectory() as folder, multiprocessing.Pool(args.jobs, alone) as pool:
        ours, theirs = pathlib.Path(folder, "prep"), pathlib.Path(folder, "python")
        # Files are linked under one name each: frame numbers repeat between drives.
        for place in (ours, theirs, pathlib.Path(folder, "in")):
            place.mkdir()

        def linked(files):
            links = [pathlib.Path(folder, "in", f"{i:04}{file.suffix}") for i, file in enumerate(files)]
            for link, file in zip(links, files):
                link.symlink_to(file.resolve())
            return links

        pictures, scans = linked(pictures), linked(scans)
        jobs = [(str(f), str(theirs / f"{f.stem}.png")) for f in pictures]
        measured(
            "pictures", len(jobs), args.repeat,
            lambda: of_python(pool, picture, jobs),
            lambda: of_prep(args.frames, "images", args.jobs, ours, pictures),
        )
        worst, sizes = 0, [0, 0]
        for _, target in jobs:
            own = ours / pathlib.Path(target).name
            difference = cv2.absdiff(cv2.imread(target), cv2.imread(str(own)))
            worst = max(worst, int(difference.max()))
            sizes[0] += pathlib.Path(target).stat().st_size
            sizes[1] += own.stat().st_size
        print(f"  largest difference {worst} grey levels, size {sizes[1] / sizes[0]:.3f} of OpenCV's")

        matrix = projection(args.day)

        def prep_scans():
            return of_prep(args.frames, "scans", args.jobs, "-", scans, args.day)

        measured(
            "scans, Python as published", len(scans), args.repeat,
            lambda: published(scans, args.day), prep_scans,
        )
        measured(
            "scans, Python in the pool", len(scans), args.repeat,
            lambda: of_python(pool, scan, [(str(f), None, matrix) for f in scans]), prep_scans,
        )
        jobs = [(str(f), str(theirs / f"{f.stem}.f32"), matrix) for f in scans]
        of_python(pool, scan, jobs)
        of_prep(args.frames, "scans", args.jobs, ours, scans, args.day)
        equal = sum(
            pathlib.Path(target).read_bytes() == (ours / pathlib.Path(target).name).read_bytes()
            for _, target, _ in jobs
        )
        print(f"  {equal} of {len(jobs)} depth images equal bit for bit")


if __name__ == "__main__":
    main()
