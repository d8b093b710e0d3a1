"""Takes for humanoids, and what a humanoid's hands are to look like then, by the take's joints alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, FINGERS, KEYPOINT_SOURCE, SIDES, Side
from handfit_core.geometry.camera import Intrinsics
from handfit_core.geometry.rotations import quat_to_rotmat, rotvec_to_rotmat
from handfit_core.hand_model.poses import ready_poses
from handfit_core.take import HandTrack, Take
from tests.takes import seen_as, take_of, track_of

CAMERA = Intrinsics.assumed(320, 240)
POSES = ("Flat", "Fist", "Pinch")
UNSEEN = 2
"""The row in which the left hand is not there"""
NUMBERS = np.array([10, 11, 12, 14, 15])


def clip(sides: Sequence[Side] = SIDES, **fields) -> Take:
    """Flat, fist, pinch and two random poses, each hand turned otherwise; the left one is not always seen."""
    rng, tracks = np.random.default_rng(5), []
    for side in sides:
        ready = [ready_poses()[name].pose.on(side) for name in POSES]
        pose = np.concatenate([ready, rng.normal(scale=0.4, size=(2, 45))])
        seen = np.arange(len(NUMBERS)) != (UNSEEN if side == "left" else -1)
        given = rng.normal(size=(5, 3)), pose, np.tile([0.0, 0.0, 0.6], (5, 1))
        track = track_of(side, *given, CAMERA)
        known = {
            name: np.where(seen.reshape(-1, *[1] * (np.ndim(values) - 1)), values, np.nan)
            for name in ("global_orient", "hand_pose", "transl", "joints_3d")
            for values in [getattr(track, name)]
        }
        tracks.append(seen_as(replace(track, **known), detected=seen))
    return take_of(tracks, CAMERA, 320, 240, **{"frame_numbers": NUMBERS, "fps": 20.0} | fields)


def wanted(track: HandTrack, row: int | np.integer) -> np.ndarray:
    """(15, 3) where a hand's segments point, seen from the hand, which lies as in VRM's T-pose: MANO's model
    frame has the same axes."""
    points = np.empty((21, 3))
    points[list(KEYPOINT_SOURCE)] = track.joints_3d[row]
    return directions((points - points[0]) @ rotvec_to_rotmat(track.global_orient[row]))


def directions(points: np.ndarray) -> np.ndarray:
    """(15, 3) unit vectors of each finger's three segments, from joints and fingertips (21, 3)."""
    found = np.array(
        [
            points[[second, third, 16 + f]] - points[[first, second, third]]
            for f, (first, second, third) in enumerate(FINGER_JOINTS[finger] for finger in FINGERS)
        ]
    ).reshape(-1, 3)
    return found / np.linalg.norm(found, axis=-1, keepdims=True)


def apart(a: np.ndarray, b: np.ndarray) -> float:
    """The largest angle between directions, in degrees."""
    return float(np.degrees(2.0 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2.0, 0.0, 1.0))).max())


def named(places: Mapping[str, Sequence[float] | np.ndarray], side: str) -> np.ndarray:
    """(21, 3) a hand's joints and fingertips, from the places of a humanoid's bones by VRM's names."""
    order = [f"{side}Hand"] * 16
    for finger, joints in FINGER_JOINTS.items():
        first = "Metacarpal" if finger == "thumb" else "Proximal"
        parts = (first, "Proximal" if finger == "thumb" else "Intermediate", "Distal")
        for joint, part in zip(joints, parts, strict=True):
            order[joint] = f"{side}{finger.title()}{part}"
    return np.array([places[name] for name in [*order, *(f"{side}{f.title()}Tip" for f in FINGERS)]])


class Played:
    """A .vrma, read as glTF's specification says."""

    def __init__(self, data: bytes) -> None:
        assert data[:4] == b"glTF"
        assert int.from_bytes(data[8:12], "little") == len(data)
        size = int.from_bytes(data[12:16], "little")
        self.json = json.loads(data[20 : 20 + size])
        self._buffer = data[28 + size :]
        extension = self.json["extensions"]["VRMC_vrm_animation"]
        assert extension["specVersion"] == "1.0"
        self.bones = {name: bone["node"] for name, bone in extension["humanoid"]["humanBones"].items()}
        self.parents = {c: n for n, node in enumerate(self.json["nodes"]) for c in node.get("children", ())}
        animation = self.json["animations"][0]
        self.tracks: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for channel in animation["channels"]:
            assert channel["target"]["path"] == "rotation", "only hips may move, and nothing may grow"
            sampler = animation["samplers"][channel["sampler"]]
            self.tracks[channel["target"]["node"]] = (
                self._numbers(sampler["input"]).ravel(),
                self._numbers(sampler["output"]),
            )

    def _numbers(self, index: int) -> np.ndarray:
        accessor = self.json["accessors"][index]
        view = self.json["bufferViews"][accessor["bufferView"]]
        columns = {"SCALAR": 1, "VEC4": 4}[accessor["type"]]
        part = self._buffer[view["byteOffset"] :][: view["byteLength"]]
        return np.frombuffer(part, "<f4").reshape(accessor["count"], columns).astype(float)

    def place(self, node: int, time: float | None) -> tuple[np.ndarray, np.ndarray]:
        """Where a node is and how it is turned, in the scene, at one of the times; None: at rest."""
        place, turn = np.zeros(3), np.eye(3)
        if node in self.parents:
            place, turn = self.place(self.parents[node], time)
        held = self.json["nodes"][node]
        assert not {"rotation", "scale", "matrix"} & set(held), "a T-pose that needs no conversion"
        local = np.eye(3)
        if time is not None and node in self.tracks:
            times, quats = self.tracks[node]
            x, y, z, w = quats[np.argmin(np.abs(times - time))]
            local = quat_to_rotmat(np.array([w, x, y, z]))
        return place + turn @ np.array(held["translation"]), turn @ local

    def places(self, time: float | None) -> dict[str, np.ndarray]:
        """By bone, and where fingertips would be: VRM's fingers go on as they lie in the T-pose."""
        found = {name: self.place(node, time)[0] for name, node in self.bones.items()}
        for side in SIDES:
            for finger in FINGERS:
                last = self.bones.get(f"{side}{finger.title()}Distal")
                if last is not None:
                    along = np.array([1.0 if side == "left" else -1.0, 0.0, float(finger == "thumb")])
                    place, turn = self.place(last, time)
                    found[f"{side}{finger.title()}Tip"] = place + 0.02 * turn @ along
        return found
