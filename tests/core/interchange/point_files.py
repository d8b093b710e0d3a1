"""Hands that are known (tests/told.py) in the layouts of programs that write points: `MADE` has them all."""

from __future__ import annotations

import json
import pickle
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from handfit_core.common.skeleton import SIDES, Side, other_side
from tests.told import FRAMES, HEIGHT, WIDTH, told
from tests.torch_files import torch_zip

TOLD = told()
ALL = list(range(FRAMES))
SIZE = np.array([WIDTH, HEIGHT], dtype=float)
NAMES = (
    "WRIST THUMB_CMC THUMB_MCP THUMB_IP THUMB_TIP INDEX_FINGER_MCP INDEX_FINGER_PIP INDEX_FINGER_DIP "
    "INDEX_FINGER_TIP MIDDLE_FINGER_MCP MIDDLE_FINGER_PIP MIDDLE_FINGER_DIP MIDDLE_FINGER_TIP "
    "RING_FINGER_MCP RING_FINGER_PIP RING_FINGER_DIP RING_FINGER_TIP PINKY_MCP PINKY_PIP PINKY_DIP PINKY_TIP"
).split(" ")
APPLE_CODES = ["VNHLKWRI", *(f"VNHLKT{j}" for j in ("CMC", "MP", "IP", "TIP"))]
APPLE_CODES += [f"VNHLK{f}{j}" for f in "IMRP" for j in ("MCP", "PIP", "DIP", "TIP")]
APPLE_NAMES = ["wrist", "thumbCMC", "thumbMP", "thumbIP", "thumbTip"]
APPLE_NAMES += [
    f"{f}{j}" for f in ("index", "middle", "ring", "little") for j in ("MCP", "PIP", "DIP", "Tip")
]


def landmarks(side: Side, frame: int) -> np.ndarray:
    """(21, 3) in parts of the picture, as MediaPipe has them."""
    return np.column_stack([TOLD.pixels[side][frame] / SIZE, TOLD.depth[side][frame] / WIDTH])


def points(values: np.ndarray) -> list[dict[str, float]]:
    return [dict(zip("xyz", row, strict=False)) for row in values.tolist()]


# One frame of a picture's hands


def tasks(frame: int) -> dict[str, Any]:
    """As tasks-vision's HandLandmarkerResult in JSON."""
    return {
        "landmarks": [points(landmarks(side, frame)) for side in SIDES],
        "worldLandmarks": [points(TOLD.world[side][frame]) for side in SIDES],
        "handedness": [[{"score": 0.97, "index": 0, "categoryName": side.capitalize()}] for side in SIDES],
    }


def tasks_python(frame: int) -> dict[str, Any]:
    return {
        "hand_landmarks": [landmarks(side, frame).tolist() for side in SIDES],
        "hand_world_landmarks": [TOLD.world[side][frame].tolist() for side in SIDES],
        "handedness": [[{"score": 0.97, "category_name": side.capitalize()}] for side in SIDES],
    }


def legacy(frame: int) -> dict[str, Any]:
    """As the older solutions' messages in JSON, whose labels count for mirrored pictures."""
    labels = [other_side(side).capitalize() for side in SIDES]
    return {
        "multi_hand_landmarks": [{"landmark": points(landmarks(side, frame))} for side in SIDES],
        "multi_handedness": [{"classification": [{"score": 0.9, "label": label}]} for label in labels],
    }


def legacy_script(frame: int) -> dict[str, Any]:
    return {
        "multiHandLandmarks": [points(landmarks(side, frame)) for side in SIDES],
        "multiHandedness": [{"score": 0.9, "label": other_side(side).capitalize()} for side in SIDES],
        "multiHandWorldLandmarks": [points(TOLD.world[side][frame]) for side in SIDES],
    }


def holistic(frame: int) -> dict[str, Any]:
    hands = {f"{side}_hand_landmarks": points(landmarks(side, frame)) for side in SIDES}
    return {"pose_landmarks": points(np.full((33, 3), 0.5)), **hands}


