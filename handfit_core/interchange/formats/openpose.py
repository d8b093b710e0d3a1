"""OpenPose's JSON: a file a frame, each person's hands as x, y and confidence of 21 points.

The layout is that of openpose/doc/02_output.md and of --keypoint_scale in its flags; ControlNet's tools write
the same with the picture's size, and lists of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from handfit_core.errors import InputError
from handfit_core.files import shown
from handfit_core.interchange.document import Document
from handfit_core.interchange.gather import (
    Gathering,
    ToldHands,
    check_person,
    check_some,
    of_person,
    seen_hands,
    without_hidden,
)
from handfit_core.interchange.numbered import first_content, frames_of, keyed, size_in
from handfit_core.interchange.opening import RELATIVE, scaled
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording, known
from handfit_core.interchange.settings import LIMITS
from handfit_core.skeleton import NUM_KEYPOINTS, SIDES


def _recognises(document: Document) -> bool:
    content = first_content(document)
    first = content[0] if isinstance(content, list) and content else content
    return isinstance(first, dict) and isinstance(first.get("people"), list)


def _read(document: Document, asked: Asked) -> Recording:
    frames = frames_of(document)
    path = shown(document.path)
    gathered, most, given = Gathering(), 0, 0
    everything: list[np.ndarray] = []
    for row, content in enumerate(frames.contents):
        people = content.get("people") if isinstance(content, dict) else None
        if not isinstance(people, list):
            raise InputError(
                f"{path}: frame {frames.numbers[row]} has no list of people, as OpenPose writes it"
            )
        most = max(most, len(people))
        for _, human in of_person(people, asked.person):
            found = keyed(human)
            try:
                body = _triples(found.get("posekeypoints2d", found.get("posekeypoints")))
                if len(body):
                    everything.append(body)
                for side in SIDES:
                    hand = _triples(found.get(f"hand{side}keypoints2d", found.get(f"hand{side}keypoints")))
                    if not len(hand):
                        continue
                    everything.append(hand)
                    if len(hand) != NUM_KEYPOINTS:
                        raise ValueError(f"a {side} hand of {len(hand)} points; expected 21")
                    given += 1
                    sure = np.where(np.any(hand[:, :2] != 0.0, axis=1), hand[:, 2], 0.0)
                    gathered.add(row, hand[:, :2], side, sure)
            except (TypeError, ValueError, OverflowError) as error:
                raise InputError(
                    f"{path}: frame {frames.numbers[row]} is not as OpenPose writes it ({str(error)[:200]})"
                ) from error
    check_person(asked.person, most, path)
    if not given:
        raise InputError(f"{path}: OpenPose's people without hands; run it with --hand")
    # Mean confidence below which OpenPose does not draw a hand (--hand_render_threshold)
    hands, hidden = without_hidden(gathered.hands(), 0.2)
    check_some(hands, f"{path}: OpenPose's people")
    hands, relative, assumed = _unscaled(hands, np.concatenate(everything))
    canvas = size_in(keyed(frames.contents[0]), "canvas")
    made = Recording(
        "openpose",
        (str(document.path.absolute()),),
        asked.rate,
        frames.numbers,
        seen_hands(hands),
        size=RELATIVE if relative else canvas,
        assumed=(*frames.assumed, *assumed, *hidden),
    )
    return made if canvas is None else scaled(made, *canvas)


def _triples(numbers: Any) -> np.ndarray:
    """(N, 3) x, y and confidence; none where nothing is told."""
    values = np.array([] if numbers is None else numbers, dtype=np.float64)
    if values.ndim != 1 or len(values) % 3:
        raise ValueError(f"points of the shape {values.shape}; expected a list of x, y and confidence")
    return values.reshape(-1, 3)


def _unscaled(hands: ToldHands, points: np.ndarray) -> tuple[ToldHands, bool, tuple[str, ...]]:
    """The hands in pixels or in parts of the picture's size, whether they are in these, and what was assumed.

    `points` (N, 3): all that is told of anybody. With --keypoint_scale 4, from -1 to 1, a missing point lies
    at (-1, -1) with a confidence of 0, and with the others at (0, 0).
    """
    trusted = points[(points[:, 2] > 0.0) & known(points[:, :2]), :2]
    if np.abs(trusted).max() > LIMITS.relative:
        return hands, False, ()
    missing = points[points[:, 2] == 0.0, :2]
    at_corner, at_zero = np.all(missing == -1.0, axis=1).any(), np.all(missing == 0.0, axis=1).any()
    from_minus = at_corner or (not at_zero and trusted.min() < -0.1)
    said = (
        "its points lie between -1 and 1 (--keypoint_scale 4)"
        if from_minus
        else ("its points are parts of the picture's size (--keypoint_scale 3)")
    )
    if from_minus:
        halved = hands.points.copy()
        halved[..., :2] = (halved[..., :2] + 1.0) / 2.0
        hands = replace(hands, points=halved)
    return hands, True, (said,)


READER = Reader(
    "OpenPose", "JSON files with people and hand_left_keypoints_2d, one a frame", _recognises, _read
)
