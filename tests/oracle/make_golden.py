#!/usr/bin/env python3
"""Makes the golden values that the workspace's unit tests hold, as JSON: name to list of numbers.

    python3 tests/oracle/make_golden.py                 all of them
    python3 tests/oracle/make_golden.py train/sampler   one of them

A test names its recipe as `make_golden.py train/sampler`; the test `golden` runs this program and looks
for each number among those of the file that names it. Inputs are closed formulas, the same here
and in the test. A recipe whose package is not installed is left out: see requirements.txt.
"""

import csv
import hashlib
import json
import pathlib
import sys

import numpy as np

import alignment
import evaluation
import geometry
import inference
import training

ROOT = pathlib.Path(__file__).resolve().parents[2]
RECIPES = {}


def recipe(name):
    """Registers a function that returns numbers (or text) in any nesting."""

    def register(function):
        RECIPES[name] = function
        return function

    return register


# Evaluation: one image of 1242x375 and two network outputs of 512x256.


def network_outputs():
    y, x = np.mgrid[0:256, 0:512].astype(float)
    near = np.maximum(y - 90, 0) / 165
    plain = 0.0012 + 0.062 * near + 0.0006 * np.sin(x / 17) * np.cos(y / 11)
    mirrored = 0.0012 + 0.060 * near + 0.0006 * np.sin((511 - x) / 19) * np.cos(y / 13)
    return plain.astype(np.float32), mirrored.astype(np.float32)


def truth():
    """(disparity in pixels, depth in metres), 0 where nothing is measured."""
    y, x = np.mgrid[0:375, 0:1242]
    disparity = np.floor((5 + 76 * (y - 120.0) / 255 + 2 * np.sin(x / 40)) * 256) / 256
    disparity = np.where((y > 120) & ((x * 7 + y * 13) % 5 == 0), disparity, 0).astype(np.float32)
    with np.errstate(divide="ignore"):
        depth = np.where(disparity > 0, np.float32(384.38148) / disparity + np.float32(0.27), 0)
    return disparity, depth


def relative_maps():
    """Inverse depth and depth of the truth in no unit, each with a wobble; some inverse depth is 0."""
    y, x = np.mgrid[0:375, 0:1242].astype(float)
    smooth = 384.38148 / (5 + 76 * np.maximum(y - 120, 0) / 255)
    wobble = 1 + 0.06 * np.sin(x / 29) * np.cos(y / 19)
    inverse = (250 * wobble / smooth + 9).astype(np.float32)
    inverse[210:214, 400:410] = 0
    return inverse, (0.02 * smooth * wobble + 0.3).astype(np.float32)


@recipe("align/image")
def _():
    """Seven metrics, five further ones, scale and shift of each case."""
    inverse, depth = relative_maps()
    _, true = truth()
    cases = [
        ("affine-disparity", inverse, "eigen", 1e-5, 80, True),
        ("affine-depth", depth, "eigen", 1e-5, 80, True),
        ("scale-disparity", inverse, "garg", 1e-3, 80, False),
        ("scale-depth", depth, "garg", 1e-3, 50, False),
        ("median", depth, None, 1e-3, 80, False),
    ]
    return [alignment.evaluate(kind, true, made, *rules) for kind, made, *rules in cases]


@recipe("align/models")
def _():
    """The same for models of three kinds under each alignment that fits them, in four settings."""
    y, x = np.mgrid[0:375, 0:1242].astype(float)
    road = np.where(y > 130, 900 / np.maximum(y - 118, 1), 75) + 1.5 * np.sin(x / 60)
    seen = (y > 120) & ((x * 7 + y * 13) % 5 == 0)
    true = np.where(seen, np.round(256 * road) / 256, 0).astype(np.float32)
    wobble = 1 + 0.08 * np.sin(x / 23) * np.cos(y / 17)
    inverse = (340 * wobble / road + 12).astype(np.float32)
    inverse[200:204, 300:310] = 0
    depth = (0.013 * road * wobble + 0.21).astype(np.float32)
    metric = (0.93 * road * wobble).astype(np.float32)
    settings = [("garg", 1e-3, 80, False), ("garg", 1e-3, 50, False), ("eigen", 1e-5, 80, True), (None, 1e-3, 80, False)]
    models = [
        ("none", metric),
        ("median", metric),
        ("scale-depth", metric),
        ("affine-depth", depth),
        ("affine-disparity", inverse),
        ("scale-disparity", inverse),
    ]
    return [alignment.evaluate(kind, true, made, *rules) for kind, made in models for rules in settings]


