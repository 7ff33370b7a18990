"""Cameras, depth images of scans, resizing, crops (PROTOCOL 1.1, 3.3, 3.5 to 3.7, 3.10)."""

import numpy as np

NOMINAL_BASELINE_M = 0.54
NOMINAL_FOCAL_PX = {1242: 721.5377, 1241: 718.856, 1224: 707.0493, 1238: 718.3351}
# Shares of the height and the width: top, bottom, left, right.
CROPS = {
    "garg": (0.40810811, 0.99189189, 0.03594771, 0.96405229),
    "eigen": (0.3324324, 0.91351351, 0.0359477, 0.96405229),
}


def stereo(cam_to_cam):
    """(focal length of camera 2 in pixels, baseline from camera 2 to camera 3 in metres)."""
    left, right = cam_to_cam["P_rect_02"], cam_to_cam["P_rect_03"]
    return float(left[0]), float(left[3] / left[0] - right[3] / right[0])


def scanner_to_image(cam_to_cam, velo_to_cam):
    """3x4 matrix that takes a scanner's point to (u w, v w, w) of camera 2."""
    placed = np.eye(4)
    placed[:3] = np.hstack([velo_to_cam["R"].reshape(3, 3), velo_to_cam["T"].reshape(3, 1)])
    rectified = np.eye(4)
    rectified[:3, :3] = cam_to_cam["R_rect_00"].reshape(3, 3)
    return cam_to_cam["P_rect_02"].reshape(3, 4) @ rectified @ placed


def scan_depth(points, matrix, width, height, axis):
    """Depth image of a scan as float32; `axis` is "velodyne" (the scanner's x) or "camera" (z)."""
    x, y, z = points[points[:, 0] >= 0, :3].astype(np.float64).T
    u, v, w = (row[0] * x + row[1] * y + row[2] * z + row[3] for row in matrix)
    with np.errstate(divide="ignore", invalid="ignore"):
        column, row = np.rint(u / w) - 1, np.rint(v / w) - 1
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row = column[inside].astype(int), row[inside].astype(int)
    depth = (x if axis == "velodyne" else w)[inside]
    image = np.zeros((height, width))
    image[row, column] = depth
    # The published key; it makes the last pixel of a row and the first of the next one group.
    key = row * (width - 1) + column - 1
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-2))
    if order.size:
        nearest = np.minimum.reduceat(depth[order], starts)
        members = np.diff(starts, append=order.size)
        first = order[starts][members > 1]
        image[row[first], column[first]] = nearest[members > 1]
    return np.maximum(image, 0).astype(np.float32)


def _neighbours(source, target):
    position = (np.arange(target) + 0.5) * (source / target) - 0.5
    low = np.floor(position)
    weight = np.where((low < 0) | (low >= source - 1), 0, position - low)
    low = np.clip(low, 0, source - 1).astype(int)
    return low, np.minimum(low + 1, source - 1), weight


def bilinear(plane, width, height):
    """OpenCV's INTER_LINEAR of [rows, columns], in the precision of the array."""
    left, right, across = _neighbours(plane.shape[1], width)
    upper, lower, down = _neighbours(plane.shape[0], height)
    across, down = across.astype(plane.dtype), down.astype(plane.dtype)[:, None]
    wide = plane[:, left] * (1 - across) + plane[:, right] * across
    return wide[upper] * (1 - down) + wide[lower] * down


def interpolate(plane, width, height, cubic, corners):
    """Linear or cubic (Keys, a = -0.75) without antialiasing, border repeated; float64.

    Pixels of two sizes share their outer edges, or with `corners` the centres of the corner pixels.
    """

    def weights(source, target):
        index = np.arange(target)
        position = (index + 0.5) * source / target - 0.5
        if corners:
            position = index * (source - 1) / max(target - 1, 1)
        low = np.floor(position).astype(int)
        shares = np.zeros((target, source))
        for tap in range(low.min() - 1, low.max() + 3):
            x = np.abs(position - tap)
            if cubic:
                a = -0.75
                near = (a + 2) * x**3 - (a + 3) * x**2 + 1
                far = a * x**3 - 5 * a * x**2 + 8 * a * x - 4 * a
                share = np.where(x <= 1, near, np.where(x < 2, far, 0))
            else:
                share = np.maximum(1 - x, 0)
            shares[index, np.clip(tap, 0, source - 1)] += share
        return shares

    return weights(plane.shape[0], height) @ plane.astype(np.float64) @ weights(plane.shape[1], width).T


def area(plane, width, height):
    """Mean over the source area of each pixel, borders by their share; float64."""

    def shares(source, target):
        edges = np.arange(target + 1) * (source / target)
        pixel = np.arange(source)
        overlap = np.minimum(edges[1:, None], pixel + 1) - np.maximum(edges[:-1, None], pixel)
        return np.maximum(overlap, 0) * (target / source)

    return shares(plane.shape[0], height) @ plane.astype(np.float64) @ shares(plane.shape[1], width).T


def crop(name, height, width):
    """True inside the crop; `None` is the whole image."""
    inside = np.ones((height, width), bool)
    if name is not None:
        top, bottom, left, right = CROPS[name]
        rows, columns = np.arange(height)[:, None], np.arange(width)
        inside = (rows >= int(top * height)) & (rows < int(bottom * height))
        inside = inside & (columns >= int(left * width)) & (columns < int(right * width))
    return inside


def flip_blend(plain, of_mirrored):
    """Disparity blended with that of the mirrored image, which is still mirrored here."""
    back = of_mirrored[:, ::-1]
    left = np.clip(2 - 20 * np.linspace(0, 1, plain.shape[1]), 0, 1)
    right = left[::-1]
    return right * plain + left * back + (1 - left - right) * (plain + back) / 2
