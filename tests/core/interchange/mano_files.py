"""Hands that are known (known_hands.py) in the files of programs that keep MANO's parameters."""

from __future__ import annotations

import json
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core.common.skeleton import SIDES, Side
from handfit_core.geometry.rotations import rotmat_to_rotvec, rotvec_to_quat, rotvec_to_rotmat
from handfit_core.hand_model.axes import MIRROR_X
from handfit_core.interchange.skeletons import UP_AXES
from tests.core.interchange.known_hands import (
    FRAMES,
    HANDS,
    TURN,
    coefficients_of,
    joints_turned,
    matrices,
    mean_of,
    wrist_of,
)
from tests.imitation_mano import imitation_arrays
from tests.torch_files import tensors_in_pickle, torch_zip

FOCAL = 5000.0 / 256.0 * 1280.0
NUMBERS = range(1, FRAMES + 1)


def written(path: Path, content: Any) -> Path:
    """A file of the kind that its ending says; None among the arrays of an .npz is left out."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npz":
        np.savez(path, **{name: value for name, value in content.items() if value is not None})
    elif path.suffix == ".json":
        path.write_text(json.dumps(content, default=lambda array: array.tolist()), encoding="utf-8")
    elif path.suffix == ".jsonl":
        path.write_text(content)
    elif path.suffix == ".npy":
        np.save(path, content, allow_pickle=True)
    elif path.suffix == ".pt":
        path.write_bytes(torch_zip(content))
    elif path.suffix == ".pth":
        path.write_bytes(tensors_in_pickle(content))
    else:
        path.write_bytes(pickle.dumps(content))
    return path


def laid_out(folder: Path, contents: Mapping[str, Any]) -> Path:
    """The folder with files of these contents, or the only file."""
    paths = [written(folder / name, content) for name, content in contents.items()]
    return folder if len(paths) > 1 else paths[0]


# HaMeR and WiLoR


def network(frame: int) -> dict[str, Any]:
    """What HaMeR's network gives for both hands of one picture, and what its demo works out of it."""
    rows = []
    for side, hand in HANDS.items():
        turn = TURN if side == "left" else np.ones(3)
        orient, pose = hand.global_orient * turn, hand.hand_pose * np.tile(turn, 15)
        rows.append((matrices(orient)[frame], matrices(pose)[frame], hand.betas, hand.transl[frame]))
    orient, pose, betas, transl = (np.stack(column) for column in zip(*rows, strict=True))
    return {
        "pred_mano_params": {"global_orient": orient, "hand_pose": pose, "betas": betas},
        "pred_cam_t_full": transl,
        "right": np.array([0.0, 1.0]),
        "pred_cam_t": np.full((2, 3), 9.0),
    }


def at_row(values: dict[str, Any], row: int | slice) -> dict[str, Any]:
    """One hand of a picture."""
    return {k: at_row(v, row) if isinstance(v, dict) else v[row] for k, v in values.items()}


def _flat(values: dict[str, Any]) -> dict[str, Any]:
    return {**values["pred_mano_params"], **{k: v for k, v in values.items() if k != "pred_mano_params"}}


def rows_of_hands() -> dict[str, Any]:
    """All hands of a clip in one array each, with their frames."""
    frames = [_flat(network(n - 1)) for n in NUMBERS]
    joined = {key: np.concatenate([each[key] for each in frames]) for key in frames[0]}
    return joined | {"frame": np.repeat(NUMBERS, 2)}


def mini(frame: int) -> list[dict[str, Any]]:
    """What WiLoR-mini's pipeline gives for one picture."""
    return [
        {
            "hand_bbox": [0.0, 0.0, 10.0, 10.0],
            "is_right": float(side == "right"),
            "wilor_preds": {
                "global_orient": hand.global_orient[frame].reshape(1, 1, 3),
                "hand_pose": hand.hand_pose[frame].reshape(1, 15, 3),
                "betas": hand.betas.reshape(1, 10),
                "pred_cam_t_full": hand.transl[frame].reshape(1, 3),
                "scaled_focal_length": FOCAL,
                "pred_keypoints_2d": np.zeros((1, 21, 2)),
            },
        }
        for side, hand in HANDS.items()
    ]


def frames_with_hands() -> dict[str, Any]:
    """As people write WiLoR-mini's hands into JSON of their own, here without any in the first frame."""
    frames = []
    for n in NUMBERS:
        hands = []
        for hand in mini(n - 1):
            found = hand["wilor_preds"]
            camera = {name: found[name] for name in ("pred_cam_t_full", "scaled_focal_length")}
            turns = {name: found[name] for name in ("global_orient", "hand_pose", "betas")}
            hands.append({"is_right": hand["is_right"], "mano": turns, "camera": camera})
        frames.append({"frame": n, "image_size": [1280, 720], "hands": hands})
    return {"fps": 25.0, "frames": [{"frame": 0, "hands": []}, *frames]}


