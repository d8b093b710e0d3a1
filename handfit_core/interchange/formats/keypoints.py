"""The table of programs that write a hand's 21 points: one entry each, read by `point_reader`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.files import shown
from handfit_core.common.skeleton import NUM_KEYPOINTS, SIDES
from handfit_core.common.values import number, one_of, whole
from handfit_core.geometry.camera import Intrinsics
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.json_points import JsonFrames, hands_in, keyed, objects_in, some_contents
from handfit_core.interchange.point_hands import ParsedHands, ParsedPoints
from handfit_core.interchange.point_names import XR_NAMES, is_apple, short
from handfit_core.interchange.point_reader import PointLayout, arrays_of, is_hand_table
from handfit_core.interchange.settings import LIMITS
from handfit_core.interchange.table_points import columns_of

# OpenPose


def _from_minus_one(frames: JsonFrames) -> bool:
    """Whether what is told of anybody lies between -1 and 1 (--keypoint_scale 4), where a missing point is at
    (-1, -1), with the others at (0, 0)."""
    contents = (content for content in frames.contents if isinstance(content, Mapping))
    people = [keyed(human) for content in contents for human in content.get("people", ())]
    lists = [value for human in people for key, value in human.items() if "keypoints" in key and value]
    if not lists:
        return False
    points = np.concatenate([np.array(each, dtype=np.float64).reshape(-1, 3) for each in lists])
    trusted = points[points[:, 2] > 0.0, :2]
    missing = points[points[:, 2] == 0.0, :2]
    at_corner, at_zero = (np.all(missing == place, axis=1).any() for place in (-1.0, 0.0))
    return bool(at_corner or (not at_zero and np.nanmin(trusted, initial=0.0) < -0.1))


OPENPOSE: Final = PointLayout(
    "openpose",
    "OpenPose",
    "JSON with people, a file a frame, with hands or whole bodies",
    "https://github.com/CMU-Perceptual-Computing-Lab/openpose/blob/master/doc/02_output.md",
    marks=("people", "bodies version"),
    columns="xyc",
    people="people bodies",
    order="mediapipe",
    persons="told",
    met="OpenPose 1.2, in MocapNET (2026-11)",
    assumes="no hands below 0.2 in the mean",
    least=0.2,  # --hand_render_threshold: OpenPose does not draw less sure hands
    halved=_from_minus_one,
    hint="; OpenPose writes hands with --hand",
)

MMPOSE: Final = PointLayout(
    "mmpose",
    "MMPose",
    "JSON of its inferencer or demos, of whole bodies or hands",
    "https://github.com/open-mmlab/mmpose/blob/main/mmpose/structures/utils.py",
    marks=("keypoints keypoint_scores", "instance_info", "instances frame_id"),
    columns="xy",
    people="instances",
    persons="told",
    assumes="no hands below 0.3 in the mean",
    least=0.3,  # --kpt-thr: the demos draw no less sure point
    hint="; a whole-body or a hand model writes some",
)


def _of_whole_bodies(document: Document) -> bool:
    """True if COCO's annotations have a whole body's points in one list, as Halpe's do."""
    if not isinstance(document.json, Mapping):
        return False
    told = (each.get("keypoints") for each in objects_in(document.json.get("annotations")))
    return any(isinstance(points, list) and len(points) in (3 * 133, 3 * 136) for points in told)


COCO: Final = PointLayout(
    "coco-wholebody",
    "COCO-WholeBody",
    "annotations with lefthand_kpts, or with Halpe's 136 keypoints",
    "https://github.com/jin-s13/COCO-WholeBody/blob/master/data_format.md",
    marks=("lefthand_kpts righthand_kpts",),
    recognises=_of_whole_bodies,
    columns="xyc",
    grouped=True,
    people="annotations",
    order="mediapipe",
    persons="told",
    met="COCO, UBody and Halpe, in MMPose (2026-11)",
    assumes="frames are the pictures' ids",
)

ALPHAPOSE: Final = PointLayout(
    "alphapose",
    "AlphaPose",
    "a list of image_id and keypoints, of Halpe or COCO-WholeBody",
    "https://github.com/MVIG-SJTU/AlphaPose/blob/master/docs/output.md",
    marks=("image_id keypoints score",),
    columns="xyc",
    grouped=True,
    people="annotations",
    order="mediapipe",
    persons="told",
    assumes="frames, by pictures' names",
    least=0.2,
    hint="; a Halpe or COCO-WholeBody model writes some",
)


