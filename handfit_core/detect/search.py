"""The search for every hand of a picture: palms are detected at low scores in the whole picture and in tiles
of it, the landmark network is run on each until it finds the hand again where it was, and test-time
augmentation decides."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Final

import numpy as np

from handfit_core.detect.crops import Crop, downscale
from handfit_core.detect.keypoints import Detections
from handfit_core.detect.matching import distance, is_part_of, is_same_hand, mean_detection, overlaps
from handfit_core.detect.networks import (
    NETWORK,
    Networks,
    Palms,
    augmented_crops,
    crop_around,
    square_around,
)


@dataclass(frozen=True)
class SearchSettings:
    """Thresholds and crops of the search. Presences, scores and probabilities are 0..1, turns radians."""

    min_palm_score: float = 0.07
    """Score of the palms on which the landmark network is run: far lower than that of a palm which is
    believed"""
    plain_min_palm_score: float = 0.5
    """Score of the palms on which the landmark network is run in a plain search, in place of
    `min_palm_score`"""

    max_passes: int = 3
    """Most predictions for one candidate, each in the crop around the landmarks of the prediction before"""
    min_first_presence: float = 0.02
    """Presence of the first prediction below which there is no second one"""
    min_presence: float = 0.1
    """Presence of the last prediction below which there is no hand"""
    converged_distance: float = 0.05
    """Distance in hand sizes; landmarks that a pass moves less than this need no other pass"""
    converged_presence: float = 0.9
    """Presence that the last two predictions must both exceed for the landmarks to need no other pass"""

    early_crops: int = 3
    """Crops of test-time augmentation after which unlikely candidates are given up"""
    min_early_probability: float = 0.06
    """Probability that a candidate must have after `early_crops` crops, or else is given up"""

    tile_divisors: tuple[int, ...] = (1, 2, 3)
    """How many times smaller than the picture's side a tile's side is, for each set of tiles; tiles overlap
    by half"""
    min_tile_px: int = 96
    """Least side of a tile, in pixels"""
    tile_to_smallest_hand: float = 8.0
    """Side of a tile in sizes of the smallest hand that the palm network finds in it"""
    max_size_ratio: float = 2.5
    """Largest ratio of sizes that is expected between the largest and the smallest hand of one picture"""
    max_palm_search_px: int = 1152
    """Longest side in pixels of the picture in which palms are searched; larger ones are downscaled. Tiles of
    a third need no more"""
    whole_picture_crops: tuple[tuple[float, float, bool], ...] = (
        (1.0, 0.0, False),
        (1.5, 0.0, False),
        (1.5, np.pi / 2.0, False),
        (1.5, -np.pi / 2.0, False),
        (1.5, -np.pi / 4.0, False),
        (1.5, np.pi / 4.0, True),
        (2.2, 0.0, False),
        (2.2, np.pi, False),
    )
    """Crops of the whole picture: side in units of the picture's longer one, turn in radians, and True for a
    mirrored one. Hands that fill the picture need room around them, and the palm network finds some
    directions better than others"""

    neighbour_span: float = 8.0
    """Side, in hand sizes, of the crops about a hand in which another one of its size shows best"""
    neighbour_turns: tuple[float, ...] = (0.0, 0.75 * np.pi)
    """Turns, in radians, of the crops about a hand in which another one is searched"""
    max_neighbour_searches: int = 4
    """Most hands of a picture about which other hands are searched"""

    missed_probability: tuple[float, float] = (0.3, 0.18)
    """Probability from which a candidate that was not taken for a hand makes another hand likely: beside an
    even number of hands, and beside an odd one; candidates that are tangled with a hand count, too. Hands
    come in pairs, and around single ones there are no such candidates"""
    missed_palm_score: float = 0.5
    """Score of a palm beside an odd number of hands from which another hand is likely"""
    missed_palm_distance: tuple[float, float] = (0.8, 6.0)
    """Least and greatest distance between the palm of `missed_palm_score` and the nearest hand, in hand
    sizes"""
    missed_palm_size: tuple[float, float] = (0.5, 1.5)
    """Least and greatest side of that palm's box, in sizes of the nearest hand"""

    same_candidate_distance: float = 0.15
    """Distance in hand sizes below which two predictions are of one candidate"""
    doubtful_probability: tuple[float, float] = (0.1, 0.85)
    """Least and greatest probability of the candidates that are verified by rotation recall and context
    score"""
    probability_weights: tuple[float, float, float] = (0.95, 0.75, -1.3)
    """Weights in the logit of a candidate's probability: of the logits of presence and palm score, and a
    constant. In photos of people and in rendered pictures, at a probability of a half one hand of twenty is
    false"""
    verified_weights: tuple[float, float, float] = (1.4, 0.75, -0.8)
    """Weights in place of `probability_weights` for a verified candidate. They and the next two weights were
    chosen on 150 doubtful candidates of rendered pictures and photos"""
    recall_weight: float = 2.0
    """Weight of the rotation recall in a verified candidate's logit"""
    context_weight: float = 0.3
    """Weight of the logit of the context score in a verified candidate's logit"""

    rotations: int = 12
    """Number of evenly spread turns of the crops about a box that a person drew, and about a doubtful
    candidate"""
    recall_spans: tuple[float, ...] = (1.8,)
    """Sides of the rotated crops about a candidate, in hand sizes"""
    context_span: float = 7.0
    """Side of the crops for the context score, in hand sizes"""
    context_turns: tuple[float, ...] = (0.6, -0.6)
    """Turns, in radians against the hand, of the crops for the context score; besides these there is one crop
    turned as the hand and one as the picture is"""
    context_min_palm_score: float = 0.01
    """Score below which a palm in the crops for the context score counts as not detected"""

    box_spans: tuple[float, ...] = (1.3, 1.8, 2.6)
    """Sides of the rotated crops about a person's box, in units of its longer side"""
    box_min_presence: float = 0.1
    """Least presence of a hand in a person's box: where somebody says that there is a hand, the network need
    not be sure"""
    box_candidates: int = 4
    """How many of the hands that most crops of a box agree on are judged by test-time augmentation"""
    box_min_presence_beside: float = 0.5
    """Least presence of a second hand in a box in which a known hand is found, too"""
    box_min_crops_beside: int = 3
    """Least number of crops that must agree on a second hand in a box. Around single hands no more than two
    agree on what is none"""
    box_better: float = 2.0
    """How many times as much presence times agreeing crops must be for what is found in the place of a known
    hand to replace it"""