def listed(frame: int) -> dict[str, Any]:
    return {
        "hands": [
            {"handedness": side.capitalize(), "score": 0.8, "landmarks": points(landmarks(side, frame))}
            for side in SIDES
        ]
    }


def by_side(frame: int) -> dict[str, Any]:
    names = [name.lower() for name in NAMES]
    return {side: dict(zip(names, landmarks(side, frame).tolist(), strict=True)) for side in SIDES}


def flat(frame: int) -> dict[str, Any]:
    return {"hands": [{"label": s, "landmarks": landmarks(s, frame).ravel().tolist()} for s in SIDES]}


def triples(values: np.ndarray, sure: float = 0.7) -> list[float]:
    return np.column_stack([values, np.full(len(values), sure)]).ravel().tolist()


def person(frame: int) -> dict[str, Any]:
    """One of OpenPose's people."""
    body = np.column_stack([np.linspace(100, 800, 25), np.linspace(50, 500, 25)])
    hands = {f"hand_{side}_keypoints_2d": triples(TOLD.pixels[side][frame]) for side in SIDES}
    return {"person_id": [-1], "pose_keypoints_2d": triples(body), "face_keypoints_2d": [], **hands}


def openpose(frame: int) -> dict[str, Any]:
    return {"version": 1.3, "people": [person(frame)]}


def instance(frame: int, count: int = 133, score: float = 0.9) -> dict[str, Any]:
    """One of MMPose's instances, of COCO-WholeBody's or Halpe's points."""
    values = np.full((count, 2), 5.0)
    for side, first in (("left", count - 42), ("right", count - 21)):
        values[first : first + 21] = TOLD.pixels[side][frame]
    # split_instances puts the box into a list of its own.
    box = [[10.0, 10.0, 500.0, 500.0]]
    return {"keypoints": values.tolist(), "keypoint_scores": [score] * count, "bbox": box}


def mmpose(frame: int) -> dict[str, Any]:
    return {"frame_id": frame, "instances": [instance(frame)]}


def halpe(frame: int) -> dict[str, Any]:
    return {"frame_id": frame, "instances": [instance(frame, 136)]}


def from_below(side: Side, frame: int) -> np.ndarray:
    """(21, 2) parts of the picture from the lower left corner."""
    return np.array([0.0, 1.0]) + TOLD.pixels[side][frame] / SIZE * [1.0, -1.0]


def apple(frame: int, names: list[str] = APPLE_CODES, sides: Any = SIDES) -> dict[str, Any]:
    hands = []
    for side, chirality in zip(SIDES, sides, strict=True):
        table = zip(names, from_below(side, frame).tolist(), strict=True)
        joints = {name: {"location": {"x": x, "y": y}, "confidence": 0.8} for name, (x, y) in table}
        hands.append({"chirality": chirality, "joints": joints})
    return {"hands": hands}


def apples_api(frame: int) -> dict[str, Any]:
    return apple(frame, APPLE_NAMES, (-1, 1))


def apples_raw_values(frame: int) -> dict[str, Any]:
    return apple(frame, [f"VNHumanHandPoseObservationJointName(_rawValue: {code})" for code in APPLE_CODES])


# Hands in space


def in_room(side: Side) -> np.ndarray:
    """(6, 21, 3) millimetres with Z up, of FreeMoCap: what is away from the camera lies along Y."""
    x, y, z = np.moveaxis(TOLD.points[side], -1, 0)
    return 1000.0 * np.stack([x, z, -y], axis=-1)


def above(side: Side, frame: int) -> list[list[float]]:
    """(21, 3) millimetres as Leap's device has them, y up and z towards the user."""
    return (TOLD.points[side][frame] * [1000.0, -1000.0, -1000.0]).tolist()


