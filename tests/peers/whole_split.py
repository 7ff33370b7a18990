#!/usr/bin/env python3
"""A raw folder with all 697 frames of the Eigen test, for measurements at the size that papers evaluate.

    python3 tests/peers/whole_split.py target/release/prep world/kitti_raw whole

Each frame is a link to a frame of the same day in a smaller rendered world, in turn: file for file the work
of a whole split, and not its contents. Prepare it with `prep eigen --raw whole --test-only`.
"""

import argparse
import itertools
import os
import pathlib
import subprocess


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("prep")
    parser.add_argument("world", type=pathlib.Path)
    parser.add_argument("out", type=pathlib.Path)
    args = parser.parse_args()
    days = {}
    for day in sorted(path for path in args.world.iterdir() if path.is_dir()):
        # Some frames of KITTI have no scan.
        scans = sorted(day.glob("*_sync/velodyne_points/data/*.bin"))
        days[day.name] = itertools.cycle(scans)
    listed = subprocess.run([args.prep, "splits", "eigen", "--list", "test"], check=True, capture_output=True, text=True)
    ids = listed.stdout.split()
    for name in ids:
        drive, frame = name.split("/")
        day = drive[:10]
        scan = next(days[day])
        drive_there = scan.parents[2]
        pieces = [("velodyne_points", "bin"), ("image_02", "png"), ("image_03", "png")]
        for folder, extension in pieces:
            target = args.out / day / f"{drive}_sync" / folder / "data" / f"{frame}.{extension}"
            target.parent.mkdir(parents=True, exist_ok=True)
            os.link(drive_there / folder / "data" / f"{scan.stem}.{extension}", target)
    for calibration in args.world.glob("*/calib*.txt"):
        os.link(calibration, args.out / calibration.parent.name / calibration.name)
    print(f"{len(ids)} frames below {args.out}")


if __name__ == "__main__":
    main()
