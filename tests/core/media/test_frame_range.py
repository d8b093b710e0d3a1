import sys

import pytest

from handfit_core.common.errors import OptionError
from handfit_core.media.frame_range import FrameRange


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("1-", list(range(1, 21))),
        ("10-16:2", [10, 12, 14, 16]),
        ("18-", [18, 19, 20]),
        ("-3", [1, 2, 3]),
        ("7", [7]),
        (":5", [1, 6, 11, 16]),
        (" 3 - 5 ", [3, 4, 5]),
    ],
)
def test_parse(text, numbers):
    frames = FrameRange.parse(text)
    assert [n for n in range(1, 21) if n in frames] == numbers
    again = FrameRange.parse(str(frames))
    assert [n for n in range(1, 21) if n in again] == numbers


@pytest.mark.parametrize("text", ["", "a-b", "10-2", "1-5:0", "1-2-3", "9" * 5000, " " * 5000 + "x"])
def test_refuses(text):
    with pytest.raises(OptionError, match="frame range"):
        FrameRange.parse(text)


@pytest.mark.parametrize("text", ["10-16:2", "3-5", "18-", "-3", "7", ":5", "4-:8", "0-9:3", "30-40", "-0"])
def test_within_is_what_is_contained(text):
    frames = FrameRange.parse(text)
    for low, high in ((1, 20), (5, 12), (1, 0), (12, 12)):
        assert list(frames.within(low, high)) == [n for n in range(low, high + 1) if n in frames]
    assert sys.getsizeof(frames.within(1, 1 << 40)) < 100, "counted, not listed"