def websocket() -> list[dict[str, Any]]:
    """Leap's frames as leapjs has them."""
    frames = []
    for row in range(FRAMES):
        frame: dict[str, Any] = {
            "id": row,
            "timestamp": 10_000_000 + 10_000 * row,
            "hands": [],
            "pointables": [],
        }
        for number, side in enumerate(SIDES, 30):
            wrist, *rest = above(side, row)
            frame["hands"].append({"id": number, "type": side, "wrist": wrist, "palmPosition": rest[8]})
            for f in range(5):
                ends = zip(("mcp", "pip", "dip", "btip"), rest[4 * f : 4 * f + 4], strict=True)
                finger = {f"{name}Position": place for name, place in ends}
                frame["pointables"].append({"handId": number, "type": f, "carpPosition": wrist, **finger})
        frames.append(frame)
    return frames


def leapc() -> list[dict[str, Any]]:
    frames = []
    for row in range(FRAMES):
        hands = []
        for side in SIDES:
            p = [dict(zip("xyz", place, strict=True)) for place in above(side, row)]
            ends = [[p[1] if f == 0 else p[0], *p[1 + 4 * f : 5 + 4 * f]] for f in range(5)]
            bones = [[{"prev_joint": a, "next_joint": b} for a, b in pairwise(each)] for each in ends]
            arm = {"prev_joint": p[0], "next_joint": p[0]}
            hands.append({"type": side, "digits": [{"bones": each} for each in bones], "arm": arm})
        frames.append({"timestamp": 10_000 * row, "hands": hands})
    return frames


def interhand() -> dict[str, Any]:
    """A capture: tips first, the right hand's 21 points before the left hand's; x right, y down."""
    order = [*(4 * finger + joint for finger in range(5) for joint in (4, 3, 2, 1)), 0]
    frames = {}
    for row in range(FRAMES):
        points = [1000.0 * TOLD.points[side][row][order] for side in ("right", "left")]
        valid = [[1.0]] * 42
        frames[str(row)] = {"world_coord": np.concatenate(points).tolist(), "joint_valid": valid}
    return {"0": frames}


ARIA = [4, 8, 12, 16, 20, 0, 2, 3, 5, 6, 7, 9, 10, 11, 13, 14, 15, 17, 18, 19]


def aria(path: Path) -> Path:
    """The glasses' table: x down, y left; the last landmark is the palm's middle. No right hand in row 2."""
    header = ["tracking_timestamp_us"]
    for side in SIDES:
        header += [f"{side}_tracking_confidence"]
        header += [f"t{axis}_{side}_landmark_{i}_device" for i in range(21) for axis in "xyz"]
    header += [f"t{axis}_{side}_device_wrist" for side in SIDES for axis in "xyz"]
    rows = []
    for row in range(FRAMES):
        cells: list[float] = [1_000_000 + 100_000 * row]
        for side in SIDES:
            x, y, z = np.moveaxis(TOLD.points[side][row], -1, 0)
            there = np.stack([y, -x, z], axis=-1)
            seen = side == "left" or row != 2
            cells += [0.99 if seen else -1.0]
            cells += (
                (seen * np.concatenate([there[ARIA], there.mean(axis=0, keepdims=True)])).ravel().tolist()
            )
        rows.append([*cells, *[0.5] * 6])
    return table(path, header, rows)


def headset(frame: int) -> dict[str, Any]:
    """Metres, y up, by MRTK's names."""
    fingers = ("Thumb", "Index", "Middle", "Ring", "Pinky")
    thumb, finger = ("Metacarpal", "Proximal", "Distal", "Tip"), ("Knuckle", "Middle", "Distal", "Tip")
    names = ["Wrist", *(f + j for f in fingers for j in (thumb if f == "Thumb" else finger))]
    places = {side: TOLD.points[side][frame] * [1.0, -1.0, -1.0] for side in SIDES}
    return {
        "Frame": frame,
        **{side.capitalize(): dict(zip(names, places[side].tolist(), strict=True)) for side in SIDES},
    }


