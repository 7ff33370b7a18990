"""KITTI's files as arrays: PNG, calibration, Velodyne scans (PROTOCOL 1.1 and 1.2)."""

import struct
import zlib

import numpy as np

CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}


def png(path):
    """An uncoloured or RGB PNG without palette and interlace: [rows, columns(, channels)]."""
    data = path.read_bytes()
    if data[:8] != b"\x89PNG\r\n\x1a\n":
        raise ValueError(f"{path} is no PNG")
    chunks, at = {}, 8
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        chunks.setdefault(data[at + 4 : at + 8], []).append(data[at + 8 : at + 8 + length])
        at += 12 + length
    width, height, bits, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[b"IHDR"][0])
    if interlaced or bits not in (8, 16) or colour not in CHANNELS:
        raise ValueError(f"{path} has a form that this reader does not know")
    channels = CHANNELS[colour]
    lines = _unfilter(
        zlib.decompress(b"".join(chunks[b"IDAT"])), height, width * channels * bits // 8, channels * bits // 8
    )
    pixels = np.frombuffer(lines, np.dtype(f">u{bits // 8}")).reshape(height, width, channels)
    pixels = pixels.astype(f"u{bits // 8}")
    return pixels[:, :, 0] if channels == 1 else pixels


def _unfilter(packed, height, length, step):
    """Undoes the filter of each line; `step` bytes make a pixel."""
    done, above = bytearray(), bytes(length)
    for row in range(height):
        start = row * (length + 1)
        kind, line = packed[start], bytearray(packed[start + 1 : start + 1 + length])
        if kind == 1:
            line = np.frombuffer(line, np.uint8).reshape(-1, step).cumsum(axis=0, dtype=np.uint8).tobytes()
        elif kind == 2:
            line = (np.frombuffer(line, np.uint8) + np.frombuffer(above, np.uint8)).tobytes()
        elif kind == 3:
            for i in range(length):
                left = line[i - step] if i >= step else 0
                line[i] = (line[i] + (left + above[i]) // 2) & 255
        elif kind == 4:
            for i in range(length):
                left, corner = (line[i - step], above[i - step]) if i >= step else (0, 0)
                up = above[i]
                away = (abs(up - corner), abs(left - corner), abs(left + up - 2 * corner))
                nearest = (left, up, corner)[away.index(min(away))]
                line[i] = (line[i] + nearest) & 255
        done += line
        above = bytes(line)
    return bytes(done)


def disparity_px(path):
    """A disparity map of stereo 2015: pixels as float32, 0 where nothing was measured."""
    return png(path).astype(np.float32) / np.float32(256)


def calibration(path):
    """Key to numbers. Lines with anything that is no number are left out."""
    found = {}
    for line in path.read_text().splitlines():
        key, _, values = line.partition(":")
        try:
            found[key.strip()] = np.array([float(word) for word in values.split()])
        except ValueError:
            continue
    return found


def scan(path):
    """Points of a scan: [points, 4] of x forward, y left, z up (metres) and reflectance."""
    return np.fromfile(path, "<f4").reshape(-1, 4)