def _interhand(frame: Any) -> Any:
    """Its frame's points, the right hand's before the left hand's, where they are valid."""
    points = [
        p if v else None for p, v in zip(frame["world_coord"], np.ravel(frame["joint_valid"]), strict=True)
    ]
    return [{"side": s, "points": points[i : i + 21]} for s, i in (("right", 0), ("left", 21))]


INTERHAND: Final = PointLayout(
    "interhand",
    "InterHand2.6M",
    "a capture's world_coord and joint_valid",
    "https://mks0601.github.io/InterHand2.6M",
    marks=("world_coord joint_valid",),
    columns="xyz",
    hands=_interhand,
    order="interhand",
    persons="one",
    units={"millimetres": 1e-3},
    up="camera",
    assumed=("its world's axes are taken for the camera's: x right, y down, z away",),
    met="four frames, in MMPose (2026-11)",
    assumes="the world's axes are the camera's",
)

ARIA: Final = PointLayout(
    "aria",
    "Aria",
    "the glasses' hand_tracking_results.csv",
    "https://facebookresearch.github.io/projectaria_tools/docs/data_formats/mps/hand_tracking",
    table=lambda table: {"tracking_timestamp_us", "tx_left_landmark_0_device"} <= set(table.columns),
    order="aria",
    persons="one",
    units={"metres": 1.0},
    up="aria",
    assumed=("its glasses are taken for the camera",),
    on_joints=True,
    met="projectaria_tools' mps_sample (2026-11)",
    assumes="the glasses are the camera",
)

XR_POINTS: Final = PointLayout(
    "xr-points",
    "A headset's joints",
    "places of joints by OpenXR's, MRTK's or visionOS' names",
    "https://registry.khronos.org/OpenXR/specs/1.1/man/html/XrHandJointEXT.html",
    table=lambda table: is_hand_table(table) and _names_xr(table.columns),
    recognises=lambda document: any(map(_names_xr_hand, map(objects_in, some_contents(document)))),
    columns="xyz",
    order="mediapipe",
    persons="one",
    units={"metres": 1.0, "centimetres": 1e-2, "millimetres": 1e-3},
    on_joints=True,
    mirrored=True,
    sigma=0.003,
    met="HoloLens 2, by bluewolf2735 (2026-11)",
    assumed=("y is up, and z leads towards who looks",),
    assumes="y up; z, by how fingers bend",
)

TRC: Final = PointLayout(
    "trc",
    "OpenSim's markers",
    "a .trc whose markers are points of hands",
    "https://simtk-confluence.stanford.edu/display/OpenSim/Marker+(.trc)+Files",
    table=lambda table: table.is_trc,
    persons="one",
    units={"metres": 1.0, "millimetres": 1e-3, "centimetres": 1e-2},
    assumed=("y is up, as in OpenSim",),
    assumes="y up; the unit, by the palm",
)

ARRAYS: Final = PointLayout(
    "arrays",
    "Points in an array",
    "a .npy, .npz, pickle or table of numbers: frames by points by x, y (z)",
    "docs/interchange.md",
    recognises=lambda document: bool(arrays_of(document)),
    units={"metres": 1.0, "millimetres": 1e-3, "centimetres": 1e-2},
    up="camera",
    met="a pickle of dex-retargeting (2026-11)",
    assumes="the camera's axes; the unit, by the palm",
)


def _names_xr(names: Iterable[str]) -> bool:
    """True if most joints are called as headsets call them."""
    return sum(short(name).removesuffix("x") in XR_NAMES for name in names) >= 8


def _names_xr_hand(objects: Iterable[Mapping[str, Any]]) -> bool:
    return any(_names_xr(islice(each, 100)) for each in objects)


def _names_apples(rows: Iterable[Iterable[str]]) -> bool:
    """Whether cells or keys of objects are Vision's names."""
    return any(is_apple(name) for names in rows for name in islice(names, 200))


APPLE_VISION: Final = PointLayout(
    "apple-vision",
    "Apple Vision",
    "JSON or CSV with its names (VNHLKITIP, indexTip)",
    "https://developer.apple.com/documentation/vision/vnhumanhandposeobservation",
    table=lambda table: is_hand_table(table) and _names_apples((table.columns, *table.rows[:50])),
    recognises=lambda document: any(map(_names_apples, map(objects_in, some_contents(document)))),
    columns="xy xyc xyzc",
    order="mediapipe",
    assumes="parts of the picture from below, or pixels",
    from_below=True,
)


# MediaPipe


def _has_hand(document: Document) -> bool:
    """Whether JSON has a hand somewhere."""
    return any(
        _first_hand(each) for content in some_contents(document) for each in (content, *objects_in(content))
    )


