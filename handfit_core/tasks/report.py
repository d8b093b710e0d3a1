"""What became of each input: report.json for programs, overview.html for people, and a line on the console.

Nothing here needs SciPy or OpenCV, so that Blender writes the reports anew once it has made its files.
"""

from __future__ import annotations

import datetime
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self

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
from handfit_core.tasks.overview import write_overview
from handfit_core.tasks.record import missing_and_changed, move_results, read_record, results_folder

if TYPE_CHECKING:
    from handfit_core.tasks.task import Task

REPORT: Final = "report.json"
OVERVIEW: Final = "overview.html"
FINAL: Final = ("InputError", "NoHandFoundError", "TakeError")
"""Kinds of errors that lie in an input: it is tried again only where somebody asks for it"""


@dataclass
class Result:
    """One entry of report.json."""

    input: str
    name: str
    status: str = "pending"
    """pending, ok or failed"""
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
        """From an entry of a file; what is not of its kind is left out, as is what another version has on
        top."""
        known = {each.name: entry.get(each.name) for each in fields(cls)}
        return cls(**{"input": "", "name": "", **{k: v for k, v in known.items() if _fits(k, v)}})

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

    @property
    def is_final(self) -> bool:
        """Whether it failed for a reason that lies in its input."""
        return self.status == "failed" and bool(self.attempts) and self.attempts[-1].get("kind") in FINAL


_NUMBER: Final = int | float
_KINDS: Final[Mapping[str, Any]] = {
    **dict.fromkeys(("input", "name", "status", "error", "id", "host"), str),
    **dict.fromkeys(("seconds", "frames"), _NUMBER),
    "character": dict,
    "files": [str],
    "warnings": [str],
    "hands": [dict],
    "attempts": [dict],
}
"""What each field of a Result is, with the kind of all its elements where it is a list"""


def _fits(name: str, value: object) -> bool:
    kind = _KINDS[name]
    if isinstance(kind, list):
        return isinstance(value, list) and all(isinstance(each, kind[0]) for each in value)
    return isinstance(value, kind)


def attempt(error: str, kind: str, seconds: float) -> dict[str, Any]:
    """An entry of `attempts`: what went wrong, where, when, after how long."""
    now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    return {
        "error": error,
        "kind": kind,
        "host": platform.node(),
        "seconds": round(seconds, 3),
        "at": now,
    }


def result_of(task: Task, record: Mapping[str, Any] | None, folder: Path | None = None) -> Result:
    """What a record says of a task; pending where it is another task's, or where files of it that should lie
    in `folder` are gone. Files that somebody has changed since are his work by now, and a warning says so."""
    pending = Result(task.shown, task.name, id=task.key)
    if record is None or record["key"] != task.key:
        return pending
    result = Result.of_entry({**record["result"], "input": task.shown, "name": task.name, "id": task.key})
    if folder is not None and record["status"] == "done":
        missing, changed = missing_and_changed(folder, record)
        if changed:
            said = f"{', '.join(changed)}: changed since the batch wrote it, and left alone"
            result.warnings.append(f"{said}; --again makes all anew")
        elif missing:
            return pending
    return result


def read_results(output: Path, tasks: Sequence[Task]) -> list[Result]:
    """What the records say of all tasks, in their order."""
    return [result_of(t, read_record(t.record(output)), t.folder(output)) for t in tasks]


def write_report(output: Path, results: Sequence[Result]) -> None:
    """Write report.json and overview.html. Raises OutputError."""
    report = {"format": "handfit-batch", "version": 1, "inputs": [vars(r) for r in results]}
    with results_folder(output) as part:
        with written_whole(part / REPORT) as beside:
            text = json.dumps(report, indent=2, ensure_ascii=False) + "\n"
            # Of a name that is no UTF-8 an escape is left, which says the same in JSON.
            beside.write_text(text, encoding="utf-8", errors="backslashreplace")
        write_overview(part / OVERVIEW, output.absolute().name, [vars(result) for result in results])
        move_results(part, output)


def line(result: Result) -> str:
    """One line about one input, for people."""
    if result.status != "ok":
        named = "" if result.error.startswith(result.input) else f"{result.input}: "
        return f"{result.status}: {named}{result.error}"
    hands = ", ".join(
        f"{hand.get('side')} hand in {hand.get('detected')} of {result.frames} frames{_error(hand)}"
        for hand in result.hands
    )
    warnings = f", {len(result.warnings)} warnings" if result.warnings else ""
    return f"ok: {result.input}: {hands}{warnings}, {result.seconds:.1f} s"


def _error(hand: Mapping[str, Any]) -> str:
    if hand.get("error_known") is False:
        return f" ({NOT_KNOWN})"
    likely = expected_scale(hand.get("detected") or 0)
    for scale, name in ((likely, "mean_expected_error"), (IN_PICTURE, "mean_error_of_hand")):
        if isinstance(error := hand.get(name), int | float):
            return f" ({scale.title.lower()} {scale.said(error)}, {scale.quality(error)})"
    return ""
