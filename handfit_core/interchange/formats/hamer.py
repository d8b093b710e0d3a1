"""What users keep of HaMeR's, WiLoR's and WiLoR-mini's results: MANO's parameters of the hands in pictures.

HaMeR and WiLoR give rotation matrices, a left hand's as those of the right hand in the crop that they have
mirrored; WiLoR-mini gives axis-angle, and has mirrored left hands back. None adds a mean. Their own programs
write no parameters, so that names vary: those of the network's output are known, and what users make of them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from handfit_core.doors.values import Unfit
from handfit_core.files import shown
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model.axes import mirrored_pose
from handfit_core.interchange import mano
from handfit_core.interchange.document import Document
from handfit_core.interchange.json_points import several_clips
from handfit_core.interchange.readers import Reader
from handfit_core.interchange.recording import Asked, Recording

_SUFFIXES: Final = (".npz", ".json", ".npy", ".pkl")
_NAMES: Final = {
    "nested": ("pred_mano_params", "mano_params", "wilor_preds"),
    "right": ("right", "is_right"),
    # Not pred_cam_t, which is HaMeR's for the crop alone
    "place": ("pred_cam_t_full", "cam_t_full", "cam_t"),
    "frame": ("frame", "frames", "frame_id", "frame_ids", "frame_idx"),
}
_NUMBERS: Final = re.compile(r"(?<!\d)\d{1,18}(?!\d)")
_MOST_DIGITS: Final = 2
"""of a hand's number in a file's name; longer ones are frames'"""


@dataclass(frozen=True, eq=False)
class _Part:
    """The hands of one dictionary."""

    values: dict[str, Any]
    frame: int | None = None
    name: str | None = None
    """That of its file or its key, where it has the frame's number"""


def _flat(document_or_dict: Any) -> dict[str, Any]:
    """The values of a dictionary, those within its part with the parameters among them."""
    if isinstance(document_or_dict, Document):
        held = {name: document_or_dict.value(name) for name in document_or_dict.names}
    else:
        held = document_or_dict
    flat: dict[str, Any] = {}
    for name, value in held.items():
        key = str(name)
        if key in _NAMES["nested"] and isinstance(value, dict):
            flat.update({str(k): v for k, v in value.items()})
        else:
            # np.savez makes "pred_mano_params.hand_pose" or "pred_mano_params_hand_pose" of a loop's names.
            for nested in _NAMES["nested"]:
                key = key.removeprefix(f"{nested}.").removeprefix(f"{nested}_").removeprefix(f"{nested}/")
            flat[key] = value
    return flat


def _is_hand(held: Any) -> bool:
    return (
        isinstance(held, dict)
        and {"global_orient", "hand_pose"} <= set(held)
        and any(name in held for name in _NAMES["right"])
    )


def _first(document: Document) -> dict[str, Any] | None:
    """The first dictionary with hands; None where there is none."""
    if document.is_folder:
        files = document.files(*_SUFFIXES)
        return _first(Document(files[0])) if files else None
    names = set(document.names)
    if names:
        shown = names | {part for name in names for part in re.split(r"[./]", name)}
        if not (names & set(_NAMES["nested"]) or {"hand_pose", "global_orient"} <= shown or _numbered(names)):
            return None
        if not _numbered(names):
            flat = _flat(document)
            return flat if _is_hand(flat) else None
    try:
        return next((part.values for part in _parts(document) if _is_hand(part.values)), None)
    except Unfit:
        return None


def _numbered(names: Any) -> bool:
    """Whether keys are frames: numbers, or names of pictures."""
    return bool(names) and all(re.search(r"\d+", str(name)) for name in names)


