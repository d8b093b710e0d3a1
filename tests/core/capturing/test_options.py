"""Options of a capture: one table, which the library, the command line, the worker and the docs follow."""

import argparse
import json
import re
from pathlib import Path
from typing import Any

import pytest

from handfit_core import Intrinsics, capture
from handfit_core.__main__ import _all_parsers, _parser
from handfit_core.capturing.options import (
    OPTIONS,
    VIEW_OPTIONS,
    CaptureOptions,
    LiveOptions,
    Option,
    add_options,
)
from handfit_core.common.errors import OptionError
from handfit_core.detect.detector import Region
from handfit_core.geometry.lens import Lens
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.lenses import MeasuredLens, save_lens
from tests.conftest import ROOT

GIVEN: dict[str, tuple[Any, str, Any]] = {
    "frames": ("2-10:4", "2-10:4", FrameRange(2, 10, 4)),
    "hands": ("left", "left", "left"),
    "max_hands": (5, "5", 5),
    "regions": (
        [[1, 2, 30.5, 40, 7, "left"]],
        "1,2,30.5,40,7,left",
        (Region(1.0, 2.0, 30.5, 40.0, 7, "left"),),
    ),
    "only_regions": (True, "", True),
    "detector": ("mine", "mine", "mine"),
    "threshold": (1, "1", 1.0),
    "plain_detection": (True, "", True),
    "quality": ("best", "best", "best"),
    "landmark_model": ("l.task", "l.task", "l.task"),
    "processes": (3, "3", 3),
    "solver": ("paper-a", "paper-a", "paper-a"),
    "arms": (True, "", True),
    "model": ("m.pkl", "m.pkl", "m.pkl"),
    "smoothing": (0.5, "0.5", 0.5),
    "hand_length": (0.2, "200", 0.2),
    "intrinsics": ([1, 2, 3, 4], "1,2,3,4", Intrinsics(1.0, 2.0, 3.0, 4.0)),
    "lens": ([1, 0.5, 0.25], "1,0.5,.25", (1.0, 0.5, 0.25)),
    "view": ("b.mp4", "b.mp4", "b.mp4"),
    "view_lens": ([1, 0.5, 0.25], "1,0.5,.25", (1.0, 0.5, 0.25)),
    "cameras": ("rig.toml", "rig.toml", "rig.toml"),
    "offset": (-0.5, "-0.5", -0.5),
    "baseline": (0.8, "0.8", 0.8),
    "max_megapixels": (300, "300", 300.0),
    "keypoints": ("k.json", "k.json", "k.json"),
    "reader": ("openpose", "openpose", "openpose"),
    "order": ("interhand", "interhand", "interhand"),
    "person": (2, "2", 2),
    "fps": (30, "30", 30.0),
    "picture_size": ([1920, 1080], "1920x1080", (1920, 1080)),
    "hand_mean": ("mean", "mean", "mean"),
    "refit": (True, "", True),
}
"""Option -> a value of a message, the same on the command line, and what both are"""


def told(*words: str) -> CaptureOptions:
    parser = argparse.ArgumentParser()
    add_options(parser)
    return CaptureOptions.of_arguments(parser.parse_args(words))


@pytest.mark.parametrize("name", OPTIONS)
def test_a_message_and_the_command_line_mean_the_same(name):
    value, text, expected = GIVEN[name]
    view = {"view": "b.mp4"} if name in VIEW_OPTIONS else {}
    of_message = CaptureOptions.of_message({name: value} | view)
    assert getattr(of_message, name) == expected
    words = [f"{OPTIONS[each].flag}={given}" for each, given in view.items() if each != name]
    assert told(*words, f"{OPTIONS[name].flag}={text}" if text else OPTIONS[name].flag) == of_message
    assert CaptureOptions.of_message(json.loads(json.dumps(of_message.to_message()))) == of_message


def test_the_library_and_the_command_line_have_every_option():
    """What is not given is the default."""
    assert told() == CaptureOptions() == CaptureOptions.of_message(dict.fromkeys(OPTIONS))
    assert CaptureOptions().to_message() == {}
    with pytest.raises(TypeError, match="no_option"):
        capture("a.jpg", no_option=1)
    with pytest.raises(TypeError, match="either a CaptureOptions, or options by their names"):
        capture("a.jpg", CaptureOptions(), hands="left")
    with pytest.raises(OptionError, match="hands must be one of"):
        capture("a.jpg", hands="three")
    (subcommands,) = [a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction)]
    parsers = {parser.prog.split()[-1]: parser for parser in _all_parsers(subcommands)}
    own = {"-h", "--help", "-o", "--output", "--progress", "--debug", "--write-cameras"}
    assert set(parsers["capture"]._option_string_actions) - own == {o.flag for o in OPTIONS.values()}
    text = (ROOT / "docs" / "batch.md").read_text(encoding="utf-8")
    assert [option.flag for option in OPTIONS.values() if f"`{option.flag}" not in text] == []


