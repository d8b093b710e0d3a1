"""Hands in single pictures: a plain look, a search where it finds too little, and the mean of some looks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack

import numpy as np

from handfit_core.detect.correction.corrected import with_side_judged
from handfit_core.detect.detector import Backend, Detector, DetectorSettings
from handfit_core.detect.keypoints import HandDetection
from handfit_core.detect.looks import (
    SAME_HAND,
    SecondLook,
    View,
    averaged,
    distance,
    largest_agreement,
    look_again,
    mean_of,
)


class StillFinder(Detector):
    """Finds hands in pictures that have nothing to do with each other.

    Raises LandmarkModelError when the model file is missing or damaged.
    """

    def __init__(self, backend: Backend, settings: DetectorSettings) -> None:
        self._max_hands = settings.max_hands or ALL_HANDS
        with ExitStack() as opened:  # which closes what is open where the next cannot be opened
            self._plain = opened.enter_context(backend.open(settings))
            self._searching = SecondLook(backend, settings, max_hands=settings.max_hands)
            opened.callback(self._searching.close)
            self._averaging = SecondLook(backend, settings, max_hands=1)
            opened.callback(self._averaging.close)
            self._open = opened.pop_all()

    def close(self) -> None:
        """Give the detectors' threads and memory back."""
        self._open.close()

    def find(self, rgb: np.ndarray | None, time: float = 0.0) -> tuple[HandDetection, ...]:
        """As `Detector.find`, with sides judged."""
        if rgb is None:
            return ()
        hands = list(self._plain.find(rgb, time))
        if len(hands) < self._max_hands:
            hands += search(rgb, self._searching, hands, self._max_hands - len(hands))
        return tuple(with_side_judged([averaged(rgb, hand, self._averaging) for hand in hands]))


ALL_HANDS = 1000
"""More than any picture shows: the number that stands for all"""

SIZE = 384
"""Pixels a side of the views. The palm detector sees 192 of them, the landmark network a hand's 224."""

ENOUGH = 3
"""So many looks that agree end the search; 2 are believed when all have been made."""

GLANCES = 2
"""Where a hand is known, so many views decide in one pass each whether a search for another pays."""

TILED_FROM = 2 * SIZE
"""Longer side of pictures in which small hands are looked for as well"""

LEAST_SCORE = 0.1
"""Where the looks name both sides and few see it, it is hardly a hand."""

# Side of the view in units of the picture's longer one, turn in degrees, mirrored. Border and turns matter
# to the palm detector. Chosen one by one from eighteen, each to find the most hands still missed.
_VIEWS = (
    (2.0, 0, False),
    (1.4, 45, False),
    (2.0, 90, False),
    (2.0, -45, True),
    (1.4, 90, False),
    (2.0, 45, False),
)


def views_of(width: int, height: int) -> Iterator[View]:
    """The views of a picture that a search tries, in order."""
    centre, side = np.array([width / 2.0, height / 2.0]), max(width, height)
    for span, degrees, mirrored in _VIEWS:
        yield View.of_square(centre, span * side, SIZE, turn=np.radians(degrees), mirrored=mirrored)


def search(
    rgb: np.ndarray, second: SecondLook, known: Sequence[HandDetection], most: int
) -> list[HandDetection]:
    """At most `most` hands of a picture (H, W, 3) uint8 RGB apart from the `known` ones, each seen alike
    in two views or more."""
    height, width = rgb.shape[:2]
    views = list(views_of(width, height))
    if known and not any(_unknown(_glance(rgb, view, second), known) for view in views[:GLANCES]):
        return []  # the usual picture of one hand
    looks: list[list[HandDetection]] = []
    for view in views:
        looks.append(_unknown(second.look(rgb, view), known))
        group = largest_agreement(looks)
        if len(group) >= ENOUGH and (most == 1 or not any(_unknown(look, group) for look in looks)):
            break
    found: list[HandDetection] = []
    while len(found) < most and len(group := largest_agreement(looks)) >= 2:
        hand = mean_of(group, len(looks))
        if hand.score >= LEAST_SCORE:
            found.append(hand)
        looks = [_unknown(look, [hand]) for look in looks]
    if not known and not found:
        found = _small_hands(rgb, second, most)
    return found


MOST_TILES_ALONG = 3.0
"""Tiles side by side that span the longer side; with their overlaps there are five"""


def tiles_of(width: int, height: int) -> Iterator[View]:
    """Views that enlarge a large picture, two thirds of its shorter side each, the next half of that on;
    none for a picture that `views_of` shows in full detail."""
    if max(width, height) < TILED_FROM:
        return
    # At least so large that there are few tiles: a strip of a picture shows no hand in detail anyway.
    span = max(min(width, height) * 2.0 / 3.0, max(width, height) / MOST_TILES_ALONG)
    columns, rows = (max(2, round(2.0 * side / span) - 1) for side in (width, height))
    for y in np.linspace(span / 2.0, height - span / 2.0, rows):
        for x in np.linspace(span / 2.0, width - span / 2.0, columns):
            yield View.of_square(np.array([x, y]), span, SIZE)


def _small_hands(rgb: np.ndarray, second: SecondLook, most: int) -> list[HandDetection]:
    height, width = rgb.shape[:2]
    found: list[HandDetection] = []
    for tile in tiles_of(width, height):
        for suspected in _unknown(_glance(rgb, tile, second), found):
            hand = look_again(rgb, suspected, second)
            if hand is not None and hand.score >= LEAST_SCORE and _unknown([hand], found):
                found.append(hand)
                if len(found) == most:
                    return found
    return found


def _glance(rgb: np.ndarray, view: View, second: SecondLook) -> Sequence[HandDetection]:
    return next(iter(second.passes(rgb, view, 1)), ())


def _unknown(hands: Sequence[HandDetection], known: Sequence[HandDetection]) -> list[HandDetection]:
    return [h for h in hands if all(distance(h, other) >= 2 * SAME_HAND for other in known)]
