"""Tables of a hand's bones, and the JSON that armatures and preset files keep of them."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import JOINT_NAMES, NUM_JOINTS, SIDES
from handfit_core.retarget.hand_map import HandMap, empty_map, from_preset, read_preset, to_preset

PLAIN = HandMap("left", tuple(f"b{j}" for j in range(NUM_JOINTS)))
ODD = HandMap(
    "right",
    ("右手首", "", "b'2\"", "親指０", *(f"mixamorig1:x.{j}\n" for j in range(4, 15)), "b2"),
    ("", "palm\\02", "", "palm.04.L"),
    control="hand_ik.R",
    rig="Auto-Rig Pro",
    thumb_roll=-12.5,
    keep_rest=True,
    fold=0.25,
)


@pytest.mark.parametrize("hand_map", [PLAIN, ODD, empty_map("left"), empty_map("right")])
def test_json_says_all_of_it(hand_map):
    assert HandMap.from_json(hand_map.to_json()) == hand_map
    assert from_preset(to_preset([hand_map])) == [hand_map]


def test_json_is_readable_and_may_leave_out():
    assert "右手首" in ODD.to_json()
    assert json.loads(ODD.to_json())["palm"]["middle"] == "palm\\02"
    short = json.dumps({"side": "left", "bones": {"wrist": "hand", "index_proximal": "f1"}})
    found = HandMap.from_json(short)
    assert found == replace(empty_map("left"), bones=("hand", "f1", *[""] * 14))


def changed(**values) -> str:
    return json.dumps({**json.loads(PLAIN.to_json()), **values})


REFUSED = [
    *("{", "", "[" * 100_000, "[]", "1e400", "null", PLAIN.to_json() + " " * 1_000_000),
    *(json.dumps({"bones": {}}), json.dumps({"side": "left"})),
    *(changed(side=side) for side in ("middle", ["left"])),
    *(changed(bones=bones) for bones in (["a"] * 16, {"tail": "b"}, {"wrist": 1}, {"wrist": None})),
    *(changed(bones={"wrist": "b" * 257}), changed(palm={"thumb": "b"}), changed(palm="palm")),
    *(changed(control=1), changed(rig="r" * 257), changed(rig="\ud800")),
    *(changed(thumb_roll=roll) for roll in ("30", True, float("inf"), float("nan"), 361, 10**400)),
    *(changed(keep_rest=1), changed(fold=[0.5]), changed(fold=1.01), changed(fold=-0.01)),
]


@pytest.mark.parametrize("text", REFUSED, ids=range(len(REFUSED)))
def test_other_texts_are_refused(text):
    for read, wrapped in ((HandMap.from_json, text), (from_preset, f"[{text}]"), (from_preset, text)):
        with pytest.raises(HandModelError) as caught:
            read(wrapped)
        assert len(str(caught.value)) < 400


def test_a_preset_has_each_hand_once(tmp_path):
    right = replace(PLAIN, side="right")
    assert from_preset(to_preset([PLAIN, right])) == [PLAIN, right]
    for hands in ([], [PLAIN, PLAIN], [PLAIN, right, right]):
        with pytest.raises(HandModelError, match="one table for a hand"):
            from_preset(to_preset(hands))
    path = tmp_path / "preset.json"
    path.write_text(to_preset([right]), encoding="utf-8")
    assert read_preset(path) == [right]
    for data in (b"\xff\xfe", b"[" + b" " * 1_000_001 + b"]"):
        path.write_bytes(data)
        with pytest.raises(HandModelError, match=r"preset\.json: "):
            read_preset(path)
    with pytest.raises(HandModelError, match=r"gone\.json: "):
        read_preset(tmp_path / "gone.json")


def test_keyed_bones():
    toon = replace(PLAIN, bones=(*PLAIN.bones[:7], *PLAIN.bones[10:13], *PLAIN.bones[10:]))
    assert toon.keyed == tuple(dict.fromkeys(toon.bones[1:]))
    assert len(toon.keyed) == 12
    palms = replace(PLAIN, palm=("p1", "p2", "p3", "p4"))
    assert palms.keyed == PLAIN.keyed
    assert replace(palms, fold=0.5).keyed == ("p3", "p4", *PLAIN.keyed)
    assert PLAIN.moved_by == "b0"
    assert ODD.moved_by == "hand_ik.R"
    assert PLAIN.fingers == ("thumb", "index", "middle", "ring", "little")
    assert replace(PLAIN, bones=("b0", *[""] * 14, "b15")).fingers == ("thumb",)
    assert PLAIN.mapped == {j: f"b{j}" for j in range(1, NUM_JOINTS)}


@pytest.mark.parametrize("side", SIDES)
def test_missing_bones_are_named(side):
    PLAIN.check(set(PLAIN.bones))
    with pytest.raises(HandModelError, match="no bone 'b7'"):
        PLAIN.check(set(PLAIN.bones) - {"b7"})
    with pytest.raises(HandModelError, match="no bone 'ik'"):
        replace(PLAIN, control="ik").check(set(PLAIN.bones))
    with pytest.raises(HandModelError, match=f"stands for the {side} hand itself"):
        empty_map(side).check(set())
    with pytest.raises(HandModelError, match=f"a finger of the {side} hand"):
        replace(empty_map(side), bones=("hand", *[""] * 15)).check({"hand"})
    assert len(JOINT_NAMES) == len(empty_map(side).bones)
