"""The panel Character: what it says of a rig, the table of its bones, and what is refused before anything is
changed."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest

from blender_manient import rigs
from blender_manient.operators.character import opposite
from blender_manient.panels.character import MANIENT_PT_character, MANIENT_PT_character_bones
from blender_manient.rigs.character import Character
from blender_manient.scene import characters
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import active_character, hand_map_of, keep_map, kept_map, table_of
from blender_manient.scene.store import hand_of
from handfit_core.errors import HandModelError
from handfit_core.retarget.hand_map import HandMap, from_preset
from handfit_core.skeleton import SIDES, Side, other_side
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, map_of, mixamo_names
from .conftest import action_curves

pytestmark = pytest.mark.usefixtures("registered")

AWAY = {"left": np.array([1.0, 0.0, 1.0]), "right": np.array([-1.0, 0.0, 1.0])}


def mixamo(sides=SIDES, prefix="mixamorig:", name="Character"):
    """A character with Mixamo's names; the two hands are each other's mirror images."""
    specs = [BoneSpec(f"{prefix}Hips", "", (0, 0, 0), (0, 0, 1))]
    for side in sides:
        names = mixamo_names(side, prefix)
        specs += hand_specs(
            side, np.random.default_rng(3), names=names, parent=f"{prefix}Hips", place=AWAY[side]
        )
    return build_armature(specs, name)


def captured(make_take, sides: tuple[Side, ...] = SIDES):
    built = build_take(make_take(sides=sides).take)
    return {hand.side: hand for hand in (hand_of(one.armature) for one in built.hands) if hand is not None}


def select(armature):
    for obj in bpy.context.selected_objects:
        obj.select_set(False)
    armature.select_set(True)
    bpy.context.view_layer.objects.active = armature
    assert active_character(bpy.context) == armature


def table():
    return bpy.context.scene.manient.hand_table


def said():
    return drawn(MANIENT_PT_character).said


def refused(call, match):
    """That an operator fails with that sentence and that neither action nor table is there afterwards."""
    before = len(bpy.data.actions)
    with pytest.raises(RuntimeError, match=f"(?i){match}"):
        call()
    assert len(bpy.data.actions) == before


def apply(**kwargs):
    return bpy.ops.manient.apply_to_character(**kwargs)


def test_what_a_rig_was_taken_for_and_who_moves_it(make_take):
    hands = captured(make_take)
    bpy.context.view_layer.objects.active = None
    assert "Select a character" in said()
    assert drawn(MANIENT_PT_character_bones).said == ""
    select(mixamo())
    assert said().count("Mixamo, for sure") == 2
    for hand in hands.values():
        assert f"Moves as {hand.armature.name}" in said()
    assert drawn(MANIENT_PT_character).grey == []
    character = bpy.context.active_object.manient.character
    character.left.source = hands["right"].armature
    assert f"Moves as {hands['right'].armature.name}, mirrored" in said()


def test_a_hand_that_nobody_captured_and_several_that_were(make_take):
    captured(make_take, ("right",))
    armature = mixamo()
    select(armature)
    assert "No captured left hand is here" in said()
    captured(make_take, ("right",))
    select(armature)
    assert "several captured right hands" in said().lower()
    refused(apply, "several captured right hands")


def test_a_chosen_hand_without_its_take_is_not_replaced_by_another(make_take):
    chosen, _other = captured(make_take, ("left",))["left"].armature, captured(make_take, ("left",))
    armature = mixamo(("left",))
    select(armature)
    armature.manient.character.left.source = chosen
    assert f"Moves as {chosen.name}" in said()
    chosen.manient.capture = None
    assert f"{chosen.name!r}, chosen for the left hand" in drawn(MANIENT_PT_character).loud
    refused(apply, "has no take any more")


def test_a_hand_that_is_lacked_is_an_error_only_where_one_would_move_it(make_take):
    lacked, hands = "No left hand was found", captured(make_take, ("right",))
    armature = mixamo(("right",))
    select(armature)
    assert lacked in said()
    assert drawn(MANIENT_PT_character).loud == ""
    armature.manient.character.left.source = hands["right"].armature
    assert lacked in drawn(MANIENT_PT_character).loud
    armature.manient.character.left.source = None
    captured(make_take, ("left",))
    select(armature)
    assert lacked in drawn(MANIENT_PT_character).loud
    none = build_armature([BoneSpec("root", "", (0, 0, 0), (0, 0, 1))])
    for hand in list(bpy.data.objects):
        if hand not in (armature, none):
            bpy.data.objects.remove(hand)
    select(none)
    assert "No captured left hand" in said()
    assert lacked in drawn(MANIENT_PT_character).loud


@pytest.mark.parametrize("sides", [("left",), ("right",)])
def test_a_character_with_one_hand_gets_its_motion(make_take, sides):
    captured(make_take)
    armature = mixamo(sides)
    select(armature)
    assert f"No {other_side(sides[0])} hand was found" in said()
    assert apply() == {"FINISHED"}
    keyed = {c.data_path.split('"')[1] for c in action_curves(armature.animation_data.action)}
    assert keyed == set(mixamo_names(sides[0]).values()) - {mixamo_names(sides[0])[0]}


def test_a_bone_chosen_in_the_table_is_kept_and_gets_the_motion(make_take):
    captured(make_take)
    armature = mixamo()
    select(armature)
    names = mixamo_names("left")
    table().side = "left"
    assert (table().hand, table().index_1, table().little_3) == (names[0], names[1], names[9])
    assert kept_map(armature, "left") is None
    table().little_3 = ""
    table().thumb_roll = 25.0
    table().keep_rest = True
    kept = kept_map(armature, "left")
    assert kept is not None
    assert kept.bones == (*[names[j] for j in range(9)], "", *[names[j] for j in range(10, 16)])
    assert (kept.thumb_roll, kept.keep_rest, kept.rig) == (25.0, True, "Mixamo")
    assert kept_map(armature, "right") is None
    assert "Mixamo, with your own table" in said()
    apply()
    keyed = {c.data_path.split('"')[1] for c in action_curves(armature.animation_data.action)}
    assert names[9] not in keyed
    assert len(keyed) == 29
    bpy.ops.manient.recognise_hand(side="left")
    assert armature.manient.character.left.hand_map == ""
    assert table().little_3 == names[9]


def test_every_row_is_drawn_and_reads_its_own_bone():
    armature = mixamo()
    select(armature)
    every = {joint: f"joint {joint}" for joint in range(16)}
    shown = HandMap("right", tuple(every.values()), ("a", "b", "c", "d"), "e", "Mixamo", 10.0, True, 0.5)
    keep_map(armature, shown)
    table().side = "right"
    values = [getattr(table(), one.identifier) for one in table().bl_rna.properties]
    assert set(shown.bones) | set(shown.palm) | {"e", 10.0, True, 0.5} <= set(values)
    said = drawn(MANIENT_PT_character_bones).said
    assert all(text in said for text in ("Thumb", "Little", "Metacarpals", "Moved By", "thumb_roll"))


def test_recognising_happens_once_until_bones_change(monkeypatch):
    asked = []
    found_hand = characters.found_hand
    monkeypatch.setattr(characters, "found_hand", lambda *a: asked.append(a[1]) or found_hand(*a))
    armature = mixamo()
    select(armature)
    for _ in range(5):
        drawn(MANIENT_PT_character)
        drawn(MANIENT_PT_character_bones)
    assert sorted(asked) == ["left", "right"]
    armature.data.bones[mixamo_names("left")[1]].name = "other"
    drawn(MANIENT_PT_character)
    assert sorted(asked[2:]) == ["left", "right"]
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones["mixamorig:Hips"].head = (0, 0, 0.5)
    bpy.ops.object.mode_set(mode="OBJECT")
    drawn(MANIENT_PT_character)
    assert len(asked) == 6


@pytest.mark.parametrize(
    "text",
    [
        "{",
        '{"side": "left", "bones": {"wrist": "\\ud800"}}',
        '{"side": "left", "bones": {"wrist": "gone", "index_proximal": "gone\\nalso\\u0000"}}',
        '{"side": "right", "bones": {"wrist": "mixamorig:RightHand"}}',
    ],
)
def test_no_text_that_is_kept_stops_the_panel(make_take, text):
    captured(make_take)
    armature = mixamo()
    select(armature)
    armature.manient.character.left.hand_map = text
    assert "Left Hand" in said()
    assert "hand_map" not in drawn(MANIENT_PT_character_bones).said
    table().side = "left"
    for one in table().bl_rna.properties:
        getattr(table(), one.identifier)
    table_of(armature, "left").to_json().encode()
    bpy.ops.manient.recognise_hand(side="left")
    assert said().count("Mixamo, for sure") == 2


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (lambda _o: bpy.ops.object.mode_set(mode="EDIT"), "Edit Mode"),
        (lambda o: setattr(o, "scale", (-1.0, 1.0, 1.0)), "negative scale"),
        (lambda o: setattr(o.data, "pose_position", "REST"), "rest position"),
    ],
)
def test_what_keeps_a_character_from_motion_is_said_before(make_take, spoil, match):
    captured(make_take)
    armature = mixamo()
    select(armature)
    spoil(armature)
    bpy.context.view_layer.update()
    page = drawn(MANIENT_PT_character)
    assert match in page.said
    assert {"source", "into", "Apply Pose", "live"} & set(page.grey)
    refused(apply, match)
    refused(lambda: bpy.ops.manient.recognise_hand(side="left"), match)
    refused(lambda: bpy.ops.manient.mark_frame(), match)
    table().side = "left"
    table().hand = "nothing"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert armature.manient.character.left.hand_map == ""


def test_no_hand_among_the_bones(make_take):
    captured(make_take)
    armature = build_armature(
        [BoneSpec("root", "", (0, 0, 0), (0, 0, 1)), BoneSpec("tip", "root", (0, 0, 1), (0, 0, 2))]
    )
    select(armature)
    assert "No left hand was found among the 2 bones" in said()
    refused(apply, "no left hand was found")
    refused(lambda: bpy.ops.manient.recognise_hand(side="left"), "no left hand was found")
    refused(lambda: bpy.ops.manient.copy_hand_table(side="left"), "choose it in the table")
    refused(lambda: bpy.ops.manient.save_hand_preset(filepath="/nowhere/x.json"), "choose some")


def test_two_hands_of_one_side(make_take):
    captured(make_take)
    specs = []
    for number in (1, 2):
        names = mixamo_names("left", f"mixamorig{number}:")
        place = AWAY["left"] + [0.0, number, 0.0]
        specs += hand_specs("left", np.random.default_rng(3), names=names, place=place)
    armature = build_armature(specs)
    select(armature)
    assert "There are several left hands here" in said()
    refused(apply, "several left hands")
    chosen = mixamo_names("left", "mixamorig2:")
    keep_map(armature, HandMap("left", tuple(chosen[j] for j in range(16))))
    assert apply() == {"FINISHED"}
    keyed = {c.data_path.split('"')[1] for c in action_curves(armature.animation_data.action)}
    assert keyed == set(chosen.values()) - {chosen[0]}


def test_a_bone_that_is_gone(make_take):
    captured(make_take)
    armature = mixamo()
    select(armature)
    table().side = "left"
    table().index_2 = "no such bone"
    assert "There is no bone no such bone" in said().replace("'", "")
    refused(apply, "no such bone")


def test_bones_that_something_else_turns_are_named_before(make_take):
    captured(make_take)
    armature = mixamo()
    select(armature)
    for joint in (1, 2):
        armature.pose.bones[mixamo_names("left")[joint]].constraints.new("COPY_ROTATION").target = armature
    assert "Copy Rotation: it is left alone, and 1 other bone too" in said()
    apply()
    keyed = {c.data_path.split('"')[1] for c in action_curves(armature.animation_data.action)}
    assert len(keyed) == 28


def test_a_plug_in_that_fails_keeps_no_panel_from_being_drawn(make_take, monkeypatch, capsys):
    captured(make_take)
    select(mixamo())

    class Broken(Character):
        label = "Mixamo"

        @classmethod
        def find(cls, armature, bones, side):  # noqa: ARG003
            return None

        @classmethod
        def troubles(cls, armature, hand_map):  # noqa: ARG003
            raise ZeroDivisionError

    monkeypatch.setattr(rigs, "CHARACTERS", [*rigs.CHARACTERS, Broken])
    assert said().count("Mixamo, for sure") == 2
    assert "failed in Broken (ZeroDivisionError" in capsys.readouterr().err
    assert apply() == {"FINISHED"}


def test_marking_a_frame():
    armature = mixamo()
    select(armature)
    armature.manient.character.wrist = "TURNED"
    assert "Pose the character's hand as it is to be in this frame" in said()
    bpy.context.scene.frame_set(17)
    bpy.ops.manient.mark_frame()
    assert armature.manient.character.reference == 17


def test_the_opposite_bones():
    armature = mixamo()
    select(armature)
    kept = hand_map_of(armature, "left")
    assert opposite(armature, kept).bones == tuple(mixamo_names("right")[j] for j in range(16))
    table().side = "left"
    table().ring_3 = ""
    bpy.ops.manient.copy_hand_table(side="left")
    other = kept_map(armature, "right")
    assert other is not None
    assert other.bones == tuple("" if j == 12 else mixamo_names("right")[j] for j in range(16))


def test_the_opposite_bone_among_several_in_one_place_has_the_likest_name():
    specs = []
    for side in SIDES:
        mark = side[0].upper()
        for layer in ("", "ORG-", "DEF-"):
            names = {j: f"{layer}bone{j}.{mark}" for j in range(16)}
            specs += hand_specs(side, np.random.default_rng(3), names=names, place=AWAY[side])
    armature = build_armature(specs)
    ours = map_of("right", {j: f"DEF-bone{j}.R" for j in range(16)})
    assert opposite(armature, ours) == map_of("left", {j: f"DEF-bone{j}.L" for j in range(16)})


def test_no_bone_lies_opposite():
    armature = build_armature(hand_specs("left", np.random.default_rng(4), place=AWAY["left"]))
    with pytest.raises(HandModelError, match="no bone lies opposite"):
        opposite(armature, map_of("left"))


def test_a_preset_of_both_hands_for_another_character_of_the_kind(tmp_path):
    armature = mixamo()
    select(armature)
    table().side = "left"
    table().thumb_roll = -12.0
    path = tmp_path / "preset.json"
    bpy.ops.manient.save_hand_preset(filepath=str(path))
    assert [one.side for one in from_preset(path.read_text(encoding="utf-8"))] == ["left", "right"]
    other = mixamo(name="Other")
    select(other)
    bpy.ops.manient.load_hand_preset(filepath=str(path))
    for side in SIDES:
        assert kept_map(other, side) == hand_map_of(armature, side)
    third = mixamo(prefix="mixamorig1:", name="Third")
    select(third)
    refused(lambda: bpy.ops.manient.load_hand_preset(filepath=str(path)), "preset.json: there is no bone")
    assert third.manient.character.left.hand_map == ""


def test_a_file_that_is_no_preset(tmp_path):
    armature = mixamo()
    select(armature)
    path = tmp_path / "bad.json"
    path.write_bytes(b"\xff\xfe\x00")
    refused(lambda: bpy.ops.manient.load_hand_preset(filepath=str(path)), "bad.json: ")
    refused(lambda: bpy.ops.manient.load_hand_preset(filepath=str(tmp_path / "gone.json")), "No such file")
    one = json.loads(hand_map_of(armature, "left").to_json())
    path.write_text(json.dumps([one, one]))
    refused(lambda: bpy.ops.manient.load_hand_preset(filepath=str(path)), "one table for a hand")
    assert armature.manient.character.left.hand_map == ""


def linked_character(tmp_path):
    """A character that lies in another file, linked as a collection, and the instance that shows it."""
    armature = mixamo()
    collection = bpy.data.collections.new("Character")
    collection.objects.link(armature)
    path = tmp_path / "character.blend"
    bpy.data.libraries.write(str(path), {collection})
    bpy.data.objects.remove(armature)
    bpy.data.collections.remove(collection)
    with bpy.data.libraries.load(str(path), link=True) as (_, wanted):
        wanted.collections = ["Character"]
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", wanted.collections[0]
    bpy.context.collection.objects.link(instance)
    bpy.context.view_layer.objects.active = instance
    return instance


def test_a_linked_character_asks_for_an_override(make_take, tmp_path):
    captured(make_take)
    linked_character(tmp_path)
    page = drawn(MANIENT_PT_character)
    assert "linked from another file: make a library override" in page.said
    assert "into" in page.grey
    refused(apply, "library override")


@pytest.mark.parametrize("into", ["NEW", "STRIP", "ACTION"])
def test_a_library_override_keeps_motion_and_table(make_take, tmp_path, into):
    captured(make_take)
    linked = linked_character(tmp_path).instance_collection
    bpy.context.scene.collection.children.link(linked)
    linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    (armature,) = (o for o in bpy.data.objects if o.override_library and o.type == "ARMATURE")
    select(armature)
    assert said().count("Mixamo, for sure") == 2
    table().side = "left"
    table().little_3 = ""
    armature.manient.character.into = into
    armature.manient.character.wrist = "TURNED"
    armature.manient.character.reference = 3
    assert apply() == {"FINISHED"}

    def pose():
        bpy.context.scene.frame_set(5)
        shown = bpy.data.objects[armature_name].evaluated_get(bpy.context.evaluated_depsgraph_get())
        return np.array([b.matrix for b in shown.pose.bones])

    armature_name = armature.name
    before, rest = pose(), np.array([b.matrix_local for b in armature.data.bones])
    assert np.abs(before - rest).max() > 0.1
    path = tmp_path / "shot.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.open_mainfile(filepath=str(path))
    np.testing.assert_allclose(pose(), before, atol=1e-5)
    armature = bpy.data.objects[armature_name]
    assert armature.override_library is not None
    kept = kept_map(armature, "left")
    assert kept is not None
    assert kept.bones[9] == ""
    assert armature.manient.character.wrist == "TURNED"


def test_undo_takes_keys_action_and_table_back(make_take):
    captured(make_take)
    armature = mixamo()
    select(armature)
    bpy.context.preferences.edit.use_global_undo = True
    bpy.ops.ed.undo_push(message="before")
    table().side = "left"
    table().little_3 = ""
    bpy.ops.ed.undo_push(message="table")
    apply()
    bpy.ops.ed.undo_push(message="applied")
    bpy.ops.ed.undo()
    armature = bpy.data.objects["Character"]
    assert armature.animation_data is None or armature.animation_data.action is None
    assert not [a for a in bpy.data.actions if a.name.startswith("Character")]
    assert kept_map(armature, "left") is not None
    bpy.ops.ed.undo()
    assert kept_map(bpy.data.objects["Character"], "left") is None
