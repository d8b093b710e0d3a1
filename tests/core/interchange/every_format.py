"""Small valid files of every reader, made by the tests of each format."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from handfit_core.interchange.writers import writer_for
from tests.core.interchange import test_hand_tracking, test_sam3d_body
from tests.core.interchange.mano_files import laid_out, layouts
from tests.core.interchange.point_files import MADE, saved, written
from tests.told import told


def keypoint_files(folder: Path) -> dict[str, list[Path]]:
    """Files of every reader of keypoints, by its name."""
    found: dict[str, list[Path]] = {}
    for name, made in MADE.items():
        found.setdefault(made.reader, []).append(written(folder, name))
    for name, kind in (
        ("a.points.json", "points"),
        ("a.points.csv", "points-table"),
        ("a.mediapipe.json", "mediapipe"),
    ):
        writer_for(folder / name).write(told().take, folder / name)
        found.setdefault(kind, []).append(folder / name)
    return found


def other_files(folder: Path) -> dict[str, list[Path]]:
    """Files and folders of every other reader, by its name."""
    found: dict[str, list[Path]] = {}
    for name, kind in (("a.bvh", "bvh"), ("a.smplx.npz", "smplx"), ("a.mano.npz", "smplx-keywords")):
        writer_for(folder / name).write(told().take, folder / name)
        found[kind] = [folder / name]
    found["hand-tracking"] = [saved(folder / "named.json", test_hand_tracking.frames())]
    people = folder / "people"
    people.mkdir()
    for number in range(2):
        np.savez(people / f"img_subj{number:02}.npz", **test_sam3d_body.person(number - 0.5))
    found["sam3d-body"] = [people, people / "img_subj00.npz"]
    for number, (kind, contents) in enumerate(layouts().values()):
        found.setdefault(kind, []).append(laid_out(folder / f"mano{number}", contents))
    return found
