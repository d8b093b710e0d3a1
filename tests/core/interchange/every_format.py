"""Small valid files of every reader, made by the tests of each format."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np

from handfit_core.interchange.skeletons import UP_AXES
from handfit_core.interchange.writers import writer_for
from tests.core.interchange import (
    test_apple_vision,
    test_dyn_hamr,
    test_freemocap,
    test_hamer,
    test_hand_tracking,
    test_hawor,
    test_leap,
    test_mediapipe,
    test_mmpose,
    test_openpose,
    test_sam3d_body,
    test_smplx,
)
from tests.told import told


def keypoint_files(folder: Path) -> dict[str, list[Path]]:
    """Files of every reader of keypoints, by its name."""
    found: dict[str, list[Path]] = {}

    def saved(name: str, kind: str, content: object) -> None:
        path = folder / name
        path.write_text(json.dumps(content) if not isinstance(content, str) else content)
        found.setdefault(kind, []).append(path)

    take = told().take
    for name, kind in (
        ("a.points.json", "points"),
        ("a.points.csv", "points-table"),
        ("a.mediapipe.json", "mediapipe"),
    ):
        writer_for(folder / name).write(take, folder / name)
        found.setdefault(kind, []).append(folder / name)
    saved("b.json", "openpose", {"people": [test_openpose.person(0)]})
    found["openpose"].append(test_openpose.folder(folder / "openpose", [[], [test_openpose.person(0)]]))
    saved("c.json", "mmpose", [{"frame_id": 0, "instances": [test_mmpose.instance(0)]}])
    saved("d.json", "mmpose", {"meta_info": {}, "instance_info": [test_mmpose.instance(0)]})
    hand = {"keypoints": told().pixels["left"][0].tolist(), "keypoint_scores": [0.8] * 21}
    saved("e.json", "mmpose", [hand])
    np.save(folder / "mediapipe_left_hand_3d_xyz.npy", test_freemocap.in_room("left"))
    found["freemocap"] = [folder / "mediapipe_left_hand_3d_xyz.npy"]
    names = [f"left_hand_{name.lower()}" for name in test_mediapipe.NAMES]
    found["freemocap"].append(test_freemocap.rows_of(names, test_freemocap.in_room("left"), folder / "f.csv"))
    apple = dict(zip(test_apple_vision.CODES, test_apple_vision.normalised("left", 0).tolist(), strict=True))
    saved("g.json", "apple-vision", {"chirality": "left", **apple})
    saved(
        "h.csv",
        "apple-vision",
        _line([f"{n}_{c}" for n in test_apple_vision.NAMES for c in "xy"], apple.values()),
    )
    for i, layout in enumerate(test_mediapipe.LAYOUTS):
        saved(f"mediapipe{i}.json", "mediapipe", [layout(0)])
    saved("i.csv", "mediapipe", _line(test_mediapipe.wide(0), test_mediapipe.landmarks("left", 0)))
    sides = [f"{name}_{axis}" for name in names for axis in "xyz"]
    saved("j.csv", "mediapipe", _line(sides, test_mediapipe.landmarks("left", 0)))
    return found


def _line(header: list[str], rows: object) -> str:
    return ",".join(header) + "\n" + ",".join(str(cell) for row in rows for cell in row)  # type: ignore[attr-defined]


def other_files(folder: Path) -> dict[str, list[Path]]:
    """Files and folders of every other reader, by its name."""
    take = told().take
    found: dict[str, list[Path]] = {}
    for name, kind in (("a.bvh", "bvh"), ("a.smplx.npz", "smplx"), ("a.mano.npz", "smplx-keywords")):
        writer_for(folder / name).write(take, folder / name)
        found[kind] = [folder / name]
    for kind, name, content in (
        ("hand-tracking", "named.json", test_hand_tracking.frames()),
        ("leap", "websocket.json", test_leap.websocket()),
        ("leap", "leapc.json", test_leap.leapc()),
        ("wilor-mini", "mini.json", test_hamer.listed([test_hamer.mini(row) for row in range(2)])),
    ):
        (folder / name).write_text(json.dumps(content))
        found.setdefault(kind, []).append(folder / name)
    mini = folder / "mini.pkl"
    mini.write_bytes(pickle.dumps([test_hamer.mini(row) for row in range(2)]))
    found["wilor-mini"].append(mini)
    people = folder / "people"
    people.mkdir()
    for number in range(2):
        np.savez(people / f"img_subj{number:02}.npz", **test_sam3d_body.person(number - 0.5))
    found["sam3d-body"] = [people, people / "img_subj00.npz"]
    found["hamer"] = [
        test_hamer.in_files(folder / f"hamer{number}", kind) for number, kind in enumerate(test_hamer.KINDS)
    ]
    np.savez(folder / "world_space_res.npz", **test_hawor.five())
    found["hawor"] = [test_hawor.clip(folder / "hawor"), folder / "world_space_res.npz"]
    found["dyn-hamr"] = [test_dyn_hamr.results(folder / "a_world_results.npz")]
    found["smplx"] += [test_smplx.amass(folder / f"amass{n}.npz", n, UP_AXES["z"]) for n in (52, 55)]
    return found
