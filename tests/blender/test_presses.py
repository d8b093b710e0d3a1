"""What the artist has corrected stays, in whatever order keys are merged, simplified, undone, saved, opened.

A correction is lost only by a press that takes it away by its meaning: Undo, of the press before it. All Keys
goes back to the keys of before Simplify, with the corrections and merged layers of after it.
"""

from __future__ import annotations

from itertools import permutations

import bpy
import numpy as np
import pytest

from blender_manient.rigs import rig_of
from blender_manient.rigs.captured_hand import bone_names
from blender_manient.scene import corrections
from blender_manient.scene.build import build_take
from blender_manient.scene.keys import pose_at
from blender_manient.session import key_preview

from .test_corrections import correct
from .test_simplify import apart, chosen, key_change

pytestmark = pytest.mark.usefixtures("registered")

EARLY, LATE = 12, 24
"""Frames that are corrected"""
TOGETHER = (
    *(("merge", "simplify", other) for other in ("all keys", "correct", "undo", "open")),
    *(("open", "correct", other) for other in ("undo", "all keys")),
    ("undo", "correct", "all keys"),
)
"""Presses that are tried in every order: each two of the six, and those that replace keys with every other"""


class Artist:
    """One who presses buttons and looks at the panel in between, and what must be left of the work."""

    def __init__(self, armature, folder) -> None:
        self.name, self.folder = chosen(armature).name, folder
        bpy.context.scene.manient.keys_parts = {"MIDDLE"}  # which is enough to lose, and faster
        correct(armature, EARLY, seed=5)
        self.corrected = {EARLY: self.pose(EARLY)}
        self.before: list[dict[int, np.ndarray]] = []
        self.remember()

    @property
    def armature(self):
        return bpy.data.objects[self.name]

    def pose(self, frame: int) -> np.ndarray:
        """(1, 16, 4)"""
        return pose_at(rig_of(self.armature), np.array([float(frame)]))[0]

    def remember(self) -> None:
        bpy.ops.ed.undo_push(message="Press")
        self.before.append(dict(self.corrected))

    def press(self, what: str) -> None:
        if key_preview.preview(bpy.context) is None:
            while key_preview._continue() is not None:
                pass
        if what == "undo":
            if len(self.before) > 1:
                bpy.ops.ed.undo()
                self.before.pop()
                self.corrected = dict(self.before[-1])
            return
        if what == "open":
            path = str(self.folder / "hand.blend")
            bpy.ops.wm.save_as_mainfile(filepath=path)
            bpy.ops.wm.open_mainfile(filepath=path)
            chosen(self.armature)
            self.before.clear()
        elif what == "merge":
            bpy.ops.manient.add_key_layer()
            for frame, turn in ((20.0, 0.0), (LATE, 0.4), (28.0, 0.0)):
                key_change(self.armature, bone_names("right")[5], frame, (turn, 0.0, 0.0))
            bpy.ops.manient.end_key_layer(merge=True)
            self.corrected[LATE] = self.pose(LATE)
        elif what == "correct":
            correct(self.armature, LATE, seed=len(self.before))
            self.corrected[LATE] = self.pose(LATE)
        elif what == "simplify":
            bpy.ops.manient.simplify_keys()
        elif bpy.ops.manient.restore_keys.poll():
            bpy.ops.manient.restore_keys()
        self.remember()


@pytest.mark.parametrize(
    "presses", (order for each in TOGETHER for order in permutations(each)), ids=", ".join
)
def test_no_order_of_presses_loses_a_correction(make_take, tmp_path, presses):
    take = make_take(sides=("right",), frame_numbers=np.arange(1, 37)).take
    artist = Artist(build_take(take).hands[0].armature, tmp_path)
    for press in presses:
        artist.press(press)
        for frame, pose in artist.corrected.items():
            assert apart(artist.pose(frame), pose) <= bpy.context.scene.manient.keys_degrees, (press, frame)
    field = corrections.corrections_of(artist.armature)
    assert EARLY in field.corrected
    assert corrections.why_elsewhere(artist.armature) is None
    assert corrections.displaced(artist.armature) == []
