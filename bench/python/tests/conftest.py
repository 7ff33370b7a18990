"""A rendered world, prepared once by the commands of the package."""

import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

import strat


def command(*words, code=0):
    """Runs the console script in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-m", "strat", *map(str, words)], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == code, done.stderr
    return done


def needs(word, reason):
    """Skips, or fails where STRAT_REQUIRE names what is lacking."""
    if word in os.environ.get("STRAT_REQUIRE", "").split(","):
        pytest.fail(f"STRAT_REQUIRE names `{word}`: {reason}")
    pytest.skip(f"needs {word}: {reason}")


def pytest_terminal_summary(terminalreporter):
    """The lines that `.ci/run` gathers."""
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2].removeprefix("Skipped: ")
        terminalreporter.write_line(f"could not run: strat-python {report.nodeid}: {reason}")


def prepare(data, out):
    """Both splits of KITTI's layouts below ``data``."""
    raw, stereo = data / "kitti_raw", data / "kitti2015"
    part = ["--allow-missing", "--quiet"]
    command("prep", "eigen", "--raw", raw, "--out", out / "eigen", *part)
    labels = ["--semantics", stereo] if (stereo / "training/semantic").is_dir() else []
    command("prep", "kitti", "--raw", raw, "--stereo2015", stereo, *labels, "--out", out / "kitti", *part)
    return out


@pytest.fixture(scope="session")
def sets(tmp_path_factory):
    """Folder with the sets ``eigen`` and ``kitti`` of rendered frames."""
    folder = tmp_path_factory.mktemp("rendered")
    command("prep", "synth", "--preset", "tiny", "--out", folder / "world", "--quiet")
    return prepare(folder / "world", folder)


@pytest.fixture(scope="session")
def real_sets(tmp_path_factory):
    """The same of real frames of KITTI."""
    samples = os.environ.get("STRAT_KITTI_SAMPLES")
    if not samples:
        needs("kitti", "STRAT_KITTI_SAMPLES names no folder with real KITTI frames")
    return prepare(pathlib.Path(samples), tmp_path_factory.mktemp("real"))


def disparity(image, seed=0, size=(48, 160)):
    """A network: disparity as a fraction of the width by a closed formula of place and image."""
    rows, columns = np.mgrid[0 : size[0], 0 : size[1]]
    shade = image[:: max(1, image.shape[0] // 7), :: max(1, image.shape[1] // 7)].mean() / 255
    wave = 0.004 * np.sin(columns / 9 + seed + 5 * shade)
    return (0.01 + 0.09 * (rows / size[0]) ** 2 + wave).astype(np.float32)


@pytest.fixture
def eigen(sets):
    return sets / "eigen"


@pytest.fixture
def truths(eigen):
    """The test samples of the Eigen set with their ground truth."""
    return list(strat.PreparedSet(eigen).test)