# HaWoR


def hawor(**changes: Any) -> dict[str, Any]:
    """The files that HaWoR makes of a clip: the right hand in one piece, the left one in two."""
    files = {}
    for side, first, last in (("left", 0, 2), ("left", 4, FRAMES - 1), ("right", 0, FRAMES - 1)):
        hand, rows = HANDS[side], slice(first, last + 1)
        files[f"cam_space/{SIDES.index(side)}/{first}_{last}.json"] = {
            "init_root_orient": joints_turned(hand)[None, rows, 0],
            "init_hand_pose": joints_turned(hand)[None, rows, 1:],
            "init_trans": hand.transl[None, rows],
            "init_betas": np.tile(hand.betas, (1, last - first + 1, 1)),
            **changes,
        }
    return files


def hawor_world(before: str = "") -> dict[str, np.ndarray]:
    """world_space_res by names, left hand first; the left one is not there in the last frame."""
    arrays = {
        name: np.stack([np.broadcast_to(getattr(hand, ours), (FRAMES, *shape)) for hand in HANDS.values()])
        for name, ours, shape in (
            ("trans", "transl", (3,)),
            ("rot", "global_orient", (3,)),
            ("hand_pose", "hand_pose", (45,)),
            ("betas", "betas", (10,)),
        )
    }
    arrays["valid"] = np.ones((2, FRAMES))
    arrays["valid"][0, -1] = 0.0
    return {before + name: array for name, array in arrays.items()}


# Dyn-HaMR


def cameras() -> tuple[np.ndarray, np.ndarray]:
    """World to camera, of each frame: (T, 3, 3), (T, 3)."""
    rng = np.random.default_rng(7)
    return rotvec_to_rotmat(rng.uniform(-1.0, 1.0, (FRAMES, 3))), rng.uniform(-1.0, 1.0, (FRAMES, 3))


def dyn_hamr(model: Path | None = None, **changes: Any) -> dict[str, Any]:
    """world_results of `HANDS`, which are in the camera's frame: the way back is written out."""
    turned, moved = cameras()
    back = np.swapaxes(turned, -1, -2)
    tracks = []
    for side, hand in HANDS.items():
        wrist = wrist_of(side, model, hand.betas if model else None)
        orient = rotmat_to_rotvec(back @ rotvec_to_rotmat(hand.global_orient))
        place = (back @ (hand.transl + wrist - moved)[..., None])[..., 0] - wrist
        pose = hand.hand_pose
        if side == "left":
            orient, pose, place = orient * TURN, pose * np.tile(TURN, 15), place @ MIRROR_X
        tracks.append((place, orient, pose, hand.betas))
    names = ("trans", "root_orient", "pose_body", "betas")
    arrays = {
        **{name: np.stack(each) for name, each in zip(names, zip(*tracks, strict=True), strict=True)},
        "is_right": np.repeat([[0.0], [1.0]], FRAMES, axis=1),
        "cam_R": np.stack([turned, turned]),
        "cam_t": np.stack([moved, moved]),
        "intrins": np.array([1400.0, 1400.0, 640.0, 360.0]),
    }
    return arrays | changes


# Bodies of SMPL+H and SMPL-X

CHAINS: dict[Side, list[str]] = {
    side: "spine1 spine2 spine3".split()
    + [f"{side}_{part}" for part in ("collar", "shoulder", "elbow", "wrist")]
    for side in SIDES
}
JOINTS = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 left_foot "
    "right_foot neck left_collar right_collar head left_shoulder right_shoulder left_elbow right_elbow "
    "left_wrist right_wrist"
).split()
"""Of a body, as smplx's joint_names.py has them"""


def body(turn: np.ndarray) -> np.ndarray:
    """(T, 66) of a body that stands upright in the world that `turn` brings before the camera, and whose
    wrists are turned as `HANDS`: the wrist's own rotation makes up for the random joints before it."""
    rng = np.random.default_rng(0)
    poses = rng.uniform(-0.3, 0.3, (FRAMES, 22, 3))
    upright = turn.T @ UP_AXES["y"]  # SMPL's rest is y-up
    poses[:, 0] = rotmat_to_rotvec(upright @ rotvec_to_rotmat(rng.uniform(-0.2, 0.2, (FRAMES, 3))))
    for side, names in CHAINS.items():
        before = rotvec_to_rotmat(poses[:, 0])
        for name in names[:-1]:
            before = before @ rotvec_to_rotmat(poses[:, JOINTS.index(name)])
        wanted = turn.T @ rotvec_to_rotmat(HANDS[side].global_orient)
        poses[:, JOINTS.index(names[-1])] = rotmat_to_rotvec(np.swapaxes(before, -1, -2) @ wanted)
    return poses.reshape(FRAMES, 66)


