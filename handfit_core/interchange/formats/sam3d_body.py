"""SAM 3D Body: whole bodies out of single pictures, an .npz a person, as its estimator gives them.

Of Meta's MHR70 keypoints (`sam_3d_body/metadata/mhr70.py`) 21 to 40 are the right hand's, thumb first, each
finger from its tip to its base, 41 is its wrist; 42 to 62 are the left hand's alike. `pred_keypoints_3d` are
metres in OpenCV's axes about the body, `pred_cam_t` brings them before the camera, and where that camera sees
them is `pred_keypoints_2d`, so that the two tell what camera it is.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import numpy as np

from handfit_core.common.files import shown
from handfit_core.common.skeleton import FINGERS, NUM_KEYPOINTS, SIDES, Side
from handfit_core.common.values import Unfit
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.landmarks import Landmarks
from handfit_core.interchange.document import Document
from handfit_core.interchange.mano import numbers
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import PointsHand, ReadOptions, Recording
from handfit_core.interchange.settings import LIMITS

_OURS: Final = np.array([20, *(4 * f + 3 - k for f in range(len(FINGERS)) for k in range(4))])
"""Our 21 keypoints among a hand's, the wrist last"""
_FIRST: Final[dict[Side, int]] = {"left": 42, "right": 21}
_SHAPES: Final = {"pred_keypoints_3d": (70, 3), "pred_cam_t": (1, 3), "pred_keypoints_2d": (70, 2)}
_PERSON: Final = re.compile(r"(?:subj|subject|person|human|id)_?(\d+)", re.IGNORECASE)

_OFFSETS: Final = np.zeros((NUM_KEYPOINTS, 3))
_OFFSETS[:2] = [[-0.110, 0.028, -0.037], [-0.103, -0.033, 0.061]]
MHR_LANDMARKS: Final = Landmarks(_OFFSETS)
"""Where on our hand MHR's joints lie: its wrist a centimetre nearer the knuckles, and its thumb's base
farther out and towards the palm. Means over the eight hands of four real results, each laid over by the open
hand in size and pose; single hands differ from them by 0.4 to 1.1 mm. The other joints are ours."""


def _recognises(document: Document) -> bool:
    file = Document(document.files(".npz")[0]) if document.files(".npz") else document
    return {"pred_keypoints_3d", "pred_cam_t", "mhr_model_params"} <= set(file.names)


def _read(document: Document, asked: ReadOptions) -> Recording:
    files = document.files(".npz") or [document.path]
    found: dict[tuple[int, int], Path] = {}
    for row, file in enumerate(files):
        if (other := found.setdefault(_person_and_frame(file, row, len(files)), file)) is not file:
            raise Unfit(
                f"{shown(other.name)} and {shown(file.name)} are of one frame and person; name the files "
                "FRAME_personNUMBER.npz"
            )
    people = sorted({person for person, _ in found})
    if asked.person is not None and asked.person > len(people):
        raise Unfit(f"there is no person {asked.person}: it has {len(people)}")
    people = people if asked.person is None else people[asked.person - 1 : asked.person]
    found = {of: file for of, file in found.items() if of[0] in people}
    frames = np.array(sorted({frame for _, frame in found}))
    LIMITS.check(document.path, len(frames), 2 * len(people))
    points = np.full((len(people), len(frames), 2, NUM_KEYPOINTS, 3), np.nan)
    cameras = np.full((len(found), 3), np.nan)
    for row, ((person, frame), file) in enumerate(found.items()):
        body, cameras[row] = _body(Document(file))
        hands = [body[_FIRST[side] + _OURS] for side in SIDES]
        points[people.index(person), np.searchsorted(frames, frame)] = hands
    said, size, camera = "the camera is not told: the hands are put before one of their own", None, None
    focal, x, y = np.median(cameras, axis=0).tolist()
    # All files tell one and the same camera
    if focal > 0.0 and np.abs(cameras - [focal, x, y]).max() < 0.01 * focal:
        size, camera = (max(1, round(2.0 * x)), max(1, round(2.0 * y))), Intrinsics(focal, focal, x, y)
        said = f"its pictures have {size[0]}x{size[1]} pixels, about the middle of its camera"
    # 2 mm: how far MHR's joints lie off ours once a hand is laid over them
    hands = [
        PointsHand(side, points[person, :, which], landmarks=MHR_LANDMARKS, sigma=0.002)
        for person in range(len(people))
        for which, side in enumerate(SIDES)
    ]
    named = tuple(str(file.absolute()) for file in files)
    return Recording(
        "sam3d-body", named, asked.rate, frames, None, tuple(hands), (), size, camera, assumed=(said,)
    )


def _person_and_frame(file: Path, row: int, count: int) -> tuple[int, int]:
    """Return the person and the frame of a file by its name: `0007_person1`, `img_subj01`, `0007`. The only
    number of a name that tells the person leaves the frame at 1; names without numbers go by their order."""
    found = _PERSON.search(file.stem)
    person, rest = (int(found[1]), file.stem.replace(found[0], "", 1)) if found else (0, file.stem)
    last = re.findall(r"\d+(?!d)", rest)  # no 3d
    frame = int(last[-1]) if last else 1 if found or count == 1 else row + 1
    if max(frame, person) >= 1 << 31:
        raise Unfit(f"the number in the name {shown(file.name)} is too large for a frame's")
    return person, frame


def _body(document: Document) -> tuple[np.ndarray, np.ndarray]:
    """Return (70, 3) metres in the camera frame, and (3,) pixels, the focal length and the principal point of
    the camera that sees them; NaN where the file does not say. Raises Unfit."""
    name = shown(document.path.name)
    if not _recognises(document):
        raise Unfit(
            f"{name} must have pred_keypoints_3d, pred_cam_t and mhr_model_params, and is {document.found}"
        )
    told = {}
    for key, shape in _SHAPES.items():
        if key in document.names:
            told[key] = numbers(key, document.array(key), *shape)
            if len(told[key]) != 1 or not np.isfinite(told[key]).all():
                raise Unfit(f"{key} must be numbers of one person in one picture, in {name}")
    body = (told["pred_keypoints_3d"] + told["pred_cam_t"])[0]
    if "pred_keypoints_2d" not in told:
        return body, np.full(3, np.nan)
    if not (body[:, 2] > 0.0).all():
        raise Unfit("pred_keypoints_3d + pred_cam_t lie behind the camera, expected metres with z forward")
    seen = told["pred_keypoints_2d"][0].T.ravel()
    rays = (body[:, :2] / body[:, 2:]).T.ravel()
    equations = np.column_stack([rays, np.repeat(np.eye(2), 70, axis=0)])
    camera = np.linalg.lstsq(equations, seen, rcond=None)[0]
    # Pixels that points in the plane may lie off those in space seen through one camera
    if np.abs(equations @ camera - seen).max() > 2.0:
        raise Unfit(
            "pred_keypoints_2d are not where one camera sees pred_keypoints_3d + pred_cam_t; are both of the "
            "same person and picture?"
        )
    return body, np.asarray(camera)


READER = Reader(
    "SAM 3D Body",
    "an .npz a person, or a folder of them",
    _recognises,
    _read,
    "four results (2026-11)",
    "the picture's size, by its camera's centre",
)
