"""SAM 3D Body: whole bodies out of single pictures, an .npz a person, as its estimator gives them.

Of Meta's MHR70 keypoints (`sam_3d_body/metadata/mhr70.py`) 21 to 40 are the right hand's, thumb first, each
finger from its tip to its base, 41 is its wrist; 42 to 62 are the left hand's alike. `pred_keypoints_3d` are
metres in OpenCV's axes about the body, `pred_cam_t` brings them before the camera, and where that camera sees
them is `pred_keypoints_2d`, so that the two tell what camera it is.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.arrays import LARGEST
from handfit_core.errors import InputError, OptionError
from handfit_core.files import shown
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.landmarks import Landmarks
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, PointsHand, Recording
from handfit_core.media.source import DEFAULT_FPS
from handfit_core.skeleton import FINGERS, NUM_KEYPOINTS, SIDES, Side

_FIRST: Final[dict[Side, int]] = {"right": 21, "left": 42}
"""Of a hand's 21 keypoints, the wrist last"""
_OURS: Final = (20, *(4 * f + 3 - k for f in range(len(FINGERS)) for k in range(4)))
"""Our 21 keypoints among them"""
_POINTS: Final = 70
_PERSON: Final = re.compile(r"(?:subj|subject|person|human|id)_?(\d+)", re.IGNORECASE)


def _offsets() -> Landmarks:
    """Where on our hand MHR's joints lie: its wrist a centimetre nearer the knuckles, and its thumb's base
    farther out and towards the palm. Means over the eight hands of four real results, each laid over by the
    open hand in size and pose; single hands differ from them by 0.4 to 1.1 mm. The other joints are ours."""
    offsets = np.zeros((NUM_KEYPOINTS, 3))
    offsets[0] = -0.110, 0.028, -0.037
    offsets[1] = -0.103, -0.033, 0.061
    return Landmarks(offsets)


MHR_LANDMARKS: Final = _offsets()


def _recognises(document: Document) -> bool:
    if document.is_folder:
        files = document.files(".npz")
        return bool(files) and _is_one(Document(files[0]))
    return _is_one(document)


def _is_one(document: Document) -> bool:
    return document.npz is not None and {"pred_keypoints_3d", "pred_cam_t", "mhr_model_params"} <= set(
        document.npz.names
    )


def _read(document: Document, asked: Asked) -> Recording:
    files = document.files(".npz") or [document.path]
    people: dict[int, dict[int, Document]] = {}
    for row, file in enumerate(files):
        person, frame = _numbers(file, row, len(files))
        if people.setdefault(person, {}).setdefault(frame, one := Document(file)) is not one:
            raise InputError(
                f"{shown(document.path)}: {shown(people[person][frame].path.name)} and {shown(file.name)} "
                "are of one frame and person; name the files FRAME_personNUMBER.npz"
            )
    if asked.person is not None:
        chosen = sorted(people)
        if asked.person > len(chosen):
            raise OptionError(
                f"{shown(document.path)}: there is no person {asked.person}; there are {len(chosen)}"
            )
        people = {chosen[asked.person - 1]: people[chosen[asked.person - 1]]}
    numbers = np.array(sorted({frame for frames in people.values() for frame in frames}))
    hands: list[PointsHand] = []
    cameras: list[np.ndarray] = []
    for _, frames in sorted(people.items()):
        points = {side: np.full((len(numbers), NUM_KEYPOINTS, 3), np.nan) for side in SIDES}
        for frame, one in frames.items():
            body, seen = _body(one)
            if seen is not None:
                cameras.append(_camera(one, body, seen))
            row = int(np.searchsorted(numbers, frame))
            for side in SIDES:
                points[side][row] = body[_FIRST[side] :][:NUM_KEYPOINTS][list(_OURS)]
        # Metres that MHR's joints lie off ours once a hand is laid over them
        hands += [PointsHand(side, points[side], landmarks=MHR_LANDMARKS, sigma=0.002) for side in SIDES]
    assumed, camera, size = [], None, None
    if len(cameras) == sum(map(len, people.values())):
        focal, x, y = np.median(cameras, axis=0)
        if np.abs(np.array(cameras) - [focal, x, y]).max() < 0.01 * focal and focal > 0.0:
            camera = Intrinsics(float(focal), float(focal), float(x), float(y))
            size = max(1, round(2.0 * x)), max(1, round(2.0 * y))
            assumed.append(f"its pictures have {size[0]}x{size[1]} pixels, about the middle of its camera")
    if camera is None:
        assumed.append("the camera is not told: the hands are put before one of their own")
    if len(numbers) > 1 and asked.fps is None:
        assumed.append(f"{DEFAULT_FPS:g} frames per second")
    return Recording(
        "sam3d-body",
        tuple(str(file.absolute()) for file in files),
        asked.fps or DEFAULT_FPS,
        numbers,
        points=tuple(hands),
        size=size,
        intrinsics=camera,
        assumed=tuple(assumed),
    )