def trc(path: Path, *markers: str) -> Path:
    """OpenSim's markers, millimetres, y up."""
    markers = markers or tuple(f"{side[0].upper()}_{name}" for side in SIDES for name in NAMES)
    places = np.concatenate([TOLD.points[side] * [1000.0, -1000.0, -1000.0] for side in SIDES], axis=1)
    axes = [f"{axis}{i + 1}" for i in range(len(markers)) for axis in "XYZ"]
    lines = [
        ["PathFileType", "4", "(X/Y/Z)", path.name],
        ["DataRate", "CameraRate", "NumFrames", "NumMarkers", "Units"],
        ["50", "50", str(FRAMES), str(len(markers)), "mm"],
        ["Frame#", "Time", *(cell for name in markers for cell in (name, "", ""))],
        ["", "", *axes],
    ]
    rows = places[:, : len(markers)].reshape(FRAMES, -1).tolist()
    lines += [[str(i), f"{i / 50:.3f}", *map(str, row)] for i, row in enumerate(rows)]
    path.write_text("\n".join("\t".join(line) for line in lines), encoding="utf-8")
    return path


def annotations() -> dict[str, Any]:
    """COCO-WholeBody's, of one person in each picture."""
    people = [
        {"image_id": 100 + row, "category_id": 1, "keypoints": [0.0] * 51}
        | {f"{side}hand_kpts": triples(TOLD.pixels[side][row], 2.0) for side in SIDES}
        for row in range(FRAMES)
    ]
    return {"images": [{"id": 100, "width": WIDTH, "height": HEIGHT}], "annotations": people}


def alphapose(*models: int) -> list[dict[str, Any]]:
    """A list of persons, of whole bodies of so many points."""
    return [
        {
            "image_id": f"{row}.jpg",
            "category_id": 1,
            "keypoints": triples(np.array(instance(row, count)["keypoints"])),
            "score": 2.9,
        }
        for row in range(FRAMES)
        for count in models
    ]


# Files