def amass(joints: int, turn: np.ndarray, **changes: Any) -> dict[str, Any]:
    """An animation as AMASS has it: of 52 joints (SMPL+H) or 55 (SMPL-X)."""
    between = np.zeros((FRAMES, 3 * (joints - 52)))
    hands = [hand.hand_pose for hand in HANDS.values()]
    arrays = {
        "poses": np.concatenate([body(turn), between, *hands], axis=1),
        "trans": np.zeros((FRAMES, 3)),
        "betas": np.zeros(16),
        "gender": np.array("female"),
        "mocap_frame_rate" if joints == 55 else "mocap_framerate": np.array(120.0),
    }
    return arrays | changes


def in_parts() -> dict[str, Any]:
    """As AMASS' SMPL-X files have poses, too."""
    whole, fingers = body(UP_AXES["z"]), np.concatenate([hand.hand_pose for hand in HANDS.values()], axis=1)
    poses = {"root_orient": whole[:, :3], "pose_body": whole[:, 3:], "pose_hand": fingers}
    return {**poses, "trans": np.zeros((FRAMES, 3)), "mocap_frame_rate": 60}


def keywords(rows: slice, turn: np.ndarray) -> dict[str, np.ndarray]:
    """A body by smplx's names."""
    whole = body(turn)[rows]
    poses = {f"{side}_hand_pose": hand.hand_pose[rows] for side, hand in HANDS.items()}
    still = np.zeros((len(whole), 3))
    start = {"global_orient": whole[:, :3], "body_pose": whole[:, 3:]}
    return {**start, **poses, "jaw_pose": still, "transl": still, "betas": np.ones((1, 10))}


# Data sets, whose worlds are turned back to the camera's frame


