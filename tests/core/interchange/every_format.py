"""Small valid files of every reader, made by the tests of each format."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np

from handfit_core.interchange.writers import writer_for
from tests.core.interchange import point_files, test_hand_tracking, test_sam3d_body
from tests.core.interchange.mano_files import laid_out, layouts
from tests.told import told
from tests.torch_files import torch_zip


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
    for layout, kind in point_files.PICTURES.items():
        saved(f"{layout.__name__}.json", kind, [layout(0)])
    saved("b.json", "openpose", point_files.openpose(0))
    openpose = [{"people": []}, point_files.openpose(0)]
    found["openpose"].append(point_files.folder(folder / "openpose", openpose))
    saved("d.json", "mmpose", {"meta_info": {}, "instance_info": [point_files.instance(0)]})
    hand = {"keypoints": told().pixels["left"][0].tolist(), "keypoint_scores": [0.8] * 21}
    saved("e.json", "mmpose", [hand])
    np.save(folder / "mediapipe_left_hand_3d_xyz.npy", point_files.in_room("left"))
    found["freemocap"] = [folder / "mediapipe_left_hand_3d_xyz.npy"]
    found["freemocap"].append(point_files.trajectories(folder / "f.csv", "left"))
    below = point_files.from_below("left", 0).tolist()
    codes = dict(zip(point_files.APPLE_CODES, below, strict=True))
    saved("g.json", "apple-vision", {"chirality": "left", **codes})
    saved("h.csv", "apple-vision", _line(point_files.named("xy", *point_files.APPLE_NAMES), below))
    sides = point_files.named("xyz", *(f"left_hand_{name.lower()}" for name in point_files.NAMES))
    for name, header in (("i.csv", point_files.wide()), ("j.csv", sides)):
        saved(name, "mediapipe", _line(header, point_files.landmarks("left", 0)))
    saved("k.json", "coco-wholebody", point_files.annotations())
    saved("l.json", "alphapose", point_files.alphapose(136))
    saved("m.json", "interhand", point_files.interhand())
    saved("n.json", "xr-points", [point_files.headset(0)])
    found["aria"] = [point_files.aria(folder / "aria.csv")]
    found["trc"] = [point_files.trc(folder / "a.trc")]
    np.save(folder / "a.npy", told().points["left"])
    (folder / "a.pt").write_bytes(torch_zip({"hand": told().points["left"].astype(np.float32)}))
    (folder / "a.pkl").write_bytes(pickle.dumps([*told().points["left"]]))
    found["arrays"] = [folder / name for name in ("a.npy", "a.pt", "a.pkl")]
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
        ("leap", "websocket.json", point_files.websocket()),
        ("leap", "leapc.json", point_files.leapc()),
    ):
        found.setdefault(kind, []).append(point_files.saved(folder / name, content))
    people = folder / "people"
    people.mkdir()
    for number in range(2):
        np.savez(people / f"img_subj{number:02}.npz", **test_sam3d_body.person(number - 0.5))
    found["sam3d-body"] = [people, people / "img_subj00.npz"]
    for number, (kind, contents) in enumerate(layouts().values()):
        found.setdefault(kind, []).append(laid_out(folder / f"mano{number}", contents))
    return found