@recipe("metrics/eigen")
def _():
    (plain, _), (_, depth), camera = network_outputs(), truth(), (721.5377, 0.532_725_428)
    return [
        evaluation.eigen(depth, plain, camera),
        evaluation.eigen(depth, plain, camera, far=50.0),
        evaluation.eigen(depth, plain, camera, near=1.0, far=50.0),
        evaluation.eigen(depth, plain, camera, median=True),
        evaluation.eigen(depth, plain, camera, crop=None),
        # Pixels scored with the Garg crop and without.
        [int(((depth > 1e-3) & (depth < 80) & geometry.crop(c, 375, 1242)).sum()) for c in ("garg", None)],
    ]


@recipe("metrics/kitti")
def _():
    (plain, _), (disparity, _) = network_outputs(), truth()
    return [evaluation.kitti2015(disparity, plain), int((disparity > 0).sum())]


@recipe("metrics/logarithm")
def _():
    """Bits of the logarithms of numbers of all sizes, by steps that IEEE 754 defines to the bit."""
    index = np.arange(200_000)
    mantissa = (index.astype(np.uint64) * np.uint64(0x9E37_79B9_7F4A_7C15)) >> np.uint64(12)
    exponent = np.choose(index % 4, [1 + index % 2046, 1022, 1023, 1016 + index % 16])
    numbers = (exponent.astype(np.uint64) << np.uint64(52) | mantissa).view(float)
    fraction, power = np.frexp(numbers)  # from 1/2 to 1
    small = fraction < np.sqrt(0.5)
    f = np.where(small, 2 * fraction, fraction) - 1
    power = np.where(small, power - 1, power)
    s = f / (2 + f)
    fourth = (s * s) * (s * s)
    odd, even = np.zeros_like(s), np.zeros_like(s)
    for term in (9, 7, 5, 3, 1):
        odd = odd * fourth + 2 / (2 * term + 1)
    for term in (10, 8, 6, 4, 2):
        even = even * fourth + 2 / (2 * term + 1)
    series = fourth * even + (s * s) * odd
    half = 0.5 * f * f
    high, low = 0.6931467056274414, 4.7493250390316726e-07  # of ln 2
    found = power * high - ((half - (s * (half + series) + power * low)) - f)
    assert np.allclose(found, np.log(numbers), rtol=1e-15, atol=0)
    return fingerprint(found.view(np.uint64))


