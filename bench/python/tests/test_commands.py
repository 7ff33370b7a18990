"""The console script: the code of the binaries."""

import os
import pathlib
import re
import signal
import subprocess
import sys

import pytest

import strat
from conftest import command


README = pathlib.Path(__file__).parent.parent / "README.md"


def test_the_code_of_the_readme_is_python():
    fences = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.MULTILINE | re.DOTALL)
    assert len(fences) == 3
    for fence in fences:
        compile(fence, README, "exec")


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


INTERRUPTED = """
import os, signal
from strat import _commands

class Command:
    def run_command(*words):
        os.kill(os.getpid(), signal.SIGINT)

_commands._strat = Command
_commands.main(["bench"])
"""


@pytest.mark.skipif(os.name != "posix", reason="signals of Unix")
def test_ctrl_c_ends_a_command_at_once():
    done = subprocess.run([sys.executable, "-c", INTERRUPTED], capture_output=True, text=True)
    assert done.returncode == -signal.SIGINT, done.stderr
