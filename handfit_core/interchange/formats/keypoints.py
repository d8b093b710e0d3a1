"""The table of programs that write a hand's 21 points: one entry each, read by `point_reader`."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Final

import numpy as np

from handfit_core.common.skeleton import SIDES
from handfit_core.common.values import number, one_of, whole
from handfit_core.geometry.camera import Intrinsics
from handfit_core.interchange.document import Document, Table
from handfit_core.interchange.frames import (
    Frames,
    frames_of_arrays,
    in_order,
    objects_in,
    points_among,
    some_contents,
)
from handfit_core.interchange.json_hands import JsonHand, hands_in, keyed
from handfit_core.interchange.point_names import XR_NAMES, is_apple, short
from handfit_core.interchange.point_reader import PointLayout
from handfit_core.interchange.table_points import columns_of, is_hand_table

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
    halved=True,
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
    """Return the points of a frame of InterHand2.6M, the right hand's before the left hand's, where they are
    valid."""
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
    marks=("tracking_timestamp_us tx_left_landmark_0_device",),
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
    names=lambda names: sum(short(name).removesuffix("x") in XR_NAMES for name in names) >= 8,
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


def _in_space(table: Table, *, sided: bool) -> bool:
    """True if columns name points, with their sides or without, and hold lengths in space rather than pixels
    or parts of a picture."""
    columns = None if table.is_trc else columns_of(table)
    if columns is None or any((column.side is not None) != sided or column.world for column in columns):
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


ARRAYS: Final = PointLayout(
    "arrays",
    "Points in an array",
    "a .npy, .npz, pickle or table: frames by points by x, y (z)",
    "docs/interchange.md",
    table=lambda table: _in_space(table, sided=False),
    recognises=lambda document: bool(points_among(document.arrays)),
    units={"metres": 1.0, "millimetres": 1e-3, "centimetres": 1e-2},
    up="camera",
    met="handmocap's .npy, dex-retargeting's pickle (2026-11)",
    assumes="the camera's axes; the unit, by the palm",
)


APPLE_VISION: Final = PointLayout(
    "apple-vision",
    "Apple Vision",
    "JSON or CSV with its names (VNHLKITIP, indexTip)",
    "https://developer.apple.com/documentation/vision/vnhumanhandposeobservation",
    names=lambda names: any(map(is_apple, names)),
    columns="xy xyc xyzc",
    order="mediapipe",
    assumes="parts of the picture from below, or pixels",
    from_below=True,
)


# MediaPipe


def some_hands(document: Document, hands: Callable[[Any], Any] = lambda each: each) -> Iterator[JsonHand]:
    """Yield hands that are told somewhere in JSON, for a `PointLayout` with these `hands` and any columns."""
    columns = {len(each): each for each in "xy xyz xyzc xyzijkw".split()}
    for content in some_contents(document):
        for each in (content, *objects_in(content)):
            with contextlib.suppress(TypeError, ValueError, AttributeError, OverflowError):
                yield from hands_in(hands(each), columns)


MEDIAPIPE: Final = PointLayout(
    "mediapipe",
    "MediaPipe",
    "JSON or CSV with 21 landmarks a hand, of anybody",
    "https://ai.google.dev/edge/mediapipe/solutions/vision/hand_landmarker",
    table=is_hand_table,
    recognises=lambda document: any(True for _ in some_hands(document)),
    grouped=True,
    met="MediaPipe (2026-11)",
    assumes="the order, by the bones; the sides, by the fingers",
)


# FreeMoCap

_HAND_FILE: Final = re.compile(r"(?:.*_)?(left|right)_hand_(?:3d_xyz|frame_name_xyz)\.npy")


def _hand_arrays(document: Document) -> dict[str, np.ndarray | None]:
    """Return the arrays of hands in a folder, or in its output_data, by their files' names."""
    folders = document, Document(document.path / "output_data")
    files = [file for folder in folders for file in folder.files(".npy")]
    return {file.name: Document(file).npy for file in files if _HAND_FILE.fullmatch(file.name.lower())}


FREEMOCAP: Final = PointLayout(
    "freemocap",
    "FreeMoCap",
    "output_data, its arrays or its tables, of versions 1 and 2",
    "https://github.com/freemocap/freemocap/tree/main/freemocap/system/paths_and_filenames",
    marks=("keypoint trajectory",),
    table=lambda table: _in_space(table, sided=True),
    recognises=lambda document: (
        bool(_HAND_FILE.fullmatch(document.path.name.lower()) or _hand_arrays(document))
        or (document.npy is not None and document.npy.shape[1:] == (553, 3))
    ),
    read=lambda document: frames_of_arrays(document, _hand_arrays(document), 0),
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
    """Return the hands of a frame of the websocket (leapjs), whose fingers stand beside them, or of LeapC. A
    thumb's metacarpal has no length, so that every finger has its knuckle where its second bone begins."""
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


def _own_frames(document: Document) -> Frames:
    """Return the frames of docs/interchange.md's JSON, which has a list of them for each hand."""
    header = document.json
    if whole("version", header.get("version"), 1) > 1:
        raise ValueError("a newer version wrote these points; read them with that version")
    for name in ("width", "height"):
        whole(name, header.get(name, 1), 1, 1 << 24)
    number("fps", header.get("fps", 1.0), 1e-3, 1e6)
    hands, camera = header["hands"], header.get("intrinsics")
    in_space = bool(hands) and all("keypoints_3d" in hand for hand in hands)
    kind = "keypoints_3d" if in_space else "keypoints_2d"
    contents = [
        [
            {
                "side": one_of(*SIDES)("side", hand["side"]),
                "handnumber": each,
                "points": hand[kind][row],
                **(
                    {"keypoint_scores": hand["confidence"][row]}
                    if "confidence" in hand and not in_space
                    else {}
                ),
            }
            for each, hand in enumerate(hands)
        ]
        for row in range(len(header["frames"]))
    ]
    frames = in_order(document, [whole("frames", n) for n in header["frames"]], contents, keyed(header))
    if camera is not None:
        camera = Intrinsics(*(number(name, camera[name]) for name in ("fx", "fy", "cx", "cy")))
    return replace(frames, in_space=in_space, intrinsics=camera)


POINTS: Final = PointLayout(
    "points",
    "Points",
    "our JSON",
    "docs/interchange.md",
    recognises=lambda document: (
        isinstance(document.json, dict) and document.json.get("format") == "handfit-points"
    ),
    read=_own_frames,
    columns="xy xyz",
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
    marks=("frame side point x_px y_px", "frame side point x_m y_m z_m"),
    order="mediapipe",
    persons="one",
    met="ours",
    on_joints=True,
    sigma=None,
    ours=True,
)