def _parts(document: Document) -> Iterator[_Part]:
    """The dictionaries with hands in a file, or in the files of a folder."""
    if document.is_folder:
        for path in document.files(*_SUFFIXES):
            for part in _parts(Document(path)):
                yield replace(part, name=path.stem) if _NUMBERS.search(path.stem) else part
        return
    names = document.names
    if names and not _numbered(names):
        yield _Part(_flat(document))
        return
    held = document.json if document.json is not None else document.objects
    if isinstance(held, dict):
        for name, value in held.items():
            key = str(name) if _NUMBERS.search(str(name)) else None
            for values in value if isinstance(value, list) else [value]:
                if isinstance(values, dict):
                    yield _Part(_flat(values), name=key)
    elif isinstance(held, list):
        for row, value in enumerate(held):
            for values in value if isinstance(value, list) else [value]:
                if isinstance(values, dict):
                    of_row = row + 1 if isinstance(value, list) else None
                    yield _Part(_flat(values), of_row)


def _by_names(names: Collection[str], assumed: list[str]) -> dict[str, int]:
    """The frames that files or keys are of, by their last numbers, or by those before them where the last
    ones count the hands of a picture. Raises Unfit for names of several clips."""
    found = {name: [*_NUMBERS.finditer(name)] for name in names}
    if not found:
        return {}
    around = {(name[: each[-1].start()], name[each[-1].end() :]) for name, each in found.items()}
    if len(around) == 1:
        if any(len(each) > 1 and len(each[-1][0]) <= _MOST_DIGITS for each in found.values()):
            mano.tell(assumed, f"the last numbers in the names are the frames', as in {shown(min(names))}")
        return {name: int(each[-1][0]) for name, each in found.items()}
    if all(len(each) > 1 and len(each[-1][0]) <= _MOST_DIGITS for each in found.values()):
        beside = {
            (name[: each[-2].start()], name[each[-2].end() : each[-1].start()], name[each[-1].end() :])
            for name, each in found.items()
        }
        if len(beside) == 1:
            mano.tell(assumed, f"the last numbers in the names are the hands', as in {shown(min(names))}")
            return {name: int(each[-2][0]) for name, each in found.items()}
    raise Unfit(
        f"{several_clips(around)}; give each its own folder, with names as frame_0001, or frame_0001_0 with "
        "a hand's number"
    )


def _of(values: dict[str, Any], names: tuple[str, ...]) -> Any:
    return next((values[name] for name in names if values.get(name) is not None), None)


def _recognises_matrices(document: Document) -> bool:
    first = _first(document)
    return first is not None and mano.is_matrices(first.get("hand_pose"))


def _recognises_vectors(document: Document) -> bool:
    return _first(document) is not None


def _read(document: Document, asked: Asked, name: str, mirrored: bool) -> Recording:
    """`mirrored`: whether left hands are given as the right ones of a mirrored crop."""
    assumed: list[str] = []
    found: list[mano.FoundHand] = []
    named: dict[str, list[mano.FoundHand]] = {}
    focals: list[float] = []
    size = asked.picture_size
    for part in _parts(document):
        if not _is_hand(part.values):
            continue
        hands = _hands_of(part, asked, mirrored, assumed)
        if part.name is None or _of(part.values, _NAMES["frame"]) is not None:
            found += hands
        else:
            named.setdefault(part.name, []).extend(hands)
        # Not focal_length, which is HaMeR's and WiLoR's for the crop alone, 5000 pixels of any picture
        focal, told = part.values.get("scaled_focal_length"), part.values.get("img_size")
        if focal is not None:
            focals += mano.numbers("the focal length", focal, 1)[:, 0].tolist()
        if told is not None and size is None:
            width, height = mano.numbers("img_size", told, 2)[0]
            size = int(width), int(height)
    numbers = _by_names(named, assumed)
    found += [replace(hand, frame=numbers[name]) for name, hands in named.items() for hand in hands]
    if not found:
        raise Unfit("there is no hand in it")
    frames = np.array(sorted({hand.frame for hand in found}))
    posed = mano.followed(found, frames, asked, assumed)
    other = "wilor-mini" if mirrored else "hamer"
    if any(hand.side == "left" for hand in posed):
        mano.tell(
            assumed,
            "left hands were taken as the right ones of a mirrored crop, as HaMeR's and WiLoR's are"
            if mirrored
            else "left hands were taken as left ones already, as WiLoR-mini's are",
        )
    camera = _camera(focals, size, assumed) if posed and not mano.is_nowhere(posed[0]) else None
    fps = asked.rate
    return mano.recording_of(
        name,
        document,
        fps,
        frames,
        posed,
        asked,
        assumed,
        chosen=True,
        mirrored_by=f"if they look so, read them with --reader {other}",
        size=size if camera is not None else None,
        intrinsics=camera,
    )


