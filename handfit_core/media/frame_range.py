"""Frame ranges as artists write them, `10-200:2`."""

from __future__ import annotations

import re
from dataclasses import dataclass

from handfit_core.common.errors import OptionError
from handfit_core.media.settings import MEDIA

_PATTERN = re.compile(r"\s*(?P<first>\d+)?\s*(?:(?P<dash>-)\s*(?P<last>\d+)?)?\s*(?::\s*(?P<step>\d+))?\s*")


@dataclass(frozen=True)
class FrameRange:
    """Source frame numbers `first` to `last`, both included, every `step`-th of them."""

    first: int | None = None
    last: int | None = None
    step: int = 1

    @classmethod
    def parse(cls, text: str) -> FrameRange:
        """Read a range such as `10-200:2`, `10-200`, `10-`, `-200`, `15` or `:2`. Raises OptionError for any
        other text."""
        match = _PATTERN.fullmatch(text) if len(text) <= MEDIA.max_range_chars else None
        if not match or not text.strip():
            raise OptionError(
                f"'{text[: MEDIA.max_range_chars]}' is not a frame range; write 10-200, "
                "10-200:2 (every second), 10-, -200 or 15"
            )
        first, last, step = (int(v) if v else None for v in match.group("first", "last", "step"))
        if match["dash"] is None and first is not None:
            last = first
        if step == 0 or (first is not None and last is not None and last < first):
            raise OptionError(
                f"'{text}' is an empty frame range; the first frame must not lie after the last"
            )
        return cls(first, last, step or 1)

    def __contains__(self, number: int) -> bool:
        return number in self.within(number, number)

    def within(self, low: int, high: int) -> range:
        """Return the frames of the range that lie from `low` to `high`, both included, without making a list
        of them."""
        first = low if self.first is None else max(low, self.first)
        first += -(first - (self.first or 1)) % self.step
        return range(first, (high if self.last is None else min(high, self.last)) + 1, self.step)

    def __str__(self) -> str:
        first, last = ("" if v is None else str(v) for v in (self.first, self.last))
        return f"{first}-{last}" + (f":{self.step}" if self.step > 1 else "")
