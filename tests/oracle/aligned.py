#!/usr/bin/env python3
"""What `bench` must find for models without a scale, computed from KITTI's own files (PROTOCOL 10).

    python3 tests/oracle/aligned.py DATA OUT

DATA/kitti_raw holds scans with their calibration; where there is no such folder, two frames of KITTI's
native size are made first. The camera's depth of each scan, rounded as KITTI depth rounds, stands for improved
ground truth: OUT/annotated, as `prep eigen --annotated` reads it. OUT has a folder of maps for each kind of
model, exact but for a known scale and shift, and OUT/expected.json a record for each row: kind, protocol,
image, and seven metrics, five further ones, scale and shift. The kind `network` has no maps: it is a network
that sees the benchmark's crop of an image, where that is a PNG, and gives the depth RED_M says. The test
`aligned` of strat-tests compares.
"""

import json
import pathlib
import struct
import sys
import zlib

import numpy as np

import alignment
import geometry
import inputs

CALIBRATION = {
    "calib_cam_to_cam.txt": """S_rect_02: 1242 375
R_rect_00: 1 0 0 0 1 0 0 0 1
P_rect_02: 721.5377 0 609.5593 44.85728 0 721.5377 172.854 0.2163791 0 0 1 0.002745884
S_rect_03: 1242 375
P_rect_03: 721.5377 0 609.5593 -339.5242 0 721.5377 172.854 2.199936 0 0 1 0.002729905
""",
    "calib_velo_to_cam.txt": "R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.08 -0.27\n",
}

# Scale and shift that bring the exact maps back.
DISPARITY, DEPTH = (0.02, 0.004), (3.0, 7.0)

# Metres of the network `network` for red from 0 to 1: a + b red.
RED_M = 2.0, 60.0

IMPROVED, CUT, PUT_BACK = "improved", "cut", "put back"
RULES = {  # truth as in the name; crop, near and far limit, habit of the benchmark's crop
    "eigen-improved-garg": ("garg", 1e-3, 80, IMPROVED),
    "eigen-kb-garg": ("garg", 1e-3, 80, PUT_BACK),
    "eigen-affine": ("eigen", 1e-5, 80, CUT),
}


def write_png(path, pixels):
    """8-bit RGB or 16-bit grey."""
    height, width = pixels.shape[:2]
    bits, colour = (8, 2) if pixels.ndim == 3 else (16, 0)
    lines = pixels.astype(f">u{bits // 8}").reshape(height, -1)
    data = b"".join(b"\0" + line.tobytes() for line in lines)

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(data, 1)) + chunk(b"IEND", b"")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def make_frames(raw, frames=(("2011_09_26_drive_0002", 54), ("2011_09_26_drive_0002", 69))):
    """Frames of one day before a street of closed form: ground 1.73 m below the scanner, walls, a far end."""
    day = raw / "2011_09_26"
    for name, number in frames:
        drive = day / f"{name}_sync"
        y, x = np.mgrid[0:375, 0:1242]
        picture = np.stack([x % 256, y % 256, (x + y + number) % 256], axis=2)
        for side in ("image_02", "image_03"):
            write_png(drive / side / "data" / f"{number:010}.png", picture)
        down, across = np.meshgrid(np.radians(np.linspace(-2, 24, 64)), np.radians(np.linspace(-42, 42, 841)))
        ahead = [np.cos(down) * np.cos(across), np.cos(down) * np.sin(across), -np.sin(down)]
        wall = 9 + 2 * np.sin(7 * across + number)
        with np.errstate(divide="ignore"):
            reach = np.minimum.reduce(
                [1.73 / np.maximum(np.sin(down), 1e-9), wall / np.abs(ahead[1]), 75 / ahead[0]]
            )
        points = np.stack([*(reach * part for part in ahead), np.full_like(reach, 0.3)], axis=-1)
        path = drive / "velodyne_points" / "data" / f"{number:010}.bin"
        path.parent.mkdir(parents=True, exist_ok=True)
        points.reshape(-1, 4).astype("<f4").tofile(path)
    for name, text in CALIBRATION.items():
        (day / name).write_text(text)


