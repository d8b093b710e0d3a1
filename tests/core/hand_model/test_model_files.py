"""Hand models from anywhere, read or refused in one sentence; `model convert` and `info`."""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from handfit_core.common.errors import HandModelError, OptionError, OutputError
from handfit_core.hand_model import load_model, load_model_npz, save_model_npz
from handfit_core.hand_model.commands import add_model_commands
from handfit_core.hand_model.mano_pickle import load_mano_pickle
from tests.imitation_mano import imitation_arrays, write_mano_pickle


def message_of(model: str | Path) -> str:
    with pytest.raises(HandModelError) as caught:
        load_model(model, "right")
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 700
    return message


def edited(path: Path, **changes: Any) -> Path:
    """A model's file with header fields or arrays changed; None drops an array, and new names add one."""
    save_model_npz(load_model(None, "right"), path)
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays["header"]))
    for name, value in changes.items():
        if name in header:
            header[name] = value
        elif value is None:
            del arrays[name]
        else:
            arrays[name] = value
    np.savez_compressed(path, **(arrays | {"header": np.array(json.dumps(header))}))
    return path


def test_a_model_comes_back(tmp_path: Path) -> None:
    ours = load_model(None, "right")
    back = load_model(edited(tmp_path / "hand.npz", unknown=np.array([None])), "right")
    assert back.digest == ours.digest
    np.testing.assert_array_equal(back.polygons, ours.polygons)
    np.testing.assert_array_equal(back.uv_faces, ours.uv_faces)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"version": 2}, "format version 2"),
        ({"side": "up"}, "left or right, not 'up'"),
        ({"format": "handfit-take"}, "another format"),
        ({"weights": None}, "lacks weights"),
        ({"faces": np.zeros((3, 3))}, "faces holds float64, expected whole numbers"),
        ({"faces": np.zeros((200_000, 3), dtype=np.int32)}, "more than 100000"),
        ({"uv": np.full((10, 2), np.nan)}, "uv is not finite"),
        ({"v_template": np.zeros((1609, 3))}, "0 m long"),
        ({"v_template": np.random.default_rng(0).normal(size=(1609, 3)) * 200}, "a hand model is in metres"),
        ({"tip_vertices": np.array([-1, 2, 3, 4, 5])}, "do not exist"),
    ],
    ids=lambda value: str(value)[:50],
)
def test_wrong_files_are_refused(tmp_path: Path, changes: dict[str, Any], said: str) -> None:
    assert said in message_of(edited(tmp_path / "hand.npz", **changes))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_names_that_are_no_model(tmp_path: Path) -> None:
    """A take names its model, and Blender reads it: nothing there is waited for, and nothing escapes."""
    for suffix in (".npz", ".pkl"):
        pipe = tmp_path / f"pipe{suffix}"
        os.mkfifo(pipe)
        assert "no file, but a pipe" in message_of(pipe)
    os.mkfifo(tmp_path / "MANO_RIGHT.npz")
    assert "has no MANO_RIGHT" in message_of(tmp_path)
    assert "no file, but a pipe" in message_of("/dev/zero")
    for name in ("a\0b", "/nowhere/\udcff.npz", "~nobody-of-that-name/hand.npz", "", "a" * 5000, "a" * 300):
        assert "hand model" in message_of(name) or "MANO_RIGHT" in message_of(name)
    large = tmp_path / "large.npz"
    with large.open("wb") as stream:
        stream.truncate(1 << 40)  # sparse, takes no room
    assert "too large" in message_of(large)


# Commands


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


def test_info(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_mano_pickle(tmp_path / "hand.pkl", imitation_arrays())
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
    assert run("info", "open-hand") == 0
    out = capsys.readouterr().out
    assert out.count("side ") == 2
    assert out.index("left") < out.index("right")
