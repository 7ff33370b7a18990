"""The example, where torch is installed."""

import importlib.util
import pathlib

import numpy as np
import pytest

import strat

EXAMPLE = pathlib.Path(__file__).parent.parent / "examples" / "validate_pytorch.py"


def test_a_network_of_pytorch_is_validated_each_epoch(eigen, capsys):
    pytest.importorskip("torch", reason="torch is not installed")
    spec = importlib.util.spec_from_file_location("validate_pytorch", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    run = example.main(eigen, epochs=1)
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["epoch 0", "epoch 1"]
    assert not run.missing and "example@1" in run.table()


def test_tensors_are_arrays():
    torch = pytest.importorskip("torch", reason="torch is not installed")
    truth = np.full((20, 60), 20, dtype=np.float32)
    for kind in (torch.float32, torch.float16, torch.bfloat16):
        tensor = torch.full((20, 60), 16.0, dtype=kind, requires_grad=True)
        score = strat.evaluate(tensor, truth, protocol="eigen-80-nocrop", meaning="depth_m")
        assert score["abs_rel"] == pytest.approx(0.2)