@recipe("metrics/groups")
def _():
    """For each group: root over all pixels, mean over images, pixels."""
    (plain, mirrored), (disparity, _) = network_outputs(), truth()
    y, x = np.mgrid[0:375, 0:1242]
    labels = (y // 5 + x // 7) % 34
    without = np.where((labels == 24) | (labels == 25), 0, labels)
    found = {name: [] for name in evaluation.GROUPS}
    for fraction, ids in ((plain, labels), (mirrored, without)):
        measured, true, depth, _, _ = evaluation.stereo_pixels(disparity, fraction)
        for name, at in evaluation.by_group(measured, ids):
            found[name].append((true[at] - depth[at]) ** 2)
    return [
        [
            float(np.sqrt(np.concatenate(images).mean())),
            float(np.mean([np.sqrt(squares.mean()) for squares in images])),
            sum(squares.size for squares in images),
        ]
        for images in found.values()
    ]


@recipe("metrics/flip")
def _():
    plain, mirrored = (plane.astype(float) for plane in network_outputs())
    return geometry.flip_blend(plain, mirrored)[200, [0, 30, 40, 256, 480, 511]]


# Paired tests.


@recipe("metrics/exact-p")
def _():
    ten = [0.5, -0.3, 1.2, 0.8, -0.1, 0.9, 0.4, 1.1, -0.6, 0.7]
    return [inference.sign_flips(ten), inference.wilcoxon_exact(ten)]


@recipe("metrics/wilcoxon-ties")
def _():
    ties = [0.5, -0.5, 0.5, 1.0, 1.0, 0.0, 2.0, -0.25, 3.0, 4.0, -1.0, 2.5]
    return [inference.wilcoxon_normal(ties)]


STEREO_2015 = [2, 6, 5, 4, 12, 9, 4, 7, 3, 3, 2, 8, 2, 10, 2, 2, 11, 7, 6, 10, 2, 3, 3, 5, 2, 1, 8, 2, 1]
STEREO_2015 += [2, 3, 1, 1, 6, 8, 4, 1, 3, 29]


@recipe("metrics/t")
def _():
    return [inference.student_t(degrees) for degrees in (1, 1.64, 2.5, 9, 27, 38.25)]


@recipe("metrics/degrees")
def _():
    """Four drives, the Eigen test, and the 29 drives and ten runs of stereo 2015."""
    drives = ([3, 5, 2, 9], [25] * 27 + [22], STEREO_2015)
    return [inference.degrees_of_freedom(images) for images in drives]


@recipe("metrics/intervals")
def _():
    sums, images = [0.31, 0.64, 0.18, 1.35], [3, 5, 2, 9]
    return [inference.interval(sums, images, kind) for kind in ("any", "positive", "fraction")]


@recipe("metrics/drives")
def _():
    """Nine drives of four images, the last with one: Abs Rel, accuracy, D1 in percent, pooled RMSE."""
    frames = [[(drive * 5 + frame * 3 % 7) / 100 for frame in range(4)] for drive in range(9)]
    frames[8] = frames[8][:1]
    images = [len(values) for values in frames]
    errors = [sum(values) for values in frames]
    pixels = [count * (50 + 10 * drive) for drive, count in enumerate(images)]
    accuracies = [count - error for count, error in zip(images, errors)]
    wrong = inference.interval([0.1 * error for error in errors], images, "fraction")
    squared = inference.interval([100 * error for error in errors], pixels, "positive")
    return [
        inference.interval(errors, images, "positive"),
        inference.interval(accuracies, images, "fraction"),
        [100 * bound for bound in wrong],
        [bound**0.5 for bound in squared],
    ]


@recipe("metrics/difference")
def _():
    """Two models over images 1 to 23, three a drive but two of the first."""
    drives = [[i for i in range(3 * drive, 3 * drive + 3) if i > 0] for drive in range(8)]
    sums = [sum(-0.01 + 0.002 * (i % 5) for i in drive) for drive in drives]
    return inference.interval(sums, [len(drive) for drive in drives], "any")


@recipe("metrics/study")
def _():
    """Three seeds of one variant and four of another over eleven images of four drives."""
    drives = [0, 0, 0, 1, 1, 2, 2, 2, 2, 3, 3]

    def value(seed, image, gain):
        drive = drives[image]
        plain = 20 + 3 * drive + image * 7 % 5 + seed * 5 % 7
        return (plain + gain * (1 + drive + seed * (image + drive) % 3)) / 100

    def sums(seeds, gain):
        table = np.zeros((seeds, 4))
        for seed in range(seeds):
            for image, drive in enumerate(drives):
                table[seed, drive] += value(seed + 1, image, gain)
        return table

    first, second = sums(3, 1.5), sums(4, -2.7)
    means = first.sum(1) / 11
    return [means.mean(), means.std(ddof=1)] + inference.study(first, second, [3, 2, 4, 2])


# Splits.


@recipe("splits/validation")
def _():
    """SHA-256 of the validation frames of both splits, one a line."""
    with open(ROOT / "splits/data/drives.csv", newline="") as file:
        drives = list(csv.DictReader(file))
    found = []
    for split in ("kitti", "eigen"):
        lines = []
        for drive in drives:
            if drive[split] == "train":
                frames = [f"{drive['drive']}/{index:010}" for index in range(int(drive["frames"]))]
                drawn = sorted(frames, key=lambda frame: hashlib.sha256(frame.encode()).hexdigest())[:10]
                lines += sorted(drawn)
        text = "".join(f"{line}\n" for line in lines)
        found.append(hashlib.sha256(text.encode()).hexdigest())
    return found


@recipe("store/shard")
def _():
    """Which of eight shards two images belong to: BLAKE3, first eight bytes, modulo 8."""
    import blake3

    ids = ["kitti2015/000006", "2011_09_26_drive_0001/0000000005"]
    return [int.from_bytes(blake3.blake3(i.encode()).digest()[:8], "little") % 8 for i in ids]


# Resizing.


def picture(width, height):
    y, x, c = np.mgrid[0:height, 0:width, 0:3]
    return ((31 * x + 17 * y + 71 * c + x * y % 97 * 3) % 256).astype(np.uint8)


def fingerprint(values):
    """Sum of value times 1-based index, modulo 2^64."""
    values = np.asarray(values, np.uint64).ravel()
    return int(np.sum(values * np.arange(1, values.size + 1, dtype=np.uint64), dtype=np.uint64))


def bits(plane):
    return np.ascontiguousarray(plane, np.float32).view(np.uint32)


PLANE = picture(61, 37)[:, :, 0].astype(np.float32) / 256


@recipe("store/area")
def _():
    small = geometry.area(PLANE, 17, 20)
    return [small.sum(), small[3, 5], small[-1, -1]]


@recipe("store/bilinear")
def _():
    return [fingerprint(bits(geometry.bilinear(PLANE, *size))) for size in ((150, 90), (17, 20), (7, 90))]


@recipe("store/interpolate")
def _():
    """For cubic, cubic with corners and linear with corners, at two sizes: the sum, and three values."""
    found = []
    for cubic, corners in ((True, False), (True, True), (False, True)):
        for size in ((150, 90), (17, 20)):
            other = geometry.interpolate(PLANE, *size, cubic, corners)
            found += [other.sum(), other[0, 0], other[3, 5], other[-1, -2]]
    return found


@recipe("store/cubic-bytes")
def _():
    """OpenCV itself."""
    import cv2

    image = picture(11, 7)
    sizes = ((16, 9), (5, 4))
    return [cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)[:, :, 1] for size in sizes]


