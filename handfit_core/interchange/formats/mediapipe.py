"""What people write of MediaPipe's hands: JSON of results, and tables. There is no one layout.

Of the Tasks' results (landmarks, worldLandmarks, handedness) a side is the hand's own; those of the older
solutions (multi_hand_landmarks, multi_handedness) name sides for mirrored pictures. Exporters mix them up, so
that the fingers have the last word: they bend towards the palm.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.errors import InputError, OptionError
from handfit_core.files import shown
from handfit_core.interchange.document import Document
from handfit_core.interchange.gather import (
    LEAST_SURE,
    UNKNOWN,
    Gathering,
    ToldHands,
    bent_as_left,
    check_some,
    hands_in_space,
    seen_hands,
    with_sides,
)
from handfit_core.interchange.json_hands import JsonHand, hands_in, is_hand
from handfit_core.interchange.numbered import JsonFrames, frames_of, keyed, size_in, some_contents
from handfit_core.interchange.opening import RELATIVE
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording, known
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.tables import hands_of, is_hand_table, rate_of
from handfit_core.interchange.writers import Writer
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES
from handfit_core.take import Take


def _recognises(document: Document) -> bool:
    if not document.is_folder and document.table is not None:
        return is_hand_table(document.table)
    return any(map(_has_hand, some_contents(document)))


def _has_hand(content: Any) -> bool:
    """Whether JSON is a hand, a frame with one, or has such a frame in it."""
    if is_hand(content) or _first_hand(content) is not None:
        return True
    lists = [content, *content.values()] if isinstance(content, dict) else [content]
    return any(_first_hand(frame) is not None for each in lists for frame in _each(each))


def _each(content: Any) -> Iterable[Any]:
    if isinstance(content, dict):
        return content.values()
    return content if isinstance(content, list) else ()


def _first_hand(content: Any) -> JsonHand | None:
    try:
        return next(hands_in(content), None)
    except (TypeError, ValueError, AttributeError, OverflowError):
        return None


def _read(document: Document, asked: Asked) -> Recording:
    path = shown(document.path)
    if asked.person is not None:
        raise OptionError(f"{path}: MediaPipe's hands belong to no persons; leave --person out")
    if not document.is_folder and document.table is not None:
        return _of_table(document, asked)
    frames = _frames(document)
    gathered, mirrored = Gathering(), set()
    for row, content in enumerate(frames.contents):
        try:
            for hand in hands_in(content):
                mirrored.add(hand.mirrored)
                told = hand.points
                points = np.full((NUM_KEYPOINTS, 3), np.nan) if told is None else told[:, :3]
                sure = None if told is None or np.isnan(told[:, 3]).all() else told[:, 3]
                gathered.add(row, points, hand.label, sure, hand.score, hand.world)
        except (TypeError, ValueError, AttributeError, OverflowError) as error:
            raise InputError(
                f"{path}: frame {frames.numbers[row]} is not as MediaPipe's results are written "
                f"({str(error)[:200]})"
            ) from error
    return _recording(
        document,
        asked,
        frames.numbers,
        gathered.hands(),
        fps=asked.fps or _rate(frames),
        size=size_in(frames.header),
        mirrored=True if mirrored == {True} else None,
        assumed=frames.assumed,
    )


def _frames(document: Document) -> JsonFrames:
    """The frames of the JSON, which may be one hand alone."""
    if not document.is_folder and is_hand(document.json):
        return JsonFrames(np.array([1]), [document.json], {})
    return frames_of(document)


def _rate(frames: JsonFrames) -> float:
    """Frames per second, as a header or the frames' times tell; 0: not told."""
    for key in ("fps", "framerate", "framespersecond"):
        told = frames.header.get(key)
        if isinstance(told, int | float) and not isinstance(told, bool) and 1e-3 < told < 1e6:
            return float(told)
    for key in ("timestamp", "timestampms", "timestampinmilliseconds", "time", "timems"):
        times = [keyed(content).get(key) for content in frames.contents]
        if all(isinstance(time, int | float) for time in times) and len(times) > 1:
            return rate_of(
                frames.numbers, np.array(times, dtype=float), milliseconds="m" in key[4:] and "ms" in key
            )
    return 0.0


def _of_table(document: Document, asked: Asked) -> Recording:
    assert document.table is not None
    try:
        table = hands_of(document.table)
    except ValueError as error:
        raise InputError(f"{shown(document.path)}: this table of hands cannot be read, as {error}") from error
    assumed = () if table.counted else ("its rows have no frame numbers: they are counted from 1",)
    return _recording(
        document,
        asked,
        table.numbers,
        table.hands,
        fps=asked.fps or table.fps,
        size=None,
        mirrored=False if table.named_sides else None,
        assumed=assumed,
    )


