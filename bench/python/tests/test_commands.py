"""The console script: the code of the binaries."""

import os
import signal
import subprocess
import sys
import time

import pytest

import strat
from conftest import command


def test_help_and_exit_codes():
    assert "Usage: strat bench" in command("bench", "--help").stdout
    assert "Usage: strat prep synth" in command("prep", "synth", "--help").stdout
    assert command("--version").stdout == f"strat {strat.__version__}\n"
    assert "strat prep" in command("--help").stdout
    assert "strat prep" in command(code=2).stderr
    assert "no such folder" in command("bench", "--table", "3.3", "--data", "none", "--out", "x", code=2).stderr
    assert "cargo install --locked --path train" in command("train", code=2).stderr
    assert "there is no command `fly`" in command("fly", code=2).stderr


def test_the_script_is_installed():
    script = os.path.join(os.path.dirname(sys.executable), "strat")
    if not os.path.exists(script):
        pytest.skip("the package is not installed into this Python's own folder")
    done = subprocess.run([script, "bench", "protocols"], capture_output=True, text=True)
    assert done.returncode == 0 and "eigen-80" in done.stdout


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_ctrl_c_ends_the_command(tmp_path):
    line = [sys.executable, "-m", "strat", "prep", "synth", "--preset", "full", "--out", tmp_path / "world"]
    process = subprocess.Popen(line, stderr=subprocess.PIPE, text=True)
    # Its first file says that the work has begun.
    while process.poll() is None and not any(tmp_path.glob("world/*")):
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == -signal.SIGINT