@recipe("store/bicubic-bytes")
def _():
    """Pillow 11 itself."""
    import PIL
    from PIL import Image

    if int(PIL.__version__.split(".")[0]) > 11:
        raise ModuleNotFoundError("Pillow 11 is not there")
    cases = [((1242, 375), (512, 256)), ((61, 37), (150, 90)), ((61, 37), (17, 90))]
    return bytes_of(lambda image, size: Image.fromarray(image).resize(size, Image.BICUBIC), cases)


def bytes_of(resize, cases):
    """For each (source, target): a fingerprint of all bytes, and the pixel in row 3, column 5."""
    found = []
    for source, target in cases:
        other = np.asarray(resize(picture(*source), target))
        found += [fingerprint(other), other[3, 5]]
    return found


@recipe("store/area-bytes")
def _():
    """OpenCV itself."""
    import cv2

    cases = [
        ((1242, 375), (512, 256)),
        ((1224, 370), (512, 256)),
        ((120, 80), (60, 40)),
        ((120, 80), (40, 20)),
        ((61, 37), (17, 36)),
        ((100, 50), (99, 50)),
    ]
    return bytes_of(lambda image, size: cv2.resize(image, size, interpolation=cv2.INTER_AREA), cases)


@recipe("store/lanczos-bytes")
def _():
    """Pillow 11 itself; later ones may take the two directions in another order."""
    import PIL
    from PIL import Image

    if int(PIL.__version__.split(".")[0]) > 11:
        raise ModuleNotFoundError("Pillow 11 is not there")
    cases = [
        ((1242, 375), (512, 256)),
        ((1224, 370), (640, 192)),
        ((61, 37), (150, 90)),
        ((120, 80), (60, 40)),
        ((100, 50), (99, 50)),
        ((100, 50), (100, 33)),
        ((61, 37), (17, 90)),
        ((7, 300), (300, 7)),
    ]
    return bytes_of(lambda image, size: Image.fromarray(image).resize(size, Image.LANCZOS), cases)