def _camera(focals: list[float], size: tuple[int, int] | None, assumed: list[str]) -> Intrinsics | None:
    if size is None:
        mano.tell(
            assumed,
            "the pictures' size is not told: hands lie as far away as the network's camera has them, but are "
            "not laid over pictures (--picture-size, or the pictures as the input and this as --keypoints)",
        )
        return None
    # HaMeR's and WiLoR's focal length, in longer sides of the picture
    focal = float(np.median(focals)) if focals else (5000.0 / 256.0) * max(size)
    if not focals:
        mano.tell(assumed, f"a focal length of {focal:.0f} pixels, the networks' own for this size")
    return Intrinsics(focal, focal, size[0] / 2.0, size[1] / 2.0)


def _hands_of(part: _Part, asked: Asked, mirrored: bool, assumed: list[str]) -> list[mano.FoundHand]:
    values = part.values
    right = mano.numbers("right", _of(values, _NAMES["right"]), 1)[:, 0]
    if not np.isin(right, (0.0, 1.0)).all():
        raise Unfit("right must be 1 for right hands and 0 for left ones")
    count = len(right)
    orient = mano.rotations("global_orient", values["global_orient"], 1, count)
    pose = mano.rotations("hand_pose", values["hand_pose"], 15, count)
    place = _of(values, _NAMES["place"])
    transl = mano.nowhere(count) if place is None else mano.numbers("pred_cam_t_full", place, 3)
    if len(transl) != count:
        raise Unfit(f"pred_cam_t_full has {len(transl)} rows where {count} are expected")
    if place is None:
        mano.tell(assumed, "where the hands are is not told (pred_cam_t_full): each stays in its place")
    betas = values.get("betas")
    shapes = np.empty((0, 10)) if betas is None else mano.numbers("betas", betas, 10)
    found = []
    for row, frame in enumerate(_frames(part, count, right, assumed)):
        side = "right" if right[row] else "left"
        one = slice(row, row + 1)
        hand = orient[one], pose[one]
        if side == "left" and mirrored:
            hand = mirrored_pose(*hand)
        flat = mano.from_flat(hand[1], side, asked, "flat")
        shape = shapes[row] if len(shapes) == count else mano.NO_SHAPE
        found.append(mano.FoundHand(side, shape, hand[0], flat, transl[one], frame))
    return found


def _frames(part: _Part, count: int, right: np.ndarray, assumed: list[str]) -> list[int]:
    """Each hand's frame; any where the part's name has it."""
    told = _of(part.values, _NAMES["frame"])
    if told is not None:
        rows = mano.numbers("frame", told, 1)[:, 0]
        if len(rows) == 1:
            rows = np.repeat(rows, count)
        if len(rows) != count or not np.all(rows == np.round(rows)):
            raise Unfit(f"frame must be {count} whole numbers, one for each hand")
        return [int(row) for row in rows]
    if part.frame is not None or part.name is not None:
        return [part.frame or 0] * count
    if count > 1 and len(set(right)) == 1:
        mano.tell(assumed, "its rows were taken as one hand's frames, as it does not tell whose they are")
        return list(range(1, count + 1))
    return [1] * count


HAMER: Final = Reader(
    "HaMeR or WiLoR",
    "global_orient and hand_pose as matrices with right and pred_cam_t_full, in an .npz, JSON, .npy or "
    "pickle, or a folder of these with the frame's number in the names",
    _recognises_matrices,
    lambda document, asked: _read(document, asked, "hamer", mirrored=True),
)
WILOR_MINI: Final = Reader(
    "WiLoR-mini",
    "lists of hands with is_right and wilor_preds, axis-angle, in JSON, .npz, .npy or a pickle, or a folder "
    "of these with the frame's number in the names",
    _recognises_vectors,
    lambda document, asked: _read(document, asked, "wilor-mini", mirrored=False),
)
