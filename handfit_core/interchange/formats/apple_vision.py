"""Hands of Apple's Vision (VNHumanHandPoseObservation, HumanHandPoseObservation), as JSON or a table.

Points are named by Vision's keys (VNHLKITIP) or by its API's names (indexTip, littleMCP), lie between 0 and
1, and count from the lower left corner. There is no depth.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from handfit_core.errors import InputError, OptionError
from handfit_core.files import shown
from handfit_core.interchange.document import Document
from handfit_core.interchange.gather import Gathering, ToldHands, check_some, seen_hands, with_sides
from handfit_core.interchange.json_hands import hands_in
from handfit_core.interchange.numbered import frames_of, size_in, some_contents
from handfit_core.interchange.opening import RELATIVE, scaled
from handfit_core.interchange.point_names import is_apple
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.tables import hands_of, is_hand_table


def _recognises(document: Document) -> bool:
    table = None if document.is_folder else document.table
    if table is not None:
        named = any(map(is_apple, table.columns)) or any(
            is_apple(cell) for row in table.rows[:50] for cell in row
        )
        return named and is_hand_table(table)
    return any(_names_in(content, [2000]) for content in some_contents(document))


def _names_in(content: Any, left: list[int], depth: int = 0) -> bool:
    """Whether some object has points by Vision's names; looks at as many values as are left."""
    left[0] -= 1
    if left[0] < 0 or depth > 8:
        return False
    if isinstance(content, dict):
        if any(map(is_apple, list(content)[:100])):
            return True
        content = list(content.values())
    return isinstance(content, list) and any(_names_in(each, left, depth + 1) for each in content)


def _read(document: Document, asked: Asked) -> Recording:
    path = shown(document.path)
    if asked.person is not None:
        raise OptionError(f"{path}: Apple Vision's hands belong to no persons; leave --person out")
    size, assumed = None, ()
    if not document.is_folder and document.table is not None:
        table = hands_of(document.table)
        numbers, hands, fps = table.numbers, table.hands, table.fps
    else:
        frames = frames_of(document)
        numbers, fps, size, assumed = frames.numbers, 0.0, size_in(frames.header), frames.assumed
        gathered = Gathering()
        for row, content in enumerate(frames.contents):
            try:
                for hand in hands_in(content):
                    if hand.points is None:
                        continue
                    # A list of three numbers ends with the confidence.
                    sure = np.where(np.isnan(hand.points[:, 3]), hand.points[:, 2], hand.points[:, 3])
                    told = None if np.isnan(sure).all() else sure
                    gathered.add(row, hand.points[:, :2], hand.label, told, hand.score)
            except (TypeError, ValueError, AttributeError, OverflowError) as error:
                raise InputError(
                    f"{path}: frame {numbers[row]} is not as Vision's points are written ({str(error)[:200]})"
                ) from error
        hands = gathered.hands()
    check_some(hands, f"{path}: Apple Vision's points")
    hands, sides = with_sides(hands, asked.hands, None)
    hands, relative, said = _upright(hands)
    made = Recording(
        "apple-vision",
        (str(document.path.absolute()),),
        asked.fps or fps,
        numbers,
        seen_hands(hands),
        size=RELATIVE if relative else size,
        assumed=(*assumed, *said, *sides),
    )
    return made if size is None else scaled(made, *size)


def _upright(hands: ToldHands) -> tuple[ToldHands, bool, tuple[str, ...]]:
    """The hands counted from the upper left corner, whether they are in parts of the picture's size, and what
    was assumed."""
    if np.nanmax(np.abs(hands.in_plane)) > LIMITS.relative:
        said = "its points are pixels, which are taken to count from the upper left corner"
        return hands, False, (said,)
    points = hands.points.copy()
    points[..., 1] = 1.0 - points[..., 1]
    return replace(hands, points=points), True, ()


READER = Reader(
    "Apple Vision", "JSON or CSV with points by its names, such as VNHLKITIP or indexTip", _recognises, _read
)