# What models want as input (PROTOCOL 10.5), on a network that sums the channels with these weights.

IMAGENET = ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225))


def channel_sum(grey, top=255.0, mean=(0, 0, 0), std=(1, 1, 1)):
    return ((grey / top - np.array(mean)) / np.array(std)) @ np.array([0.5, 0.25, 0.125]) + 0.5


def bytes_by(resize, image, *rest):
    """An image resized channel by channel, rounded to grey levels."""
    planes = [resize(image[:, :, c].astype(np.float64), *rest) for c in range(3)]
    return np.clip(np.rint(np.stack(planes, axis=-1)), 0, 255)


def linear(plane, width, height, corners=False):
    return geometry.interpolate(plane, width, height, False, corners)


def cubic(plane, width, height, corners=False):
    return geometry.interpolate(plane, width, height, True, corners)


@recipe("bench/input-forms")
def _():
    small, kitti = picture(31, 18), picture(1242, 375)
    relu = lambda plane: np.maximum(plane, 0)
    found = []

    def add(plane):
        found.extend([plane.sum(), plane[2, 3], plane[-1, -1]])

    stretched = bytes_by(linear, small, 16, 12)
    # Fixed size, stretched; the same from NHWC in 0..255; half precision and rank 3; bytes and rank 2.
    add(linear(channel_sum(stretched), 31, 18))
    add(linear(channel_sum(stretched, top=1.0), 31, 18))
    add(linear(channel_sum(stretched), 31, 18))
    add(linear(np.floor(channel_sum(stretched, top=1.0).clip(0, 255)), 31, 18))
    # Dynamic size as Depth Anything's: factor 14 / 18, 21 x 14; back with corners, with edges, by cubic.
    dynamic = relu(channel_sum(bytes_by(cubic, small, 21, 14), 255.0, *IMAGENET))
    add(linear(dynamic, 31, 18, True))
    add(linear(dynamic, 31, 18))
    add(cubic(dynamic, 31, 18))
    # KITTI-benchmark crop to 76 x 22, put back.
    crop = kitti[23:375, 13:1229]
    whole = np.zeros((375, 1242))
    whole[23:375, 13:1229] = linear(channel_sum(bytes_by(geometry.area, crop, 76, 22)), 1216, 352)
    add(whole)
    # Depth for a focal length of 1000 px; that of the image is 721.5 px at 31 columns.
    add(linear(channel_sum(stretched), 31, 18) * 721.5 * 16 / 31 / 1000)
    # Padded: scale 20 / 31, 20 x 11 in the middle of 20 x 16; the padding is cut off.
    add(linear(channel_sum(bytes_by(linear, small, 20, 11)), 31, 18))
    return found


# Depth of scans.