def improved(raw, scan):
    """Metres as float32 in steps of 1/256; 0 where nothing was measured."""
    day = scan.parents[3]
    camera = inputs.calibration(day / "calib_cam_to_cam.txt")
    matrix = geometry.scanner_to_image(camera, inputs.calibration(day / "calib_velo_to_cam.txt"))
    width, height = (int(number) for number in camera["S_rect_02"])
    depth = geometry.scan_depth(inputs.scan(scan), matrix, width, height, "camera")
    return (np.rint(depth.astype(np.float64) * 256) / 256).astype(np.float32)


def maps(true):
    """The kinds of models: meaning, crop and map; where nothing is measured stands 30 m."""
    depth = np.where(true > 0, true, 30).astype(np.float64)
    inverse = ((1 / depth - DISPARITY[1]) / DISPARITY[0]).astype("<f4")
    return {
        "inverse": ("inverse_depth", "none", inverse),
        "cut": ("inverse_depth", "kitti-benchmark", inverse[alignment.benchmark_crop(*true.shape)]),
        "depth": ("depth", "none", ((depth - DEPTH[1]) / DEPTH[0]).astype("<f4")),
        "metric": ("depth_m", "none", (0.93 * depth).astype("<f4")),
    }


def cases(kind):
    """(protocol, rules, alignment) that fit a kind of model."""
    ending = "depth" if kind in ("depth", "metric", "network") else "disparity"
    is_cut = kind in ("cut", "network")
    named = ["eigen-kb-garg"] if is_cut else ["eigen-improved-garg", "eigen-kb-garg"]
    yield f"eigen-affine-{ending}", RULES["eigen-affine"], f"affine-{ending}"
    if kind == "metric":
        yield "eigen-affine-disparity", RULES["eigen-affine"], "affine-disparity"
    for name in named:
        if kind in ("metric", "network"):
            yield name, RULES[name], "none"
        for one in (f"scale-{ending}", f"affine-{ending}"):
            yield f"{name}-{one}", RULES[name], one
        if kind == "inverse":
            yield f"{name}-median", RULES[name], "median"


def expected(kind, true, made, rules, how):
    crop, near, far, habit = rules
    if kind in ("cut", "network"):  # back to its place
        whole = np.zeros(true.shape)
        whole[alignment.benchmark_crop(*true.shape)] = made
        made = whole
    made = made.astype(np.float64)
    if kind == "metric" and how.endswith("disparity") or kind == "inverse" and how == "median":
        made = 1 / made
    return alignment.evaluate(how, true, made, crop, near, far, cut=habit == CUT)


def main(data, out):
    raw = data / "kitti_raw"
    if not raw.is_dir():
        make_frames(raw)
    records = []
    for scan in sorted(raw.glob("*/*_sync/velodyne_points/data/*.bin")):
        if not (scan.parents[3] / "calib_velo_to_cam.txt").is_file():
            continue
        drive, frame = scan.parents[2].name.removesuffix("_sync"), scan.stem
        true = improved(raw, scan)
        folder = out / "annotated" / "val" / f"{drive}_sync" / "proj_depth" / "groundtruth" / "image_02"
        write_png(folder / f"{frame}.png", np.rint(true * 256))
        kinds = maps(true)
        for kind, (meaning, crop, made) in kinds.items():
            folder = out / kind
            folder.mkdir(exist_ok=True)
            np.save(folder / f"{drive}_{frame}.npy", made)
            (folder / "predictions.yaml").write_text(f"meaning: {meaning}\ncrop: {crop}\n")
        picture = scan.parents[2] / "image_02" / "data" / f"{frame}.png"
        if picture.is_file():
            red = inputs.png(picture)[alignment.benchmark_crop(*true.shape)][:, :, 0]
            made = np.float32(RED_M[0]) + np.float32(RED_M[1]) * (red.astype(np.float32) / np.float32(255))
            kinds["network"] = ("depth_m", "kitti-benchmark", made)
        for kind, (_, _, made) in kinds.items():
            for protocol, rules, how in cases(kind):
                values = expected(kind, true, made, rules, how)
                if how == "none":
                    values = [*values[:-2], None, None]
                records.append([kind, protocol, f"{drive}/{frame}", values])
    (out / "expected.json").write_text(json.dumps(records))


if __name__ == "__main__":
    main(*map(pathlib.Path, sys.argv[1:]))
