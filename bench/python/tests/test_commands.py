"""The console script: the code of the binaries."""

import os
import pathlib
import re
import signal
import struct
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
    assert "Usage: strat bench COMMAND" in command("bench", "--help").stdout
    assert "Usage: strat bench eval" in command("bench", "eval", "--help").stdout
    assert "Usage: strat prep synth" in command("prep", "synth", "--help").stdout
    assert command("--version").stdout == f"strat {strat.__version__}\n"
    assert "strat prep" in command("--help").stdout
    assert "strat prep" in command(code=2).stderr
    line = ["bench", "--table", "3.3", "--data", "none", "--median-baseline", "--out", "x"]
    assert "folder not found" in command(*line, code=2).stderr
    assert "cargo install --locked --path train" in command("train", code=2).stderr
    assert "unknown command `fly`" in command("fly", code=2).stderr


def test_the_script_is_installed():
    script = os.path.join(os.path.dirname(sys.executable), "strat")
    if not os.path.exists(script):
        pytest.skip("the package is not installed into this Python's own folder")
    done = subprocess.run([script, "bench", "protocols"], capture_output=True, text=True)
    assert done.returncode == 0 and "eigen-80" in done.stdout


def message(*fields):
    """Bytes of a protobuf message: numbers, and text, bytes or messages."""
    encoded = b""
    for field, value in fields:
        if isinstance(value, int):
            encoded += varint(field << 3) + varint(value)
        else:
            payload = value.encode() if isinstance(value, str) else value
            encoded += varint(field << 3 | 2) + varint(len(payload)) + payload
    return encoded


def varint(value):
    low, rest = value & 0x7F, value >> 7
    return bytes([low | 0x80]) + varint(rest) if rest else bytes([low])


def tensor_info(name, *sides):
    shape = message(*((1, message((1, side))) for side in sides))
    return message((1, name), (2, message((1, message((1, 1), (2, shape))))))


def write_model(path):
    """An ONNX model: a tenth of the mean of the three channels, as a fraction of the width."""
    axes = message((1, "axes"), (8, 1), (20, 7))
    mean = message((1, "image"), (2, "grey"), (4, "ReduceMean"), (5, axes))
    scaled = message((1, "grey"), (1, "tenth"), (2, "disparity"), (4, "Mul"))
    tenth = message((2, 1), (8, "tenth"), (9, struct.pack("<f", 0.1)))
    shapes = (11, tensor_info("image", 1, 3, 32, 64)), (12, tensor_info("disparity", 1, 1, 32, 64))
    graph = message((1, mean), (1, scaled), (2, "grey"), (5, tenth), *shapes)
    path.write_bytes(message((1, 8), (8, message((2, 13))), (7, graph)))
    description = "input: {width: 64, height: 32, range: 0..1}\noutput: {meaning: disparity_fraction}\n"
    path.with_suffix(".yaml").write_text(description)


def test_a_model_runs_in_a_process_that_python_starts(eigen, tmp_path):
    write_model(tmp_path / "grey.onnx")
    # A folder of the package's name where the command is typed is not the package.
    (tmp_path / "strat").mkdir()
    (tmp_path / "strat" / "__init__.py").write_text("raise ImportError")
    line = ["--table", "3.3", "--data", eigen, "--model", tmp_path / "grey.onnx", "--runtime", "embedded", "--quiet"]
    script = "from strat._commands import main; import os, sys; os.chdir(sys.argv.pop(1)); sys.exit(main())"
    line = [sys.executable, "-c", script, tmp_path, "bench", *line, "--out", tmp_path / "out"]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "grey" in done.stdout
    rows = strat.read_rows(tmp_path / "out" / "rows.csv").records()
    assert {row["provider"] for row in rows} == {"rten CPU"}


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