def test_a_live_runs_options_are_declared_likewise():
    (subcommands,) = [a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction)]
    live = subcommands.choices["live"]
    args = live.parse_args(
        "0 --online --size=1280x720 --rate=60 --min-cutoff=3 --beta=0 --hands=left".split()
    )
    capture = CaptureOptions.of_arguments(args)
    options = LiveOptions.of_arguments(args, capture=capture)
    assert capture == CaptureOptions(hands="left"), "the camera's rate is not that of another program's file"
    sent = options.to_message()
    assert sent == {"online": True, "size": [1280, 720], "fps": 60.0, "min_cutoff": 3.0, "beta": 0.0}
    assert LiveOptions.of_message(sent, capture=capture) == options
    assert LiveOptions.of_arguments(live.parse_args(["0"])) == LiveOptions()
    for given, said in (
        ({"speed": 3}, "no option 'speed' of a live run; choose from online, size"),
        ({"fps": 0}, "fps must lie between 1 and 1000, not 0"),
        ({"beta": float("nan")}, "beta must lie between 0 and 1000, not nan"),
        ({"size": [640]}, "'size' must be a width and a height in pixels"),
    ):
        with pytest.raises(OptionError, match=re.escape(said)):
            LiveOptions.of_message(given)


def test_choices_are_looked_up_when_help_is_shown_and_not_before():
    asked: list[int] = []
    option = Option(
        str, "a toy", choices=lambda: asked.append(1) or ("ball", "blocks"), name="toy", default="ball"
    )
    parser = argparse.ArgumentParser()
    option.add_to(parser)
    assert parser.parse_args(["--toy", "blocks"]).toy == "blocks"
    assert not asked
    assert "a toy: ball, blocks (default: ball)" in parser.format_help()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"offset": 0.5}, "offset tells of a second view, and there is none: give it with --view"),
        ({"view": "b.mp4", "cameras": "r.toml", "baseline": 1}, "leave the baseline out"),
        ({"speed": 3}, "no option 'speed' of a capture; choose from frames, "),
        ([1], "the options of a capture must be an object, not a list of 1"),
        ({"threshold": 10**400}, "'threshold' must be a finite number"),
        ({"smoothing": float("nan")}, "smoothing must lie between 0 and 10, not nan"),
        ({"hand_length": 18}, "a hand's length must lie between 50 and 300 mm, not 18000 mm; measure"),
        ({"max_hands": 0}, "max_hands must lie between 1 and 200, not 0"),
        ({"hands": "any"}, "hands must be one of auto, left, right, both; got 'any'"),
        ({"frames": "x"}, "'x' is not a frame range"),
        ({"intrinsics": [-1, 1, 0, 0]}, "positive, finite focal lengths"),
        ({"regions": "1,2,3,4"}, "'regions' must be a list of regions"),
        ({"regions": [[1, 2, 3]]}, "must be regions X,Y,WIDTH,HEIGHT in pixels"),
        ({"regions": [[1, 2, 3, 4, "both"]]}, "must be regions X,Y"),
        ({"lens": [1, 0, 0], "intrinsics": [1, 1, 0, 0]}, "as intrinsics or as a lens, not both"),
    ],
    ids=str,
)
def test_what_cannot_be_meant_is_said_in_a_sentence(given, said):
    with pytest.raises(OptionError) as caught:
        CaptureOptions.of_message(given)
    assert said in str(caught.value)


@pytest.mark.parametrize("given", [[1, 2, 3, 4], [1, 2, 3, 4, "right"], [1, 2, 3, 4, 9], "1,2,3,4,9,left"])
def test_regions_come_back_as_they_were_given(given):
    options = CaptureOptions(regions=(given,))
    (sent,) = options.to_message()["regions"]
    assert sent == ([1, 2, 3, 4, 9, "left"] if isinstance(given, str) else given)
    assert CaptureOptions.of_message({"regions": [sent]}) == options


def test_programs_may_give_the_forms_that_they_have():
    options = CaptureOptions(model=Path("a", "b.pkl"), frames="3-")  # type: ignore
    assert (options.model, options.frames) == (str(Path("a", "b.pkl")), FrameRange(3))
    assert CaptureOptions(intrinsics=Intrinsics(1.0, 2.0, 3.0, 4.0)).to_message() == {
        "intrinsics": [1.0, 2.0, 3.0, 4.0]
    }


def test_a_measured_lens_goes_with_its_numbers(tmp_path, monkeypatch):
    """To another machine, and into the keys of a batch; its name is read here."""
    monkeypatch.setenv("HANDFIT_DATA", str(tmp_path))
    lens = Lens(Intrinsics(1.0, 2.0, 3.0, 4.0), (0.1, 0.2, 0.0, 0.0, 0.0), 640, 480)
    save_lens("my phone, wide", MeasuredLens(lens, 0.2, 1.0, 20))
    options = told("--lens", "my phone, wide")
    assert options.lens == lens
    assert CaptureOptions.of_message(json.loads(json.dumps(options.to_message()))) == options
    with pytest.raises(OptionError, match="no measured lens yours; saved are my phone, wide: measure"):
        told("--lens=yours")
    with pytest.raises(OptionError, match="a lens with intrinsics"):
        CaptureOptions.of_message({"lens": {"width": 640}})