SEARCH: Final = SearchSettings()


@dataclass(frozen=True, eq=False)
class Candidate:
    """A detection that may be a hand, with what tells how likely it is one."""

    hand: Detections
    presence: float
    """Mean presence over the candidate's predictions, 0..1"""
    palm_score: float
    """Best score of the candidate's palm, 0..1"""
    rotation_recall: float | None = None
    """Share, 0..1, of the rotated crops about the candidate in which it was found again; None: it was not
    verified"""
    context_score: float = 0.0
    """Best score of the candidate's palm in crops that show much around it, 0..1"""

    @property
    def likely_hand(self) -> Detections:
        """The candidate's hand, with the candidate's probability as its certainty."""
        return replace(self.hand, certainty=np.array([self.probability]))

    @property
    def probability(self) -> float:
        """Probability, 0..1, that the candidate is a hand."""
        verified = self.rotation_recall is not None
        presence, palm_score, logit = SEARCH.verified_weights if verified else SEARCH.probability_weights
        logit += presence * _logit(self.presence) + palm_score * _logit(self.palm_score)
        if self.rotation_recall is not None:
            context = SEARCH.context_weight * _logit(self.context_score)
            logit += SEARCH.recall_weight * self.rotation_recall + context
        return float(1.0 / (1.0 + np.exp(-logit)))


