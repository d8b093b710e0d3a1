"""`model convert` and `model info`."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pytest

from handfit_core.errors import HandModelError, OptionError, OutputError
from handfit_core.hand_model import load_model, load_model_npz, save_model_npz
from handfit_core.hand_model.commands import add_model_commands
from handfit_core.hand_model.mano_pickle import load_mano_pickle
from tests.imitation_mano import imitation_arrays, imitation_model, write_mano_pickle


def run(*arguments: str | Path) -> int:
    parser = argparse.ArgumentParser()
    add_model_commands(parser.add_subparsers(required=True))
    args = parser.parse_args(["model", *map(str, arguments)])
    return args.handler(args)


def test_convert(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_mano_pickle(tmp_path / "MANO_LEFT.pkl", imitation_arrays("left", left_fault=True))
    target = tmp_path / "new" / "MANO_LEFT.npz"
    assert run("convert", source, target) == 0
    out = capsys.readouterr().out
    assert out == f"{target}: left hand, 778 vertices\n"
    converted, original = load_model_npz(target), load_mano_pickle(source)
    assert (converted.side, converted.name) == ("left", "MANO_LEFT")
    assert converted.digest == original.digest
    np.testing.assert_allclose(converted.shapedirs, original.shapedirs, atol=1e-8)
    assert load_model(target.parent, "left").side == "left"


def test_convert_refuses_other_targets(tmp_path: Path) -> None:
    source = write_mano_pickle(tmp_path / "MANO_RIGHT.pkl", imitation_arrays())
    with pytest.raises(OptionError, match=r"ends in \.npz"):
        run("convert", source, tmp_path / "out.pkl")
    with pytest.raises(OutputError, match="cannot write here"):
        run("convert", source, source / "out.npz")


@pytest.mark.parametrize("command", [("convert", "out.npz"), ("info",)])
def test_bad_sources_are_one_line(tmp_path: Path, command: tuple[str, ...]) -> None:
    damaged = tmp_path / "damaged.pkl"
    damaged.write_bytes(b"nothing")
    for source in (tmp_path / "nowhere.pkl", tmp_path, damaged):
        with pytest.raises(HandModelError) as caught:
            run(command[0], source, *(tmp_path / name for name in command[1:]))
        assert str(source) in str(caught.value)
        assert "\n" not in str(caught.value)
    assert not (tmp_path / "out.npz").exists()


@pytest.mark.parametrize("suffix", [".npz", ".pkl"])
def test_info(tmp_path: Path, capsys: pytest.CaptureFixture[str], suffix: str) -> None:
    path = tmp_path / f"hand{suffix}"
    if suffix == ".npz":
        save_model_npz(imitation_model(), path)
        expected = load_model_npz(path)
    else:
        write_mano_pickle(path, imitation_arrays())
        expected = load_mano_pickle(path)
    assert run("info", path) == 0
    lines = {line.split()[0]: line.split()[1:] for line in capsys.readouterr().out.splitlines()}
    assert lines["side"] == ["right"]
    assert lines["vertices"] == ["778"]
    assert lines["digest"] == [expected.digest]
    joints = expected.shaped().joints * 1000
    middle = [float(length) for length in lines["middle"]]
    assert middle[0] == pytest.approx(np.linalg.norm(joints[4] - joints[0]), abs=0.06)
    assert middle[2] == pytest.approx(np.linalg.norm(joints[6] - joints[5]), abs=0.06)
    tip = expected.v_template[444] * 1000
    assert middle[3] == pytest.approx(np.linalg.norm(tip - joints[6]), abs=0.06)


def test_info_of_the_open_hand(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("info", "open-hand") == 0
    out = capsys.readouterr().out
    assert out.count("side ") == 2
    assert out.index("left") < out.index("right")