def at_home(side: Side, world: np.ndarray, own: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A known hand's turn, pose and place in a world, whose axes `world` turns to the camera's: with the open
    hand, or, relative to the mean, with `own_mano`'s model."""
    hand, wrist = HANDS[side], wrist_of(side)
    if own:
        arrays = imitation_arrays(side)
        wrist = (arrays["J_regressor"] @ arrays["v_template"])[0]
    turned = rotmat_to_rotvec(world.T @ rotvec_to_rotmat(hand.global_orient))
    return turned, hand.hand_pose - own * mean_of(side), (hand.transl + wrist) @ world - wrist


def hot3d() -> str:
    """Lines; every second one is another camera's, a moment later."""
    lines, hands = [], {side: at_home(side, UP_AXES["y"], True) for side in SIDES}
    for frame in range(FRAMES):
        row = {}
        for key, (side, (turned, pose, place)) in enumerate(hands.items()):
            wrist = {"q_wxyz": rotvec_to_quat(turned[frame]).tolist(), "t_xyz": place[frame].tolist()}
            coefficients = coefficients_of(pose[None, frame], side)[0].tolist()
            row[str(key)] = {"pose": coefficients, "wrist_xform": wrist, "betas": [0.0] * 10}
        time = 56752108188860 + round(frame * 1e9 / 30.0)
        lines += [json.dumps({"timestamp_ns": time + later, "hand_poses": row}) for later in (0, 90813)]
    return "\n".join(lines)


def data_sets() -> dict[str, tuple[str, dict[str, Any]]]:
    arctic, grab, frames = {}, {"framerate": 120.0}, {str(16000 + n): {} for n in NUMBERS}
    for side in SIDES:
        turned, pose, place = at_home(side, UP_AXES["z"], True)
        arctic[side] = {"rot": turned, "pose": pose, "trans": place, "shape": np.zeros((FRAMES, 10))}
        turned, pose, place = at_home(side, UP_AXES["z"], False)
        params = {"global_orient": turned, "hand_pose": pose[:, :24], "fullpose": pose, "transl": place}
        grab[f"{side[0]}hand"] = {"params": params, "vtemp": "tools/subject_meshes/female/s1_rhand.ply"}
        turned, pose, place = at_home(side, np.eye(3), True)
        for row, frame in enumerate(frames.values()):
            poses = np.concatenate([turned[row], pose[row]])
            frame[side] = {"pose": poses, "shape": np.zeros(10), "trans": place[row]}
    turned, pose, place = at_home("right", np.eye(3), True)
    rows = np.concatenate([turned, coefficients_of(pose, "right"), place], axis=1)
    labels = zip(NUMBERS, rows, strict=True)
    dexycb = {f"labels_{n:06}.npz": {"pose_m": row[None], "seg": np.zeros(3)} for n, row in labels}
    photos = np.concatenate([turned, pose, np.zeros((FRAMES, 13))], axis=1)[:, None]
    turned, pose, place = at_home("right", np.diag([1.0, -1.0, -1.0]), False)
    camera = np.array([[614.6, 0.0, 320.0], [0.0, 614.1, 240.0], [0.0, 0.0, 1.0]])
    ho3d = {
        f"meta/{n:04}.pkl": {"camMat": camera, "handPose": row, "handTrans": trans, "handBeta": np.ones(10)}
        for n, row, trans in zip(NUMBERS, np.concatenate([turned, pose], axis=1), place, strict=True)
    }
    fingers = [hand.hand_pose for hand in HANDS.values()]
    motion = np.concatenate([body(UP_AXES["y"]), *fingers, np.zeros((FRAMES, 166))], axis=1)
    valid = {f"{side}_hand_valid": np.ones(FRAMES, dtype=bool) for side in SIDES}
    gvhmr = keywords(slice(None), UP_AXES["y"]) | valid
    return {
        "HOT3D": ("hot3d", {"a.jsonl": hot3d()}),
        "ARCTIC's hands": ("arctic", {"a.mano.npy": arctic}),
        "GRAB": ("grab", {"a.npz": grab}),
        "InterHand2.6M": ("interhand-mano", {"a_MANO.json": {"0": frames}}),
        "DexYCB": ("dexycb", dexycb),
        "HO-3D": ("ho3d", ho3d),
        "FreiHAND": ("freihand", {"training_mano.json": photos.tolist()}),
        "Motion-X": ("smplx", {"a.npy": motion}),
        "GVHMR with HaMeR's hands": ("smplx-keywords", {"a.npz": gvhmr}),
    }


def layouts() -> dict[str, tuple[str, dict[str, Any]]]:
    """The reader of each layout, and the files that have `HANDS` so."""
    pictures, minis = {n: network(n - 1) for n in NUMBERS}, {n: mini(n - 1) for n in NUMBERS}
    hands = {f"{n:06}_{row}.npz": at_row(v, row) for n, v in pictures.items() for row in (0, 1)}
    return {
        "HaMeR, a file a picture": ("hamer", {f"f_{n:05}.npz": _flat(v) for n, v in pictures.items()}),
        "HaMeR, a file a hand": ("hamer", hands),
        "HaMeR, by picture": ("hamer", {"a.json": {f"img_{n:04}.jpg": v for n, v in pictures.items()}}),
        "HaMeR, by frame": ("hamer", {"a.pkl": pictures}),
        "HaMeR, rows with frames": ("hamer", {"a.npz": rows_of_hands()}),
        "WiLoR-mini, pickle": ("wilor-mini", {"a.pkl": [*minis.values()]}),
        "WiLoR-mini, a file a picture": ("wilor-mini", {f"{n:03}.json": v for n, v in minis.items()}),
        "WiLoR-mini, frames with hands": ("wilor-mini", {"a.json": frames_with_hands()}),
        "WiLoR-mini, lists, at first empty": ("wilor-mini", {"a.json": [[], *minis.values()]}),
        "HaWoR, a clip": ("hawor", hawor()),
        "HaWoR, its world": ("hawor", {"world_space_res.npz": hawor_world()}),
        "HaWoR, its world as pred_": ("hawor", {"world_space_res.npz": hawor_world("pred_")}),
        "HaWoR, its world as it writes it": ("hawor", {"world_space_res.pth": [*hawor_world().values()]}),
        "HaMeR, in PyTorch's files": ("hamer", {f"{n:06}.pt": v for n, v in pictures.items()}),
        "Dyn-HaMR, in PyTorch's file": ("dyn-hamr", {"a.pt": dyn_hamr()}),
        "Dyn-HaMR": ("dyn-hamr", {"a_000300_world_results.npz": dyn_hamr()}),
        "AMASS, SMPL+H, z-up": ("smplx", {"a.npz": amass(52, UP_AXES["z"])}),
        "AMASS, z-up": ("smplx", {"a.npz": amass(55, UP_AXES["z"])}),
        "AMASS, y-up": ("smplx", {"a.npz": amass(55, UP_AXES["y"])}),
        "AMASS, the camera's, y-down": ("smplx", {"a.npz": amass(55, np.eye(3))}),
        "AMASS, in parts, z-up": ("smplx", {"a.npz": in_parts()}),
        "ARCTIC": ("smplx-keywords", {"a.smplx.npy": keywords(slice(None), UP_AXES["z"])}),
        **data_sets(),
    }