def _first_hand(frame: Any) -> bool:
    try:
        return any(True for _ in hands_in(frame, {2: "xy", 3: "xyz", 4: "xyzc"}))
    except (TypeError, ValueError, AttributeError, OverflowError):
        return False


MEDIAPIPE: Final = PointLayout(
    "mediapipe",
    "MediaPipe",
    "JSON or CSV with 21 landmarks a hand, of anybody",
    "https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker",
    table=is_hand_table,
    recognises=_has_hand,
    grouped=True,
    met="MediaPipe (2026-11)",
    assumes="the order, by the bones; the sides, by the fingers",
)


# FreeMoCap

_HAND_FILE: Final = re.compile(r"(?:.*_)?(left|right)_hand_(?:3d_xyz|frame_name_xyz)\.npy")


def _arrays(document: Document) -> list[tuple[int, Path]]:
    """Sides and files of hands in a folder, or in its output_data; the file itself."""
    for folder in (document, Document(document.path / "output_data")):
        files = folder.files(".npy") if folder.is_folder else [document.path]
        found = [
            (SIDES.index(match[1]), file)
            for file in files
            if (match := _HAND_FILE.fullmatch(file.name.lower()))
        ]
        if found or not document.is_folder:
            return found
    return []


def _of_arrays(document: Document) -> ParsedPoints | None:
    """(T, 21, 3) of each hand, if there are such files."""
    told: list[np.ndarray] = []
    sides = _arrays(document)
    for _, file in sides:
        points = Document(file).npy
        if points is None or points.ndim != 3 or points.shape[1:] != (NUM_KEYPOINTS, 3):
            found = "no array" if points is None else f"an array of the shape {points.shape}"
            raise ValueError(f"{shown(file.name)} is {found}; expected (frames, 21, 3)")
        told.append(points)
        LIMITS.check(file, len(points), len(told))
    if not told:
        return None
    count = len(told[0])
    if any(len(each) != count for each in told):
        raise ValueError("its left and right hand have different numbers of frames")
    side = np.repeat([side for side, _ in sides], count)
    rows, score = np.tile(np.arange(count), len(told)), np.full(len(side), np.nan)
    hands = ParsedHands.of(rows, side, side, score, np.concatenate(told))
    return ParsedPoints(np.arange(count), hands, in_space=True)


def _in_space(table: Table) -> bool:
    """Whether columns name both points and sides, and hold lengths rather than parts of a picture."""
    columns = None if table.is_trc else columns_of(table)
    if columns is None or any(column.side is None or column.world for column in columns):
        return False
    wrist = {
        axis: [table.columns[c.index] for c in columns if c.axis == axis and c.point == 0] for axis in "xyz"
    }
    if not all(wrist.values()):
        return False
    across, depth = (np.abs(table.numbers(wrist[axis])) for axis in "xz")
    if not np.isfinite(depth).any() or not np.isfinite(across).any():
        return False
    # The depth of MediaPipe's wrist is zero, as the others' count from it.
    return bool(np.nanmedian(depth) > 0.01 and np.nanmax(across) > 3.0)


FREEMOCAP: Final = PointLayout(
    "freemocap",
    "FreeMoCap",
    "output_data, its arrays or its tables, of versions 1 and 2",
    "https://github.com/freemocap/freemocap/tree/main/freemocap/system/paths_and_filenames",
    table=lambda table: {"keypoint", "trajectory"} <= set(table.columns) or _in_space(table),
    recognises=lambda document: (
        bool(_arrays(document)) or (document.npy is not None and document.npy.shape[1:] == (553, 3))
    ),
    read=_of_arrays,
    order="mediapipe",
    units={"millimetres": 1e-3, "centimetres": 1e-2, "metres": 1.0},
    up="z",
    first=0,
    met="two right hands, by labrat57 (2026-11)",
    assumes="Z up, Y away from who looks; the unit, by the palm",
    assumed=("Z is up, and Y leads away from who looks",),
)


# Leap Motion


