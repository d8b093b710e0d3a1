"""Dyn-HaMR: *_world_results.npz with right hands' parameters, of which left hands are the mirror images.

The mirror is at x = 0 of the world and takes trans along: a left hand's orientation and place are
M R M and M trans. cam_R and cam_t lead from the world to the camera of each frame.
"""

from __future__ import annotations

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.axes import MIRROR_X
from handfit_core.hand_model.motion import HandMotion
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording
from handfit_core.skeleton import SIDES, Side


def _recognises(document: Document) -> bool:
    names = set(document.names)
    return {"trans", "root_orient", "is_right"} <= names and bool({"pose_body", "latent_pose"} & names)


def _read(document: Document, asked: Asked) -> Recording:
    assumed: list[str] = []
    right = np.asarray(document.value("is_right"), dtype=np.float64)
    if right.ndim != 2 or not right.size:
        raise Unfit("is_right must have the shape BxT: tracks and frames")
    tracks, count = right.shape
    pose_name = "pose_body" if "pose_body" in document.names else "latent_pose"
    orients = _of_tracks(document, "root_orient", 3, tracks, count)
    poses = _of_tracks(document, pose_name, mano.POSE, tracks, count)
    places = _of_tracks(document, "trans", 3, tracks, count)
    shapes = document.value("betas")
    posed = []
    for track in range(tracks):
        side: Side = "right" if np.mean(right[track] > 0.5) >= 0.5 else "left"
        orient = mano.rotations("root_orient", orients[track], 1, count)
        pose = mano.rotations(pose_name, poses[track], 15, count)
        transl = places[track]
        if side == "left":
            orient, pose = mano.left_of_right(orient, pose)
            transl = transl @ MIRROR_X
        pose = mano.from_flat(pose, side, asked, "flat")
        betas = None if shapes is None or len(shapes) != tracks else shapes[track]
        hand = HandMotion(side, mano.shape_of(betas, asked, assumed), orient, pose, transl)
        posed.append(_before_its_camera(document, hand, asked, track, tracks, count, assumed))
    if asked.person is not None:
        of_side = {side: [hand for hand in posed if hand.side == side] for side in SIDES}
        posed = [hand for hands in of_side.values() for hand in hands[asked.person - 1 : asked.person]]
        if not posed:
            raise Unfit(f"there is no person {asked.person}: it has {max(map(len, of_side.values()))}")
    size, camera = _camera(document, assumed)
    return mano.recording_of(
        "dyn-hamr",
        document,
        asked.rate,
        np.arange(1, count + 1),
        posed,
        asked,
        assumed,
        chosen=True,
        mirrored_by="its is_right may be wrong",
        size=size,
        intrinsics=camera,
    )


def _of_tracks(document: Document, name: str, each: int, tracks: int, count: int) -> np.ndarray:
    array = mano.numbers(name, document.value(name), each)
    if len(array) != tracks * count:
        raise Unfit(f"{name} must have {tracks} tracks of {count} frames, and has {len(array)} rows")
    return array.reshape(tracks, count, each)


def _before_its_camera(
    document: Document,
    hand: HandMotion,
    asked: Asked,
    track: int,
    tracks: int,
    count: int,
    assumed: list[str],
) -> HandMotion:
    turned, moved = document.value("cam_R"), document.value("cam_t")
    if turned is None or moved is None:
        mano.tell(assumed, "the camera is not told (cam_R, cam_t): the world was taken to have its axes")
        return hand
    rotation = mano.numbers("cam_R", turned, 3, 3)
    translation = mano.numbers("cam_t", moved, 3)
    if len(rotation) != len(translation) or len(rotation) not in (count, tracks * count):
        raise Unfit(f"cam_R and cam_t must have {count} frames, and have {len(rotation)}, {len(translation)}")
    rows = slice(track * count, (track + 1) * count) if len(rotation) == tracks * count else slice(None)
    return mano.seen_from(hand, asked, mano.checked_matrices("cam_R", rotation[rows]), translation[rows])


def _camera(document: Document, assumed: list[str]) -> tuple[tuple[int, int] | None, Intrinsics | None]:
    """The picture's size is twice the principal point, which Dyn-HaMR puts into the middle."""
    told = document.value("intrins")
    if told is None:
        return None, None
    fx, fy, cx, cy = map(float, mano.numbers("intrins", told, 4)[0])
    size = round(2.0 * cx), round(2.0 * cy)
    if not all(0 < side < 1 << 24 for side in size):
        raise Unfit(f"intrins must be fx, fy, cx, cy in pixels, and has cx {cx:g}, cy {cy:g}")
    mano.tell(assumed, f"pictures of {size[0]}x{size[1]} pixels, twice the principal point")
    return size, Intrinsics(fx, fy, cx, cy)


READER = Reader(
    "Dyn-HaMR",
    "an .npz (*_world_results.npz) with trans, root_orient, pose_body and is_right",
    _recognises,
    _read,
)