@recipe("geometry/scan")
def _():
    """For two sizes and both axes: pixels with a depth, fingerprint of the values' bits."""
    camera = {
        "R_rect_00": [0.99992, 0.00984, -0.00745, -0.00987, 0.99994, -0.00428, 0.00740, 0.00435, 0.99996],
        "P_rect_02": [721.5377, 0, 609.5593, 44.85728, 0, 721.5377, 172.854, 0.2163791, 0, 0, 1, 0.002745884],
    }
    scanner = {
        "R": [7.533745e-03, -9.999714e-01, -6.166020e-04, 1.480249e-02, 7.280733e-04, -9.998902e-01]
        + [9.998621e-01, 7.523790e-03, 1.480755e-02],
        "T": [-4.069766e-03, -7.631618e-02, -2.717806e-01],
    }
    camera, scanner = ({key: np.array(v) for key, v in file.items()} for file in (camera, scanner))
    matrix = geometry.scanner_to_image(camera, scanner)
    small = matrix / np.array([[20.0], [20.0], [1.0]])
    i = np.arange(40_000)
    points = np.stack(
        [(i * 37 % 640 - 40) / 8, (i * 101 % 1601 - 800) / 16, (i * 53 % 257 - 192) / 64, 0.5 + 0 * i], axis=1
    ).astype(np.float32)
    found = []
    for projection, width, height in ((matrix, 1242, 375), (small, 62, 18)):
        for axis in ("velodyne", "camera"):
            depth = geometry.scan_depth(points, projection, width, height, axis)
            found.append([int((depth > 0).sum()), fingerprint(bits(depth))])
    return found


# Training.


@recipe("train/sampler")
def _():
    y, x, c = np.mgrid[0:4, 0:6, 0:2]
    source = 0.5 + 0.5 * np.sin(0.7 * x + 1.3 * y + 2.1 * c)
    y, x = np.mgrid[0:4, 0:6]
    return training.sample(source, 0.45 * np.sin(1.1 * x - 0.6 * y)).transpose(2, 0, 1)


@recipe("train/dssim")
def _():
    y, x, c = np.mgrid[0:5, 0:6, 0:3]
    a = 0.5 + 0.4 * np.sin(0.9 * x + 0.4 * y + c)
    b = 0.5 + 0.4 * np.sin(0.9 * x + 0.5 * y + 1.2 * c + 0.3)
    return training.dssim(a, b).transpose(2, 0, 1)


@recipe("train/losses")
def _():
    """Eight terms in the order ssim, l1, left-right, smoothness (left, right); both totals."""
    y, x, c = np.mgrid[0:32, 0:64, 0:3]

    def image(phase):
        wave = np.sin(0.35 * x + 0.2 * y + c + phase)
        return 0.5 + 0.3 * wave + 0.1 * np.cos(0.15 * x * (c + 1) - 0.4 * y)

    disparities = []
    for power in range(4):
        v, u = np.mgrid[0 : 32 >> power, 0 : 64 >> power]
        planes = [0.04 + 0.03 * np.sin(0.5 * u * 2**power / 4 + 0.3 * v + side) for side in (0, 1)]
        disparities.append(planes)
    sums = training.terms(image(0.0), image(0.8), disparities)
    names = ("ssim", "l1", "left_right", "smoothness")
    return [
        *(sums[name, view] for name in names for view in ("left", "right")),
        training.total(sums, ssim=0.85, l1=0.15, left_right=1.0, smoothness=0.1),
        training.total(sums, ssim=1.0, l1=0.1, left_right=1.0, smoothness=0.0),
    ]


@recipe("train/schedule")
def _():
    return [
        [training.baseline(e) for e in (0, 1, 25, 49)],
        [training.baseline(e, 12, 0.2) for e in (0, 3, 11)],
        [training.learning_rate(p) for p in (0.0, 24.99, 25.0, 37.5, 49.0, 49.5, 50.0)],
    ]


def flat(values):
    """Numbers and texts of any nesting as one list."""
    if isinstance(values, (list, tuple, np.ndarray)):
        return [number for value in values for number in flat(value)]
    return [values.item() if isinstance(values, np.generic) else values]


def main(names):
    found = {}
    for name in names or RECIPES:
        try:
            found[name] = flat(RECIPES[name]())
        except ModuleNotFoundError as missing:
            print(f"{name} is left out: {missing}", file=sys.stderr)
    json.dump(found, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main(sys.argv[1:])