def _recording(
    document: Document,
    asked: Asked,
    numbers: np.ndarray,
    hands: ToldHands,
    *,
    fps: float,
    size: tuple[int, int] | None,
    mirrored: bool | None,
    assumed: tuple[str, ...],
) -> Recording:
    path = shown(document.path)
    made = Recording("mediapipe", (str(document.path.absolute()),), fps, numbers, assumed=assumed)
    if not known(hands.points[..., :2]).any() or _is_world(hands):
        world = hands.points if known(hands.points).any() else hands.world
        hands = replace(hands, confidence=known(world).astype(float))
        hands, swapped = _own_sides(hands, world, mirrored)
        hands, sides = with_sides(hands, asked.hands, world)
        check_some(replace(hands, points=world), f"{path}: MediaPipe's world landmarks")
        points = hands_in_space(hands, len(numbers), world, on_joints=False, sigma=0.005)
        said = "its points are MediaPipe's world landmarks, without a place: the hands stay where they are"
        return replace(made, points=points, assumed=(*assumed, said, *swapped, *sides))
    check_some(hands, f"{path}: MediaPipe's landmarks")
    shapes = np.where(np.asarray(known(hands.world).all(axis=1))[:, None, None], hands.world, hands.points)
    hands, swapped = _own_sides(hands, shapes, mirrored)
    hands, sides = with_sides(hands, asked.hands, shapes)
    relative = np.nanmax(np.abs(hands.in_plane)) <= LIMITS.relative
    if not relative:
        deep = hands.points[..., 2]
        if np.isfinite(deep).any() and np.nanmax(np.abs(deep)) <= LIMITS.relative:
            # Pixels beside a depth in parts of the picture's width.
            width = size or asked.picture_size
            points = hands.points.copy()
            points[..., 2] = deep * width[0] if width is not None else np.nan
            hands = replace(hands, points=points)
        seen = seen_hands(hands)
    else:
        seen = seen_hands(hands) if size is None else seen_hands(hands, size)
        size = size or RELATIVE
    return replace(made, seen=seen, size=size, assumed=(*assumed, *swapped, *sides))


def _is_world(hands: ToldHands) -> bool:
    """Whether what is told as points is in metres about each hand's middle."""
    if not known(hands.points).any():
        return False
    whole = np.asarray(known(hands.points).all(axis=1))
    points = hands.points[whole]
    if not len(points):
        return False
    middles, reach = np.abs(points.mean(axis=1)), np.abs(points).max(axis=(1, 2))
    return bool(np.median(middles[:, :2].max(axis=1)) < 0.05 and np.median(reach) < 0.2)


def _own_sides(
    hands: ToldHands, shapes: np.ndarray, mirrored: bool | None
) -> tuple[ToldHands, tuple[str, ...]]:
    """The hands, left and right swapped where labels count for mirrored pictures, and what is said of it.

    `shapes` (N, 21, 3): what is known of their shape in space. `mirrored`: what the file's layout says.
    """
    told = hands.side != UNKNOWN
    if not told.any():
        return hands, ()
    bent = bent_as_left(shapes) * np.where(hands.side == SIDES.index("left"), 1.0, -1.0)
    bent = bent[told & np.isfinite(bent)]
    share = float(bent.sum() / np.abs(bent).sum()) if np.abs(bent).sum() > 0.0 else 0.0
    swap = share < 0.0 if abs(share) > LEAST_SURE else bool(mirrored)
    if not swap:
        return hands, ()
    swapped = np.where(told, 1 - hands.side, hands.side)
    how = "as its fingers bend" if abs(share) > LEAST_SURE else "as multi_handedness does"
    return replace(hands, side=swapped), (
        f"left and right are swapped: it names them for mirrored pictures, {how}",
    )


def _write(take: Take, path: Path) -> None:
    width, height = take.width, take.height
    frames = []
    for row, number in enumerate(take.frame_numbers.tolist()):
        found = [
            hand
            for hand in take.hands
            if known(hand.keypoints_2d[row]).all() or known(hand.joints_3d[row]).all()
        ]
        frames.append(
            {
                "frame": number,
                "timestamp_ms": round((number - int(take.frame_numbers[0])) * 1000.0 / take.fps, 3),
                "landmarks": [_landmarks(take, hand, row) for hand in found],
                "world_landmarks": [_world(hand.joints_3d[row]) for hand in found],
                "handedness": [
                    [{"category_name": hand.side.capitalize(), "score": _round(hand.score[row])}]
                    for hand in found
                ],
            }
        )
    content = {
        "format": "mediapipe-hands",
        "fps": take.fps,
        "width": width,
        "height": height,
        "frames": frames,
    }
    path.write_text(json.dumps(content), encoding="utf-8")


def _landmarks(take: Take, hand: Any, row: int) -> list[dict[str, float]]:
    """A fitted hand in parts of the picture, its depth on the scale of x and relative to the wrist."""
    points = hand.joints_3d[row]
    pixels = take.intrinsics.project(points)
    depth = (points[:, 2] - points[0, 2]) * take.intrinsics.fx / points[0, 2]
    return [
        {"x": _round(x / take.width), "y": _round(y / take.height), "z": _round(z / take.width)}
        for (x, y), z in zip(pixels, depth, strict=True)
    ]


def _world(points: np.ndarray) -> list[dict[str, float]]:
    return [dict(zip("xyz", map(_round, point), strict=True)) for point in points - points.mean(axis=0)]


def _round(value: float) -> float:
    return 0.0 if np.isnan(value) else round(float(value), 7)


READER = Reader(
    "MediaPipe", "JSON or CSV with 21 landmarks a hand, whoever has written it", _recognises, _read
)
WRITER = Writer("MediaPipe's landmarks", (".mediapipe.json",), _write)