def _leap_hands(frame: Any) -> list[dict[str, Any]]:
    """The hands of a frame of the websocket (leapjs), whose fingers stand beside them, or of LeapC. A thumb's
    metacarpal has no length, so that every finger has its knuckle where its second bone begins."""
    found = []
    hands = frame.get("hands") if isinstance(frame, Mapping) else None
    for hand in hands if isinstance(hands, list) else ():
        if "digits" in hand:
            wrist = hand["wrist"] if "wrist" in hand else _end(hand["arm"], "next")
            bones = [finger["bones"] for finger in hand["digits"]]
            fingers = [[_end(b, "prev"), *(_end(each, "next") for each in (b, c, d))] for _, b, c, d in bones]
        elif "pointables" in frame and "type" in hand:
            wrist = hand.get("wrist")
            mine = [finger for finger in frame["pointables"] if finger.get("handId") == hand.get("id")]
            named = {finger["type"]: finger for finger in mine if "mcpPosition" in finger}
            ends = [f"{joint}Position" for joint in ("mcp", "pip", "dip", "btip")]
            fingers = [[named[number][end] for end in ends] for number in range(5)] if named else []
        else:
            continue
        side = str(hand.get("type", hand.get("handedness", ""))).lower().removeprefix("elehandtype_")
        points = [wrist, *(point for finger in fingers for point in finger)]
        if fingers and None in points:
            raise ValueError("a joint is not there")
        found += [{"side": one_of(*SIDES)("type", side), "points": points}] if fingers else []
    return found


def _end(bone: Any, which: str) -> Any:
    return bone.get(f"{which}_joint", bone.get(f"{which}Joint"))


LEAP: Final = PointLayout(
    "leap",
    "Leap Motion",
    "JSON of frames with hands and pointables, or digits",
    "https://developer-archive.leapmotion.com/documentation/javascript/api/Leap.Frame.html",
    marks=("hands pointables", "digits"),
    columns="xyz",
    hands=_leap_hands,
    order="mediapipe",
    persons="one",
    units={"millimetres": 1e-3},
    up="y",
    on_joints=True,
    sigma=0.003,
    met="leapjs' frames (2026-11)",
    assumes="the device lies on a table",
    assumed=("the device lies on a table and looks up: y is up",),
)


# This project's own


def _own_points(document: Document) -> ParsedPoints:
    """The hands of docs/interchange.md's JSON, which has a list of frames for each hand."""
    header = document.json
    if whole("version", header.get("version"), 1) > 1:
        raise ValueError("a newer version wrote these points; read them with that version")
    numbers = np.array([whole("frames", n) for n in header["frames"]])
    hands = [(one_of(*SIDES)("side", hand["side"]), hand) for hand in header["hands"]]
    size = camera = None
    if "width" in header:
        size = whole("width", header["width"], 1, 1 << 24), whole("height", header["height"], 1, 1 << 24)
    if "intrinsics" in header:
        said = header["intrinsics"]
        camera = Intrinsics(*(number(name, said[name]) for name in ("fx", "fy", "cx", "cy")))
    in_space = bool(hands) and all("keypoints_3d" in hand for _, hand in hands)
    LIMITS.check(document.path, len(numbers), len(hands))
    kind, width = ("keypoints_3d", 3) if in_space else ("keypoints_2d", 2)
    nothing = [None] * width
    told = np.full((len(hands), len(numbers), NUM_KEYPOINTS, 4), np.nan)
    for points, (_, hand) in zip(told, hands, strict=True):
        rows = [[p or nothing for p in (row or [nothing] * NUM_KEYPOINTS)] for row in hand[kind]]
        shape = (len(numbers), NUM_KEYPOINTS, width)
        points[..., :width] = np.array(rows, dtype=np.float64).reshape(shape)
        if "confidence" in hand and not in_space:
            points[..., 3] = np.nan_to_num(np.array(hand["confidence"], dtype=np.float64))
    each, row = (index.ravel() for index in np.indices(told.shape[:2]))
    side = np.array([SIDES.index(side) for side, _ in hands], dtype=int)[each]
    found = ParsedHands.of(row, side, each, np.full(len(row), np.nan), told.reshape(-1, NUM_KEYPOINTS, 4))
    fps = number("fps", header["fps"], 1e-3, 1e6) if "fps" in header else 0.0
    return ParsedPoints(numbers, found, fps, size, camera, in_space)


POINTS: Final = PointLayout(
    "points",
    "Points",
    "our JSON",
    "docs/interchange.md",
    recognises=lambda document: (
        isinstance(document.json, dict) and document.json.get("format") == "handfit-points"
    ),
    read=_own_points,
    order="mediapipe",
    persons="one",
    met="ours",
    on_joints=True,
    sigma=None,
    ours=True,
)

POINTS_TABLE: Final = PointLayout(
    "points-table",
    "Points as a table",
    "our CSV",
    "docs/interchange.md",
    table=lambda table: any(
        {"frame", "side", "point", *axes.split()} <= set(table.columns)
        for axes in ("x_px y_px", "x_m y_m z_m")
    ),
    order="mediapipe",
    persons="one",
    met="ours",
    on_joints=True,
    sigma=None,
    ours=True,
)
