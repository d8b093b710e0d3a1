"""Accuracy of the cameras that are found from the hands in two views, and of hands that are fitted with them.

A folder, or each of its folders, has `gt.json`: a list of clips, each an object with `clip`, `side`, `fps`,
`offset` (seconds from the first view's start to the second one's), `K_a`, `K_b` (3, 3), `R` (3, 3), `t` (3,)
(x_b = R x_a + t, metres) and `joints3d` (T, 21, 3) in the first camera's frame. The clip's views lie beside
it as CLIP_a.mp4 and CLIP_b.mp4, or as folders of pictures CLIP_a and CLIP_b.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.pipeline import capture
from handfit_core.capturing.views.joining import joined
from handfit_core.capturing.views.readings import ViewTake
from handfit_core.capturing.views.rig_file import Rig
from handfit_core.capturing.views.verdict import rotation_between
from handfit_core.common.errors import DatasetError
from handfit_core.evaluate.metrics import (
    camera_distances,
    root_aligned_distances,
    similarity_aligned_distances,
)
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.lens import Lens
from handfit_core.media.opening import open_media
from handfit_core.take import Take

KIND: Final = "two-cameras"
TOLD: Final = ("nothing", "lenses", "cameras")
"""The kinds of knowledge that a capture is given: clips alone, the cameras' lenses, or their lenses and
places"""
TRUTH: Final = "gt.json"
_KEYS: Final = {"clip", "side", "fps", "offset", "K_a", "K_b", "R", "t", "joints3d"}
_ALIGNMENTS: Final = {
    "PA-MPJPE": similarity_aligned_distances,
    "root-aligned": root_aligned_distances,
    "place": camera_distances,
}


@dataclass(frozen=True, eq=False)
class FilmedClip:
    """Two views of one clip, each captured by itself, and the truth."""

    name: str
    group: str
    truth: dict[str, Any]
    first: Take
    second: Take


def is_two_cameras(folder: Path) -> bool:
    """Return whether a folder, or a folder in it, has clips of two cameras."""
    return bool(_truths(folder))


def _truths(folder: Path) -> list[Path]:
    return [path for path in sorted([*folder.glob(TRUTH), *folder.glob(f"*/{TRUTH}")]) if path.is_file()]


def evaluate_views(
    folder: Path, options: CaptureOptions, progress: Callable[[str, int, int], None]
) -> pd.DataFrame:
    """Make a table with a row for each pair of clips with each of `TOLD`, and with nothing told also for
    pairs that do not belong together (`belongs` is False there).

    Raises DatasetError, and what captures raise.
    """
    rows = []
    for lenses in (False, True):
        clips = list(_captured(folder, options, lenses=lenses, progress=progress))
        pairs = [(told, clip, clip) for told in TOLD if (told != "nothing") is lenses for clip in clips]
        if not lenses:
            # Each first view with two strangers
            pairs += [
                ("nothing", clip, clips[(i + k) % len(clips)])
                for k in (1, 2)
                if len(clips) > k
                for i, clip in enumerate(clips)
            ]
        for done, (told, first, second) in enumerate(pairs, start=1):
            rig = _rig(first) if told == "cameras" else None
            started = time.process_time()
            take = joined(ViewTake(first.first, lenses), ViewTake(second.second, lenses), options, rig)
            rows.append({"told": told} | _row(first, second, take, time.process_time() - started))
            progress("score", done, len(pairs))
    return pd.DataFrame(rows)


def _captured(
    folder: Path, options: CaptureOptions, *, lenses: bool, progress: Callable[[str, int, int], None]
) -> Iterator[FilmedClip]:
    truths = [(path, truth) for path in _truths(folder) for truth in _read(path)]
    if not truths:
        raise DatasetError(f"{folder}: there is no {TRUTH} with clips of two cameras")
    for done, (path, truth) in enumerate(truths, start=1):
        takes = []
        for view in "ab":
            file = path.parent / f"{truth['clip']}_{view}"
            file = file if file.is_dir() else file.with_name(f"{file.name}.mp4")
            size = open_media(file)
            lens = _lens(truth, view, size.width, size.height) if lenses else None
            takes.append(replace(capture(file, replace(options, lens=lens)), fps=truth["fps"]))
        yield FilmedClip(f"{path.parent.name}/{truth['clip']}", path.parent.name, truth, *takes)
        progress("detect", done, len(truths))


def _read(path: Path) -> list[dict[str, Any]]:
    try:
        clips = json.loads(path.read_text(encoding="utf-8"))
        if all(set(clip) >= _KEYS for clip in clips):
            return clips
    except (OSError, ValueError, TypeError) as error:
        raise DatasetError(f"{path}: cannot be read ({error})") from error
    raise DatasetError(f"{path}: a clip lacks one of {', '.join(sorted(_KEYS))}")


def _lens(truth: dict[str, Any], view: str, width: int, height: int) -> Lens:
    matrix = np.array(truth[f"K_{view}"], dtype=np.float64)
    k1, k2, p1, p2, k3 = truth.get(f"dist_{view}") or [0.0] * 5
    camera = Intrinsics(matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2])
    return Lens(camera, (k1, k2, p1, p2, k3), width, height)


def _rig(clip: FilmedClip) -> Rig:
    lenses = (
        _lens(clip.truth, view, take.width, take.height)
        for view, take in zip("ab", (clip.first, clip.second), strict=True)
    )
    return Rig((next(lenses), next(lenses)), np.array(clip.truth["R"]), np.array(clip.truth["t"]))


def _row(first: FilmedClip, second: FilmedClip, take: Take, seconds: float) -> dict[str, Any]:
    assert take.verdict is not None
    row = {
        "clip": first.name,
        "second": second.name,
        "group": first.group,
        "belongs": first is second,
        "verdict": take.verdict.agreement,
        "seconds": seconds,
        "text": take.verdict.text,
    }
    if first is not second:
        return row
    truth, joints = first.truth, np.array(first.truth["joints3d"])
    row |= {f"one view {name}": error for name, error in _errors(first.first, truth["side"], joints).items()}
    cameras = take.cameras
    if cameras is None:
        return row
    row |= _errors(take, truth["side"], joints)
    true = np.array(truth["t"])
    way = cameras.translation[1]
    cosine = way @ true / np.linalg.norm(way) / np.linalg.norm(true)
    return row | {
        "offset": abs(float(cameras.time_offset[1]) - truth["offset"]) * take.fps,
        "rotation": rotation_between(cameras.rotation[1], np.array(truth["R"])),
        "direction": float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))),
    }


def _errors(take: Take, side: str, truth: np.ndarray) -> dict[str, float]:
    """Return mean distances in mm over the frames in which the take has a hand of that side, by metric."""
    hands = [hand for hand in take.hands if hand.side == side]
    if not hands:
        return {}
    there = np.flatnonzero(hands[0].present)
    points, true = hands[0].joints_3d[there], truth[np.asarray(take.frame_numbers)[there] - 1]
    return {name: 1000.0 * float(np.nanmean(of(points, true))) for name, of in _ALIGNMENTS.items()}


def views_table(rows: pd.DataFrame) -> str:
    """Return a text with the rows' means and largest values, and how many pairs got which verdict: lengths in
    mm, offsets in frames, angles in degrees, the time of a processor beyond both captures in seconds."""
    own = rows[rows["belongs"]]
    numbers = own.select_dtypes("number").columns
    groups = pd.concat([own, own.assign(group="all")]).groupby(["told", "group"], sort=False)
    verdicts = pd.crosstab([rows["told"], rows["belongs"]], rows["verdict"])
    means = groups[list(numbers)].agg(["mean", "max"]).round(2).T
    return f"{means.to_string()}\n\n{verdicts.to_string()}"