def tiles(width: int, height: int, divisor: int) -> Iterator[Crop]:
    """Yield overlapping crops for the palm network that tile a picture of that size in pixels; the side of
    each is the picture's longer side over `divisor`."""
    span = max(width, height) / divisor
    if divisor > 1 and span < SEARCH.min_tile_px:
        return
    columns, rows = (max(1, int(np.ceil(2.0 * (side / span - 1.0) + 1.0 - 1e-6))) for side in (width, height))
    for y in _centres(height, span, rows):
        for x in _centres(width, span, columns):
            yield Crop.of_square(np.array([x, y]), span, NETWORK.palm_input_px)


def _centres(side: float, span: float, count: int) -> np.ndarray:
    return np.linspace(span / 2.0, side - span / 2.0, count) if count > 1 else np.array([side / 2.0])


class Search:
    """Searches pictures (H, W, 3) uint8 RGB for hands with both networks.

    A plain search takes sure palms in the whole picture only, and one prediction each. Quality `draft` has
    one prediction each, too.
    """

    def __init__(self, networks: Networks, threshold: float, *, plain: bool = False) -> None:
        self._networks = networks
        self._threshold = threshold
        self._divisors = SEARCH.tile_divisors[:1] if plain else SEARCH.tile_divisors
        self._min_palm_score = SEARCH.plain_min_palm_score if plain else SEARCH.min_palm_score
        self._crop_count = 1 if plain or networks.quality == "draft" else NETWORK.augmentation_crops
        self.missed = False
        """True if the last search has left what may well be another hand"""
        self._palms: list[Palms] = []
        """The palms that the last search has looked at"""
        self._rejected: list[Candidate] = []
        """Candidates of the last search that share their place with a likelier one"""

    def detect_all(self, rgb: np.ndarray) -> list[Detections]:
        """Return the hands of a picture, the likeliest first."""
        self._palms, self._rejected = [], []
        longest = max(rgb.shape[:2])
        block = max(1, longest // SEARCH.max_palm_search_px)
        small = downscale(rgb, block, block)
        height, width = small.shape[:2]
        found: list[Candidate] = []
        for divisor in self._divisors:
            largest = max((float(c.hand.extent[0]) for c in found if self._accepts(c)), default=0.0)
            # Hands so small that only these tiles show them are not expected beside the largest one.
            if largest * SEARCH.tile_to_smallest_hand * (divisor - 1) > longest * SEARCH.max_size_ratio:
                break
            crops = list(tiles(width, height, divisor))
            if divisor == 1 and len(self._divisors) > 1:
                middle, side = np.array([width, height]) / 2.0, max(width, height)
                crops = [
                    Crop.of_square(middle, span * side, NETWORK.palm_input_px, turn=turn, mirrored=mirrored)
                    for span, turn, mirrored in SEARCH.whole_picture_crops
                ]
            if crops:
                found = self._extend(rgb, self.detect_palms(small, crops).scaled(block), found)
        if len(self._divisors) > 1:
            sure = [c.hand for c in found if self._accepts(c)]
            neighbours = list(self._neighbour_crops(sure, max(rgb.shape)))
            if neighbours:
                found = self._extend(rgb, self.detect_palms(rgb, neighbours), found)
        found = self._verify(rgb, found)
        self._note_missed(found)
        return [c.likely_hand for c in found if self._accepts(c)]

    def detect_new(self, rgb: np.ndarray, palms: Palms, known: Detections) -> list[Detections]:
        """Return the hands that these palms belong to, without the `known` ones. A likely hand has a single
        prediction, as tracked hands have."""
        self._palms, self._rejected = [], []
        sure = [Candidate(hand, 1.0, 1.0) for hand in known]
        found = self._extend(rgb, palms, sure, augment_all=False)
        self._note_missed(found)
        return [c.hand for c in found if self._accepts(c) and c not in sure]

    def detect_in_box(
        self, rgb: np.ndarray, box: Sequence[float], known: Sequence[Detections] = ()
    ) -> Detections | None:
        """Return the hand that a person sees in a box (x, y, width, height), pixels, at whatever angle; None
        where there is none.

        It is the hand that most rotated crops agree on, among those that do not lie on `known` hands of the
        picture. Where there is none of these, it is the known hand itself, or what is clearly better in its
        place.
        """
        corner, size = np.array(box[:2]), np.array(box[2:])
        middle, side = corner + size / 2.0, float(size.max())
        groups: list[list[Detections]] = []
        for prediction in self._predict_rotated(rgb, middle, side, SEARCH.box_spans):
            if prediction is not None and _fits_box(prediction, middle, size):
                same = next((g for g in groups if _is_same(g[0], prediction)), None)
                groups.append([prediction]) if same is None else same.append(prediction)
        groups.sort(key=len, reverse=True)

        def known_at(hand: Detections) -> Detections | None:
            return next((k for k in known if overlaps(hand, k)), None)

        new, _, count = self._best_of(rgb, [g for g in groups if known_at(g[0]) is None])
        on_known = [g for g in groups if known_at(g[0]) is not None]
        again, score, _ = self._best_of(rgb, on_known)
        if new is not None and known_at(new.hand) is None:
            beside = new.presence >= SEARCH.box_min_presence_beside and count >= SEARCH.box_min_crops_beside
            if beside or (again is None and new.presence >= SEARCH.box_min_presence):
                return new.likely_hand
        kept = None if again is None else known_at(again.hand)
        if again is None or kept is None or _is_same(again.hand, kept):
            return kept
        _, least, _ = self._best_of(rgb, [g for g in on_known if _is_same(g[0], kept)])
        better = score >= SEARCH.box_better * max(least, 1.0)
        return again.likely_hand if better else kept

    def _best_of(
        self, rgb: np.ndarray, groups: Sequence[list[Detections]]
    ) -> tuple[Candidate | None, float, int]:
        """Return the likeliest of groups of agreeing predictions, the largest group first, after test-time
        augmentation, with its score and the size of its group; None and zeros where there is none."""
        augmented = [(self._augment(rgb, g[0], 0.5), len(g)) for g in groups[: SEARCH.box_candidates]]
        scored = [(c, c.presence * (1 + count), count) for c, count in augmented]
        return max(scored, key=lambda each: each[1], default=(None, 0.0, 0))

    def _note_missed(self, found: Sequence[Candidate]) -> None:
        """Set `missed` from all candidates and palms of the search."""
        accepted = [c for c in found if self._accepts(c)]
        hands = Detections.of([[c.hand for c in accepted]])
        least = SEARCH.missed_probability[len(hands) % 2]
        self.missed = any(
            c.probability >= least and not overlaps(c.hand, hands)
            for c in (*found, *self._rejected)
            if not any(c.hand is other.hand for other in accepted)
        ) or (len(hands) % 2 == 1 and any(_is_beside(palms, hands) for palms in self._palms))

    def _accepts(self, candidate: Candidate) -> bool:
        return candidate.probability >= self._threshold

    def _verify(self, rgb: np.ndarray, found: Sequence[Candidate]) -> list[Candidate]:
        """Return the candidates, the likeliest first: doubtful ones get their rotation recall and context
        score, and parts of likelier hands are dropped."""
        kept: list[Candidate] = []
        low, high = SEARCH.doubtful_probability
        for candidate in found:
            if self._crop_count == NETWORK.augmentation_crops and low < candidate.probability < high:
                hand = candidate.hand
                if any(is_part_of(hand, c.hand) for c in kept if self._accepts(c)):
                    continue
                context = self._context_score(rgb, hand)
                candidate = self._with_rotation_recall(rgb, replace(candidate, context_score=context))
            kept.append(candidate)
        return sorted(kept, key=lambda c: c.probability, reverse=True)

    def _neighbour_crops(self, hands: Sequence[Detections], longer: int) -> Iterator[Crop]:
        """Yield crops about the first hands in which other hands of about their size would be seen, in a
        picture whose longer side is `longer` pixels: the second hand of a pair often has a palm that no tile
        shows."""
        begun: list[tuple[np.ndarray, float]] = []
        for hand in hands:
            centre, span = hand.centroid[0], SEARCH.neighbour_span * float(hand.extent[0])
            searched = any(np.abs(centre - c).max() < s / 4.0 and 0.7 < span / s < 1.4 for c, s in begun)
            inside = span < SEARCH.whole_picture_crops[-1][0] * longer
            if not searched and inside and len(begun) < SEARCH.max_neighbour_searches:
                begun.append((centre, span))
                for turn in SEARCH.neighbour_turns:
                    yield Crop.of_square(centre, span, NETWORK.palm_input_px, turn=turn)

    def _with_rotation_recall(self, rgb: np.ndarray, candidate: Candidate) -> Candidate:
        """Return the candidate with its rotation recall, or with an upper bound of it that already rules the
        hand out."""
        hand, count = candidate.hand, 0
        middle, side = (hand.box_min[0] + hand.box_max[0]) / 2.0, float(hand.extent[0])
        rotated = self._predict_rotated(rgb, middle, side, SEARCH.recall_spans)
        for tried, prediction in enumerate(rotated, start=1):
            count += prediction is not None and _is_same(prediction, candidate.hand)
            best = (count + SEARCH.rotations - tried) / SEARCH.rotations
            if not self._accepts(replace(candidate, rotation_recall=best)):
                break
        return replace(candidate, rotation_recall=count / SEARCH.rotations)

    def _context_score(self, rgb: np.ndarray, hand: Detections) -> float:
        """Return the best score, 0..1, of a hand's palm in crops that show much around it; 0 where it is not
        detected."""
        centre, _, upright = square_around(hand.keypoints[0])
        best = 0.0
        turns = (0.0, upright, *(upright + more for more in SEARCH.context_turns))
        span = SEARCH.context_span * float(hand.extent[0])
        crops = [Crop.of_square(centre, span, NETWORK.palm_input_px, turn=turn) for turn in turns]
        min_score = SEARCH.context_min_palm_score
        for palms in self._networks.map(lambda n, crop: n.detect_palms(rgb, crop, min_score), crops):
            best = max(best, *(float(palms.score[i]) for i in range(len(palms)) if palms.is_of(i, hand)), 0.0)
        return best

    def _predict_rotated(
        self, rgb: np.ndarray, middle: np.ndarray, side: float, spans: Sequence[float]
    ) -> Iterator[Detections | None]:
        """Yield the refined predictions for crops of all rotations about a box with that middle (2,) and
        longer side, pixels; None for a crop without a hand."""
        turns = np.arange(SEARCH.rotations) * (2.0 * np.pi / SEARCH.rotations)
        crops = [
            Crop.of_square(middle, span * side, NETWORK.hand_input_px, turn=t)
            for span in spans
            for t in turns
        ]
        return self._networks.map(lambda n, crop: refine(n, rgb, crop, SEARCH.box_min_presence), crops)

    def detect_palms(self, rgb: np.ndarray, crops: Sequence[Crop]) -> Palms:
        """Return the palms in these crops, each `palm_input_px` wide, after non-maximum suppression."""
        found = self._networks.map(lambda n, crop: n.detect_palms(rgb, crop, self._min_palm_score), crops)
        return Palms.suppressed(list(found))

    def _extend(
        self, rgb: np.ndarray, palms: Palms, known: Sequence[Candidate], *, augment_all: bool = True
    ) -> list[Candidate]:
        """Return the known candidates and the hands of new palms after non-maximum suppression, the likeliest
        first. Unless `augment_all`, likely ones have one prediction only."""
        found = list(known)
        self._palms.append(palms)
        predictions: dict[int, Detections | None] = {}
        for i in range(len(palms)):
            palm_score = float(palms.score[i])
            same = next((c for c in found if palms.is_of(i, c.hand)), None)
            if same is None and i not in predictions:
                others = (j for j in range(i, len(palms)) if not any(palms.is_of(j, c.hand) for c in found))
                ahead = list(islice(others, self._networks.threads))
                crops = [palms.crop(j) for j in ahead]
                refined = self._networks.map(lambda n, crop: refine(n, rgb, crop), crops)
                predictions |= dict(zip(ahead, refined, strict=True))
            prediction = None if same is not None else predictions[i]
            if prediction is not None:
                same = next((c for c in found if _is_same(c.hand, prediction)), None)
            if same is not None and palm_score > same.palm_score:
                found.append(replace(same, palm_score=palm_score))
            elif same is None and prediction is not None:
                first = Candidate(prediction, float(prediction.certainty[0]), palm_score)
                likely = first.probability > SEARCH.doubtful_probability[1]
                enough = likely and not augment_all
                found.append(first if enough else self._augment(rgb, prediction, palm_score))
        found.sort(key=lambda c: c.probability, reverse=True)
        hands = Detections.of([[candidate.hand for candidate in found]])
        kept: list[int] = []
        for row, hand in enumerate(hands):
            if is_same_hand(hand, hands.select(np.array(kept, dtype=int))).any():
                self._rejected.append(found[row])
            else:
                kept.append(row)
        return [found[row] for row in kept]

    def _augment(self, rgb: np.ndarray, first: Detections, palm_score: float) -> Candidate:
        """Average the test-time augmentation about a prediction into a candidate; unlikely ones are given up
        early."""
        predictions, candidate = [first], Candidate(first, float(first.certainty[0]), palm_score)
        crops = list(islice(augmented_crops(first.keypoints[0]), 1, self._crop_count))
        for prediction in self._networks.map(lambda n, crop: n.predict(rgb, crop), crops):
            predictions.append(prediction)
            candidate = replace(candidate, presence=float(np.mean([p.certainty[0] for p in predictions])))
            unlikely = candidate.probability < SEARCH.min_early_probability
            if unlikely and len(predictions) == SEARCH.early_crops:
                break
        return replace(candidate, hand=mean_detection(Detections.of([predictions])))


def refine(
    networks: Networks, rgb: np.ndarray, crop: Crop, min_presence: float = SEARCH.min_presence
) -> Detections | None:
    """Predict a hand in a crop, and then in the crops around the landmarks found, until these stay where they
    are; return None where there is no hand."""
    prediction = networks.predict(rgb, crop)
    for _ in range(SEARCH.max_passes - 1):
        if prediction.certainty[0] < SEARCH.min_first_presence:
            return None
        before, prediction = prediction, networks.predict(rgb, crop_around(prediction.keypoints[0]))
        sure = min(before.certainty[0], prediction.certainty[0]) > SEARCH.converged_presence
        if sure and distance(before, prediction) < SEARCH.converged_distance:
            break
    return prediction if prediction.certainty[0] >= min_presence else None


def _is_beside(palms: Palms, hands: Detections) -> bool:
    """True if one of these palms may well be that of another hand beside these hands (H >= 1)."""
    off = palms.centre[:, None] - hands.centroid
    apart = np.linalg.norm(off, axis=-1) / hands.extent
    ratio = palms.side / hands.extent[apart.argmin(axis=1)]
    (near, far), (small, large) = SEARCH.missed_palm_distance, SEARCH.missed_palm_size
    apart = apart.min(axis=1)
    likely = palms.score >= SEARCH.missed_palm_score
    return bool((likely & (apart > near) & (apart < far) & (ratio > small) & (ratio < large)).any())


def _is_same(a: Detections, b: Detections) -> bool:
    """Return True if two predictions are so near each other that they are of one candidate."""
    return bool(distance(a, b) < SEARCH.same_candidate_distance)


def _fits_box(hand: Detections, middle: np.ndarray, size: np.ndarray) -> bool:
    """Return True if a hand lies in a box with that middle and size, pixels, and is about as large."""
    off, longer = np.abs((hand.box_min[0] + hand.box_max[0]) / 2.0 - middle), float(size.max())
    return bool((off < size / 2.0 + 0.1 * longer).all()) and 0.45 < hand.extent[0] / longer < 2.0


def _logit(probability: float) -> float:
    within = min(max(probability, 0.01), 0.99)
    return float(np.log(within / (1.0 - within)))