def _numbers(file: Path, row: int, count: int) -> tuple[int, int]:
    """Which person of which frame a file is, by its name: `0007_person1`, `img_subj01`, `0007`. The only
    number of a name that tells the person leaves the frame at 1; names without numbers go by their order."""
    found = _PERSON.search(file.stem)
    person = int(found[1]) if found else 0
    rest = file.stem[: found.start()] + file.stem[found.end() :] if found else file.stem
    last: Sequence[str] = re.findall(r"\d+(?!d)", rest)  # no 3d
    frame = int(last[-1]) if last else 1 if found or count == 1 else row + 1
    if max(frame, person) >= 1 << 31:
        raise InputError(f"{shown(file)}: the number in this name is too large for a frame's")
    return person, frame


def _body(document: Document) -> tuple[np.ndarray, np.ndarray | None]:
    """(70, 3) metres in the camera frame, and (70, 2) pixels where the file has them."""
    if not _is_one(document):
        raise InputError(
            f"{shown(document.path)}: expected a result of SAM 3D Body, with pred_keypoints_3d, pred_cam_t "
            f"and mhr_model_params; this is {document.found}"
        )
    body, place = document.array("pred_keypoints_3d"), document.array("pred_cam_t")
    told = document.npz is not None and "pred_keypoints_2d" in document.npz
    seen = document.array("pred_keypoints_2d") if told else None
    for name, array, shape in (
        ("pred_keypoints_3d", body, (_POINTS, 3)),
        ("pred_cam_t", place, (3,)),
        ("pred_keypoints_2d", seen, (_POINTS, 2)),
    ):
        if array is None:
            continue
        if array.shape not in (shape, (1, *shape)):
            raise InputError(
                f"{shown(document.path)}: {name} has the shape {array.shape}, expected {shape}, one person's "
                "of one picture"
            )
        if not (np.abs(array) <= LARGEST).all():
            raise InputError(f"{shown(document.path)}: {name} holds numbers that are none, or too large")
    body = body.reshape(_POINTS, 3) + place.reshape(3)
    return body, None if seen is None else seen.reshape(_POINTS, 2)


def _camera(document: Document, body: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """(3,) focal length and principal point, pixels, of the camera that sees the body's points there."""
    if not (body[:, 2] > 0.0).all():
        raise InputError(
            f"{shown(document.path)}: pred_keypoints_3d + pred_cam_t lie behind the camera, expected metres "
            "with z forward"
        )
    rays = body[:, :2] / body[:, 2:]
    ones, nothing = np.ones(_POINTS), np.zeros(_POINTS)
    equations = np.concatenate(
        [np.stack([rays[:, 0], ones, nothing], axis=1), np.stack([rays[:, 1], nothing, ones], axis=1)]
    )
    camera = np.linalg.lstsq(equations, seen.T.ravel(), rcond=None)[0]
    # Pixels that points in the plane may lie off those in space seen through one camera
    if np.abs(equations @ camera - seen.T.ravel()).max() > 2.0:
        raise InputError(
            f"{shown(document.path)}: pred_keypoints_2d are not where one camera sees pred_keypoints_3d + "
            "pred_cam_t; are both of the same person and picture?"
        )
    return np.asarray(camera)


READER = Reader("SAM 3D Body", "an .npz a person, or a folder of them", _recognises, _read)
