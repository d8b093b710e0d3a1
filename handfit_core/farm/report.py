"""report.json, and the one line about each input on the console."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Final, Self

from handfit_core.files import written_whole
from handfit_core.fit_quality import (
    IN_PICTURE,
    NOT_KNOWN,
    error_is_known,
    expected_scale,
    mean_expected_error,
    mean_relative_error,
)
from handfit_core.take import Take


@dataclass
class Result:
    """One entry of report.json."""

    input: str
    name: str
    status: str = "pending"
    """pending, running, ok, failed or interrupted"""
    seconds: float = 0.0
    frames: int = 0
    hands: list[dict[str, Any]] = field(default_factory=list)
    """per hand its side, the frames in which it was detected and those in which it is doubtful (None: nobody
    looked), mean_reprojection_error_px, mean_error_of_hand:
    the same as a share of the hand's length in the picture, and mean_expected_error: metres that it is likely
    to be off; error_known: whether anybody can tell that"""
    character: dict[str, Any] | None = None
    """the armature that got the motion, and per hand of it its side, the captured hand's number, what the rig
    was taken for, how many bones were keyed in how many frames, and by how many metres of the captured hand
    fingertips that touch do not meet"""
    files: list[str] = field(default_factory=list)
    """relative to the report's folder"""
    warnings: list[str] = field(default_factory=list)
    error: str = ""
    id: str = ""
    """of the task"""
    host: str = ""
    """where it was done"""
    attempts: list[dict[str, Any]] = field(default_factory=list)
    """what went wrong before, or at last: per attempt its error, kind, host, seconds and time"""

    @classmethod
    def of_entry(cls, entry: Mapping[str, Any]) -> Self:
        """From what `asdict` made of one; what another version has on top is left out, and with a warning
        what is not of its kind, since whole results are worth more than what is said of them."""
        known = {each.name: entry[each.name] for each in fields(cls) if each.name in entry}
        unfit = [name for name, value in known.items() if not _fits(value, _KINDS[name])]
        result = cls(**{"input": "", "name": "", **{k: v for k, v in known.items() if k not in unfit}})
        if unfit:
            result.warnings = [*result.warnings, f"what was noted of its {', '.join(unfit)} is damaged"]
        return result

    def describe(self, take: Take) -> None:
        """Fill in `frames` and `hands`."""
        self.frames = len(take.frame_numbers)
        for track in take.hands:
            error = track.reprojection_error[track.detected]
            share, likely = mean_relative_error(track, take.intrinsics), mean_expected_error(track)
            self.hands.append(
                {
                    "side": track.side,
                    "detected": int(track.detected.sum()),
                    "doubtful": None if track.doubtful is None else int(track.doubtful.sum()),
                    "mean_reprojection_error_px": round(float(error.mean()), 3) if len(error) else None,
                    "mean_error_of_hand": None if share is None else round(share, 4),
                    "mean_expected_error": None if likely is None else round(likely, 5),
                    "error_known": error_is_known(track),
                }
            )


_NUMBER: Final = int | float
_HAND: Final = {
    "side": str,
    "detected": int,
    "doubtful": int | None,
    "mean_reprojection_error_px": _NUMBER | None,
    "mean_error_of_hand": _NUMBER | None,
    "mean_expected_error": _NUMBER | None,
    "error_known": bool | None,
}
_ATTEMPT: Final = {"error": str, "kind": str, "host": str, "seconds": _NUMBER, "at": str}
_KINDS: Final[Mapping[str, Any]] = {
    **dict.fromkeys(("input", "name", "status", "error", "id", "host"), str),
    "seconds": _NUMBER,
    "frames": int,
    "hands": [_HAND],
    "character": dict | None,
    "files": [str],
    "warnings": [str],
    "attempts": [_ATTEMPT],
}
"""What each field of a Result is, with that of all of its elements where it is a list"""
_LARGEST: Final = 1e15


def _fits(value: Any, kind: Any) -> bool:
    """Whether a value out of a file is of a kind; of numbers, one that can be shown."""
    if isinstance(kind, list):
        return isinstance(value, list) and all(_fits(each, kind[0]) for each in value)
    if isinstance(kind, dict):
        return isinstance(value, dict) and all(_fits(value.get(name), k) for name, k in kind.items())
    return isinstance(value, kind) and not (isinstance(value, _NUMBER) and not abs(value) < _LARGEST)


def write_report(path: Path, results: Sequence[Result]) -> None:
    """Write report.json whole. Raises OutputError."""
    report = {"format": "handfit-batch", "version": 1, "inputs": [vars(r) for r in results]}
    with written_whole(path) as beside:
        text = json.dumps(report, indent=2, ensure_ascii=False) + "\n"
        # Of a name that is no UTF-8 an escape is left, which says the same in JSON.
        beside.write_text(text, encoding="utf-8", errors="backslashreplace")


def line(result: Result) -> str:
    """One line about one input, for people."""
    if result.status != "ok":
        named = "" if result.error.startswith(result.input) else f"{result.input}: "
        return f"{result.status}: {named}{result.error}"
    if not result.hands:  # a part of a clip
        return f"ok: {result.input}: {result.frames} frames, {result.seconds:.1f} s"
    hands = ", ".join(
        f"{hand['side']} hand in {hand['detected']} of {result.frames} frames{_error(hand)}"
        for hand in result.hands
    )
    warnings = f", {len(result.warnings)} warnings" if result.warnings else ""
    return f"ok: {result.input}: {hands}{warnings}, {result.seconds:.1f} s"


def _error(hand: dict[str, Any]) -> str:
    if hand.get("error_known") is False:
        return f" ({NOT_KNOWN})"
    likely = expected_scale(hand["detected"])
    for scale, name in ((likely, "mean_expected_error"), (IN_PICTURE, "mean_error_of_hand")):
        if (error := hand[name]) is not None:
            return f" ({scale.title.lower()} {scale.said(error)}, {scale.quality(error)})"
    return ""
