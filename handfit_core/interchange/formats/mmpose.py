"""MMPose's JSON of whole-body and hand models: the inferencer's, and that of its demos.

Layouts after mmpose/apis/inferencers/base_mmpose_inferencer.py (a list of
{frame_id, instances}, frames from 0; one list of instances a picture), mmpose/structures/utils.py (keypoints,
keypoint_scores) and
demo/topdown_demo_with_mmdet.py ({meta_info, instance_info}, frames from 1); the points' order after
configs/_base_/datasets/coco_wholebody.py. ViTPose's and RTMPose's whole-body models have that order, too.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from handfit_core.errors import InputError
from handfit_core.files import shown
from handfit_core.interchange.document import Document
from handfit_core.interchange.gather import (
    Gathering,
    check_person,
    check_some,
    of_person,
    seen_hands,
    with_sides,
    without_hidden,
)
from handfit_core.interchange.numbered import JsonFrames, frames_of, some_contents
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.skeleton import NUM_KEYPOINTS, Side

_HANDS_OF: Final[dict[int, dict[Side | None, int]]] = {
    133: {"left": 91, "right": 112},
    136: {"left": 94, "right": 115},
    NUM_KEYPOINTS: {None: 0},
}
"""The first point of each hand, by how many points an instance has: COCO-WholeBody, Halpe, and hands alone"""
LEAST_MEAN: Final = 0.3
"""Mean score below which MMPose's demos draw no point (--kpt-thr)"""


def _instances(content: Any) -> list[Any] | None:
    """The instances of one frame, or of a picture alone; None where this is no such frame."""
    found = content.get("instances") if isinstance(content, dict) else content
    if not isinstance(found, list):
        return None
    fit = all(isinstance(each, dict) and {"keypoints", "keypoint_scores"} <= set(each) for each in found)
    return found if fit else None


def _recognises(document: Document) -> bool:
    return any(map(_is_mmposes, some_contents(document)))


def _is_mmposes(content: Any) -> bool:
    """Whether JSON is one of MMPose's, and not only an empty list, as of a picture without anybody."""
    if isinstance(content, dict):
        return "instance_info" in content or (
            "instances" in content and _instances(content) is not None and "frame_id" in content
        )
    if not isinstance(content, list):
        return False
    if content and isinstance(content[0], dict) and "instances" in content[0]:
        return _instances(content[0]) is not None
    return bool(content) and bool(_instances(content))


def _frames(document: Document) -> JsonFrames:
    content = document.json
    if isinstance(content, dict) and isinstance(content.get("instance_info"), list):
        content = content["instance_info"]
        if _instances(content):
            return JsonFrames(np.array([1]), [content], {})
    elif isinstance(content, list) and _instances(content):
        return JsonFrames(np.array([1]), [content], {})
    return frames_of(document)


def _read(document: Document, asked: Asked) -> Recording:
    frames, path = _frames(document), shown(document.path)
    gathered, most = Gathering(), 0
    for row, content in enumerate(frames.contents):
        instances = _instances(content)
        if instances is None:
            raise InputError(
                f"{path}: frame {frames.numbers[row]} has no list of instances with keypoints and "
                "keypoint_scores, as MMPose writes it"
            )
        most = max(most, len(instances))
        for number, instance in of_person(instances, asked.person):
            assert isinstance(instance, dict)
            try:
                points = np.array(instance["keypoints"], dtype=np.float64)
                scores = np.array(instance["keypoint_scores"], dtype=np.float64).reshape(-1)
            except (TypeError, ValueError, OverflowError):
                points, scores = np.zeros((0, 0)), np.zeros(0)
            if points.shape != (len(scores), 2) or len(points) not in _HANDS_OF:
                raise InputError(
                    f"{path}: an instance of frame {frames.numbers[row]} has keypoints of the shape "
                    f"{points.shape} with {len(scores)} scores; expected 133 of COCO-WholeBody, 136 of Halpe "
                    "or 21 of a hand, each x and y"
                )
            for side, first in _HANDS_OF[len(points)].items():
                mine = slice(first, first + NUM_KEYPOINTS)
                gathered.add(row, points[mine], side, scores[mine], hand=number)
    check_person(asked.person, most, path)
    hands, hidden = without_hidden(gathered.hands(), LEAST_MEAN)
    check_some(hands, f"{path}: MMPose's instances")
    hands, sides = with_sides(hands, asked.hands, None)
    return Recording(
        "mmpose",
        (str(document.path.absolute()),),
        asked.rate,
        frames.numbers,
        seen_hands(hands),
        assumed=(*frames.assumed, *hidden, *sides),
    )


READER = Reader(
    "MMPose",
    "JSON of its inferencer or demos, with instances of 133 whole-body or 21 hand keypoints",
    _recognises,
    _read,
)