def saved(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def folder_of(path: Path, frames: list[Any], name: str = "clip_{:012d}_keypoints.json") -> Path:
    path.mkdir(exist_ok=True)
    for number, content in enumerate(frames):
        saved(path / name.format(number), content)
    return path


def table(path: Path, header: list[str], rows: Any) -> Path:
    path.write_text("\n".join(",".join(map(str, line)) for line in [header, *rows]), encoding="utf-8")
    return path


def named(axes: str, *names: str, sep: str = "_") -> list[str]:
    return [f"{name}{sep}{axis}" for name in names for axis in axes]


def wide(first: int = 0) -> list[str]:
    return [f"{axis}{i}" for i in range(first, first + 21) for axis in "xyz"]


def rows_of_hands(landmarks_of: Any = landmarks) -> list[list[Any]]:
    """Frame, side and numbers of each hand."""
    return [[i, side, *landmarks_of(side, i).ravel().tolist()] for i in range(FRAMES) for side in SIDES]


def output(path: Path, **hands: np.ndarray) -> Path:
    """FreeMoCap's folder, with these hands' arrays in millimetres."""
    path.mkdir(exist_ok=True)
    for side in SIDES:
        np.save(path / f"mediapipe_{side}_hand_3d_xyz.npy", hands.get(side, in_room(side)))
    np.save(path / "mediapipe_body_3d_xyz.npy", np.zeros((FRAMES, 33, 3)))
    return path


def freemocap2() -> list[list[Any]]:
    """A row for each point, of the body, too, and of the rigid bones' trajectories."""
    rows: list[list[Any]] = []
    for off, kind in ((0.0, "3d_xyz"), (50.0, "rigid_3d_xyz")):
        for i in ALL:
            rows.append([i, "right_wrist", 1, 2, 3, "mediapipe.body", 1.0, kind])
            for side in SIDES:
                for name, place in zip(SIDED[side], in_room(side)[i] + off, strict=True):
                    rows.append([i, name, *place, f"mediapipe.{side}_hand", 1.0, kind])
    return rows


def whole_body(frame: int, count: int) -> dict[str, Any]:
    """OpenPose's person whose hands are among the body's points: 25+21+21, COCO-WholeBody's or Halpe's."""
    body = np.full((25, 2), 7.0), *(TOLD.pixels[side][frame] for side in SIDES)
    found = np.concatenate(body) if count == 67 else np.array(instance(frame, count)["keypoints"])
    return {"people": [{"pose_keypoints_2d": triples(found)}]}


def tensorflow(side: Side, frame: int) -> dict[str, Any]:
    """A hand of TensorFlow.js."""
    kinds = {"keypoints": TOLD.pixels[side][frame], "keypoints3D": TOLD.world[side][frame]}
    return {"handedness": side.capitalize(), "score": 0.9} | {
        kind: [{"name": n.lower(), **p} for n, p in zip(NAMES, points(values), strict=True)]
        for kind, values in kinds.items()
    }


# All of them

SIDED = {side: [f"{side}_hand_{name.lower()}" for name in NAMES] for side in SIDES}
_BOTH = [[i, *landmarks("left", i).ravel(), *landmarks("right", i).ravel()] for i in ALL]
_EACH = [(i, side, k, landmarks(side, i)[k]) for i in ALL for side in SIDES for k in range(21)]
_BODY = [
    [i, f"{i}-{kind}", kind, k, 0.4, 0.4, 0.0] for i in ALL for kind in ("face", "pose") for k in range(30)
]
_BODY += [[i, f"{i}-{side}", f"{side}_hand", k, *place] for i, side, k, place in _EACH]
_APPLES = [[i, side, APPLE_CODES[k], *from_below(side, i)[k], 0.9] for i, side, k, _ in _EACH]
_LEFT, _RIGHT = (TOLD.points[side] for side in SIDES)
_NUMBERED = np.column_stack([ALL, 1000.0 * _RIGHT.reshape(FRAMES, -1)])
_ROOM = np.concatenate([in_room(side) for side in SIDES], axis=1).reshape(FRAMES, -1)
_TORCH = torch_zip({"hand": _LEFT.astype(np.float32)})
_CODES = dict(zip(APPLE_CODES, from_below("left", 0).tolist(), strict=True))


def pose_format(path: Path, version: float = 0.1) -> None:
    """Sign language's .pose, of a body's two points and both hands."""

    def text(of: str) -> bytes:
        return struct.pack(f"<H{len(of)}s", len(of), of.encode())

    parts = [("POSE_LANDMARKS", ["NOSE", "NECK"]), *((f"{s.upper()}_HAND_LANDMARKS", NAMES) for s in SIDES)]
    data = struct.pack("<f4H", version, WIDTH, HEIGHT, 0, len(parts))
    for name, names in parts:
        data += text(name) + text("XYZC") + struct.pack("<3H", len(names), 1, 1)
        data += b"".join(map(text, names)) + bytes(4 + 6)
    places = np.zeros((FRAMES, 1, 44, 3), dtype="<f4")
    for side, first in zip(SIDES, (2, 23), strict=True):
        places[:, 0, first : first + 21] = [landmarks(side, i) * [WIDTH, HEIGHT, WIDTH] for i in ALL]
    data += struct.pack("<fIH", 24.0, FRAMES, 1) if version > 0.1 else struct.pack("<3H", 24, FRAMES, 1)
    path.write_bytes(data + places.tobytes() + np.ones((FRAMES, 1, 44), dtype="<f4").tobytes())


def by_axis(side: Side, frame: int) -> dict[str, dict[str, float]]:
    """A hand as pandas writes a table with a row for each point."""
    columns = zip("xyz", landmarks(side, frame).T.tolist(), strict=True)
    return {axis: {str(k): value for k, value in enumerate(values)} for axis, values in columns}


def deeplabcut(path: Path) -> None:
    """Three lines of names over pixels of the right hand."""
    rows = [["scorer", *["DLC_resnet50"] * 63], ["bodyparts", *(n for n in NAMES for _ in range(3))]]
    rows.append(["coords", *["x", "y", "likelihood"] * 21])
    rows += [[i, *np.column_stack([TOLD.pixels["right"][i], np.ones(21)]).ravel()] for i in ALL]
    path.write_text("\n".join(",".join(map(str, row)) for row in rows), encoding="utf-8")


def with_commas(path: Path) -> None:
    """A table as spreadsheets write it where a comma stands before decimals."""
    table(path, ["frame", *named("xyz", *SIDED["left"], *SIDED["right"])], _BOTH)
    text = path.read_text(encoding="utf-8").replace(",", ";").replace(".", ",")
    path.write_text(text, encoding="utf-8")


class Made(NamedTuple):
    """A file with known hands."""

    reader: str
    content: Any
    """JSON, a table's names and rows, an array, or what writes it to a path; a folder's name has no ending"""
    rows: list[int] = ALL
    """The frames of the known hands that it has"""
    sides: tuple[Side, ...] = SIDES


def written(folder: Path, name: str) -> Path:
    """That one of `MADE`."""
    path, content = folder / name, MADE[name].content
    if callable(content):
        content(path)
    elif path.suffix == ".npy":
        np.save(path, content)
    elif path.suffix == ".csv":
        table(path, *content)
    elif path.suffix == ".jsonl":
        path.write_text("\n".join(map(json.dumps, content)), encoding="utf-8")
    else:
        (saved if path.suffix else folder_of)(path, content)
    return path


_LAYOUTS: dict[str, list[Any]] = {
    "mediapipe": [tasks, tasks_python, legacy, legacy_script, holistic, listed, by_side, flat],
    "openpose": [openpose],
    "mmpose": [mmpose, halpe],
    "apple-vision": [apple, apples_api, apples_raw_values],
    "xr-points": [headset],
}
MADE: dict[str, Made] = {
    **{f"{of.__name__}.json": Made(n, [of(i) for i in ALL]) for n, each in _LAYOUTS.items() for of in each},
    "tensorflow.json": Made("mediapipe", [[tensorflow(side, i) for side in SIDES] for i in ALL]),
    "a_line_a_hand.jsonl": Made("mediapipe", [
        {"frame": i, "side": side, "landmarks": landmarks(side, i).tolist()} for i in ALL for side in SIDES
    ]),
    "a.pose": Made("pose-format", pose_format),
    "by_axis.jsonl": Made("mediapipe", [
        {"landmarks": {side.title(): by_axis(side, i) for side in SIDES}} for i in ALL
    ]),
    "metres.json": Made("mediapipe", _LEFT.tolist(), sides=("left",)),
    "one_frame.json": Made("openpose", openpose(0), [0]),
    "openpose": Made("openpose", [openpose(i) for i in ALL]),
    **{f"body_of_{n}": Made("openpose", [whole_body(i, n) for i in ALL]) for n in (67, 133, 136)},
    "inferencer.json": Made("mmpose", {"meta_info": {}, "instance_info": [instance(2)]}, [2]),
    "demo.json": Made("mmpose", {"instance_info": [mmpose(i) for i in ALL]}),
    "annotations.json": Made("coco-wholebody", annotations()),
    # Halpe's, with hands among a person's 136 points
    "halpe_annotations.json": Made("coco-wholebody", annotations() | {
        "annotations": [
            {"image_id": 100 + i, "keypoints": each["keypoints"]} for i, each in enumerate(alphapose(136))
        ]
    }),
    **{f"alphapose_{n}.json": Made("alphapose", alphapose(n)) for n in (133, 136)},
    "interhand.json": Made("interhand", interhand()),
    "codes.json": Made("apple-vision", {"chirality": "left", **_CODES}, [0], ("left",)),
    "leapjs.json": Made("leap", websocket()),
    "leapc.json": Made("leap", leapc()),
    "rows_from_0.csv": Made("mediapipe", (["frame", "handedness", *wide()], rows_of_hands())),
    "rows_from_1.csv": Made("mediapipe", (["frame", "handedness", *wide(1)], rows_of_hands())),
    "named_rows.csv": Made("mediapipe", (["frame_number", "hand", *named("xyz", *NAMES)], rows_of_hands())),
    "both_named.csv": Made("mediapipe", (["frame", *named("xyz", *SIDED["left"], *SIDED["right"])], _BOTH)),
    "both_numbered.csv": Made("mediapipe", (
        ["frame", *named("xyz", *(f"hand{h}_landmark{k}" for h in (0, 1) for k in range(21)))], _BOTH
    )),
    "points.csv": Made("mediapipe", (
        ["Frame", "Hand", "Landmark", "X", "Y", "Z"], [[i, int(s == "right"), k, *p] for i, s, k, p in _EACH]
    )),
    "anipose.csv": Made("arrays", (
        [*(f"{n}_{a}" for n in NAMES for a in ("x", "y", "z", "error", "score")), "fnum"],
        [[*np.pad(1000.0 * _RIGHT[i], ((0, 0), (0, 2)), constant_values=0.9).ravel(), i] for i in ALL],
    ), sides=("right",)),
    "with_commas.csv": Made("mediapipe", with_commas),
    "deeplabcut.csv": Made("mediapipe", deeplabcut, sides=("right",)),
    # As in the data of Google's sign language competition.
    "beside_a_body.csv": Made("mediapipe", (
        ["frame", "row_id", "type", "landmark_index", "x", "y", "z"], _BODY
    )),
    "apple_rows.csv": Made("apple-vision", (
        ["frame", "chirality", *named("xy", *APPLE_NAMES)], rows_of_hands(from_below)
    )),
    "apple_points.csv": Made("apple-vision", (["frame", "hand", "joint", "x", "y", "confidence"], _APPLES)),
    "aria.csv": Made("aria", aria),
    "a.trc": Made("trc", trc),
    "trajectories.csv": Made("freemocap", (named("xyz", *SIDED["left"], *SIDED["right"]), _ROOM.tolist())),
    "right_hand.csv": Made("freemocap", (
        named("xyz", "body_nose", *(f"right_hand_{k:04d}" for k in range(21))),
        np.column_stack([np.full((FRAMES, 3), 500.0), _ROOM[:, 63:]]).tolist(),
    ), sides=("right",)),
    "freemocap2.csv": Made("freemocap", (
        ["frame", "keypoint", "x", "y", "z", "model", "reprojection_error", "trajectory"], freemocap2()
    )),
    "output_data": Made("freemocap", output),
    "mediapipe_left_hand_3d_xyz.npy": Made("freemocap", in_room("left"), sides=("left",)),
    "sides.npz": Made("arrays", lambda path: np.savez(path, left_hand=_LEFT, right_hand=_RIGHT)),
    "T21-3.npy": Made("arrays", _RIGHT, sides=("right",)),
    "T64.npy": Made("arrays", _NUMBERED, sides=("right",)),
    "21-3.npy": Made("arrays", _RIGHT[0], [0], ("right",)),
    "rows_of_points.csv": Made("arrays", ([*"xyz"], _RIGHT.reshape(-1, 3).tolist()), sides=("right",)),
    "T2-21-3.npy": Made("arrays", np.stack([_LEFT, _RIGHT], axis=1)),
    "numbers.txt": Made("arrays", lambda path: np.savetxt(path, _NUMBERED), sides=("right",)),
    "a.pkl": Made("arrays", lambda path: path.write_bytes(pickle.dumps([*_LEFT])), sides=("left",)),
    "a.pt": Made("arrays", lambda path: path.write_bytes(_TORCH), sides=("left",)),
}  # fmt: skip
"""Files and folders by their names"""
