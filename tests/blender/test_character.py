"""The panel Character: what it says of a rig, the table of its bones, and what is refused before anything is
changed."""

from __future__ import annotations

import json

import bpy
import numpy as np
import pytest

from blender_manient.operators.character import opposite
from blender_manient.panels.character import MANIENT_PT_character, MANIENT_PT_character_bones
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import active_character, hand_map_of, keep_map, kept_map
from blender_manient.scene.store import hand_of
from handfit_core.common.errors import HandModelError
from handfit_core.common.skeleton import SIDES, Side
from handfit_core.retarget.hand_map import HandMap
from handfit_core.retarget.saved_rigs import fitting_rig, rigs_folder, saved_rigs
from tests.drawn import drawn

from .characters import BoneSpec, build_armature, hand_specs, map_of, mixamo_names
from .conftest import shown_bones
from .looking import chosen, keyed_bones

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


def captured(make_take, *sides: Side):
    """The armatures of captured hands, by side."""
    built = build_take(make_take(sides=sides or SIDES).take)
    return {hand_of(one.armature).side: one.armature for one in built.hands}


def select(armature):
    chosen(armature)
    assert active_character(bpy.context) == armature
    return armature


def table():
    return bpy.context.scene.manient.hand_table


def said():
    return drawn(MANIENT_PT_character).said


def loud():
    return drawn(MANIENT_PT_character).loud


def refused(call, match):
    """Check that an operator fails with a given sentence and leaves no action behind."""
    before = len(bpy.data.actions)
    with pytest.raises(RuntimeError, match=f"(?i){match}"):
        call()
    assert len(bpy.data.actions) == before


def apply():
    return bpy.ops.manient.apply_to_character()


def test_what_a_rig_was_taken_for_and_who_moves_it(make_take):
    hands = captured(make_take)
    bpy.context.view_layer.objects.active = None
    assert said() == ""
    assert drawn(MANIENT_PT_character_bones).said == ""
    character = select(mixamo()).manient.character
    assert said().count("Mixamo, for sure") == 2
    for hand in hands.values():
        assert f"Moves as {hand.name}" in said()
    assert drawn(MANIENT_PT_character).grey == []
    character.left.source = hands["right"]
    assert f"Moves as {hands['right'].name}, mirrored" in said()
    for joint, name in mixamo_names("left").items():
        character.id_data.data.bones[name].name = f"b{joint}"
    assert "By its structure, likely: look at Bones below" in said()


def test_none_several_or_the_chosen_captured_hand(make_take):
    first = captured(make_take, "right")["right"]
    armature = select(mixamo())
    assert "No captured left hand is here" in said()
    captured(make_take, "right")
    select(armature)
    assert "several captured right hands" in said().lower()
    refused(apply, "several captured right hands")
    armature.manient.character.right.source = first
    assert f"Moves as {first.name}" in said()
    first.manient.capture = None
    assert f"{first.name!r}, chosen for the right hand" in loud()
    refused(apply, "has no take any more")


def test_a_bone_chosen_in_the_table_is_kept_and_gets_the_motion(make_take):
    captured(make_take)
    armature, names = select(mixamo()), mixamo_names("left")
    table().side = "left"
    assert (table().hand, table().index_1, table().little_3) == (names[0], names[1], names[9])
    assert kept_map(armature, "left") is None
    table().little_3, table().thumb_roll, table().keep_rest = "", 25.0, True
    kept = kept_map(armature, "left")
    assert kept.bones == (*[names[j] for j in range(9)], "", *[names[j] for j in range(10, 16)])
    assert (kept.thumb_roll, kept.keep_rest, kept.rig) == (25.0, True, "Mixamo")
    assert kept_map(armature, "right") is None
    assert "Mixamo, with your own table" in said()
    apply()
    assert names[9] not in keyed_bones(armature)
    assert len(keyed_bones(armature)) == 29
    table().index_2 = "no such bone"
    assert "There is no bone no such bone" in said().replace("'", "")
    refused(apply, "no such bone")
    bpy.ops.manient.recognise_hand(side="left")
    assert armature.manient.character.left.hand_map == ""
    assert table().little_3 == names[9]


@pytest.mark.parametrize("text", ["{", '{"side": "left", "bones": {"wrist": "\\ud800"}}'])
def test_every_row_is_drawn_also_of_a_damaged_table(make_take, text):
    captured(make_take)
    armature = select(mixamo())
    every = tuple(f"joint {joint}" for joint in range(16))
    kept = HandMap("right", every, ("a", "b", "c", "d"), "e", "Mixamo", 10.0, True, 0.5)
    keep_map(armature, kept)
    armature.manient.character.left.hand_map = text
    table().side = "right"
    values = [getattr(table(), one.identifier) for one in table().bl_rna.properties]
    assert {*every, *kept.palm, "e", 10.0, True, 0.5} <= {*values}
    rows = drawn(MANIENT_PT_character_bones).said
    assert all(text in rows for text in ("Thumb", "Little", "Metacarpals", "Moved By", "thumb_roll"))
    assert "The kept table of this hand is damaged" in said()
    table().side = "left"
    assert table().index_1 == mixamo_names("left")[1]


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
    armature = select(mixamo())
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
    select(build_armature([BoneSpec("root", "", (0, 0, 0), (0, 0, 1))]))
    assert "No left hand was found among the 1 bones" in said()
    refused(apply, "no left hand was found")
    refused(lambda: bpy.ops.manient.recognise_hand(side="left"), "no left hand was found")
    refused(lambda: bpy.ops.manient.copy_hand_table(side="left"), "choose it in the table")
    refused(lambda: bpy.ops.manient.export_rig(filepath="/nowhere/x.json"), "choose some")
    refused(lambda: bpy.ops.manient.save_rig(rig_name="Mine"), "choose some")


def test_two_hands_of_one_side(make_take):
    captured(make_take)
    specs = []
    for number in (1, 2):
        ours = mixamo_names("left", f"mixamorig{number}:")
        place = AWAY["left"] + [0.0, number, 0.0]
        specs += hand_specs("left", np.random.default_rng(3), names=ours, place=place)
    armature = select(build_armature(specs))
    assert "There are several left hands here" in said()
    refused(apply, "several left hands")
    keep_map(armature, HandMap("left", tuple(ours[j] for j in range(16))))
    assert apply() == {"FINISHED"}
    assert keyed_bones(armature) == {*ours.values()} - {ours[0]}
    bpy.ops.manient.save_rig(rig_name="The second")
    armature.manient.character.left.hand_map = ""
    assert "The second, your rig" in said()
    assert "several left hands" not in said().lower()
    assert hand_map_of(armature, "left").bones[0] == ours[0]


def test_bones_that_something_else_turns_are_named_before(make_take):
    captured(make_take)
    armature = select(mixamo())
    for joint in (1, 2):
        armature.pose.bones[mixamo_names("left")[joint]].constraints.new("COPY_ROTATION").target = armature
    assert "Copy Rotation: it is left alone, and 1 other bone too" in said()
    apply()
    assert len(keyed_bones(armature)) == 28


def test_the_opposite_bones():
    armature = select(mixamo())
    table().side = "left"
    table().ring_3 = ""
    bpy.ops.manient.copy_hand_table(side="left")
    wanted = tuple("" if j == 12 else mixamo_names("right")[j] for j in range(16))
    assert kept_map(armature, "right").bones == wanted


def test_of_several_opposite_bones_the_likest_name_wins():
    specs = []
    for side in SIDES:
        for layer in ("", "ORG-", "DEF-"):
            names = {j: f"{layer}bone{j}.{side[0].upper()}" for j in range(16)}
            specs += hand_specs(side, np.random.default_rng(3), names=names, place=AWAY[side])
    ours = map_of("right", {j: f"DEF-bone{j}.R" for j in range(16)})
    expected = map_of("left", {j: f"DEF-bone{j}.L" for j in range(16)})
    assert opposite(build_armature(specs), ours) == expected
    alone = build_armature(hand_specs("left", np.random.default_rng(4), place=AWAY["left"]))
    with pytest.raises(HandModelError, match="no bone lies opposite"):
        opposite(alone, map_of("left"))


def test_a_rig_is_taught_once(make_take):
    """What is set in the table counts for every later file with these bones, and for no other."""
    captured(make_take)
    select(mixamo())
    table().side, table().thumb_roll, table().little_3 = "left", -12.0, ""
    taught = hand_map_of(active_character(bpy.context), "left")
    bpy.ops.manient.save_rig(rig_name="Our Hero")
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    captured(make_take)
    armature = select(mixamo(name="Later"))
    assert said().count("Our Hero, your rig") == 2
    assert kept_map(armature, "left") is None
    assert hand_map_of(armature, "left") == taught
    apply()
    assert taught.rig == "Mixamo"
    assert len(keyed_bones(armature)) == 29
    table().side, table().thumb_roll = "left", 5.0
    assert "Mixamo, with your own table" in said()
    bpy.ops.manient.recognise_hand(side="left")
    assert hand_map_of(armature, "left").mapped[9] == mixamo_names("left")[9]
    other = select(mixamo(prefix="mixamorig1:", name="Other"))
    assert "your rig" not in said()
    assert hand_map_of(other, "left").thumb_roll != -12.0
    select(mixamo(name="Third"))
    bpy.ops.manient.forget_rig(rig_name="Our Hero")
    assert said().count("Mixamo, for sure") == 2
    refused(lambda: bpy.ops.manient.forget_rig(rig_name="Our Hero"), "there is no saved rig")
    refused(lambda: bpy.ops.manient.save_rig(rig_name="../hero"), "give the rig a name")


def test_a_rig_that_cannot_be_read_or_written_is_named(make_take):
    captured(make_take)
    select(mixamo())
    folder = rigs_folder()
    folder.mkdir(parents=True)
    (folder / "bad.json").write_text("{")
    assert "This saved rig is left out" in drawn(MANIENT_PT_character_bones).loud
    assert said().count("Mixamo, for sure") == 2
    (folder / "bad.json").unlink()
    assert drawn(MANIENT_PT_character_bones).loud == ""
    folder.rmdir()
    folder.write_text("a file where the folder should be")
    assert "cannot be" in drawn(MANIENT_PT_character_bones).loud
    refused(lambda: bpy.ops.manient.save_rig(rig_name="Mine"), "cannot write here")


def test_rigs_are_exported_and_imported(tmp_path):
    armature, path = select(mixamo()), tmp_path / "hero.json"
    table().side = "left"
    table().thumb_roll = -12.0
    bpy.ops.manient.export_rig(filepath=str(path))
    assert saved_rigs()[0] == {}
    other = select(mixamo(name="Other"))
    bpy.ops.manient.import_rig(filepath=str(path))
    for side in SIDES:
        assert kept_map(other, side) == hand_map_of(armature, side)
    assert fitting_rig(armature.data.bones.keys(), "left").name == "hero"
    third = select(mixamo(prefix="mixamorig1:", name="Third"))
    bpy.ops.manient.import_rig(filepath=str(path))
    assert third.manient.character.left.hand_map == ""
    one = json.loads(hand_map_of(armature, "left").to_json())
    for content, why in (
        (json.dumps([{**one, "fold": 0.5}]).encode(), "with other bones: forget it first"),
        (b"\xff\xfe\x00", "hero.json: "),
        (json.dumps([one, one]).encode(), "one table for a hand"),
        (json.dumps([{**one, "bones": {}}]).encode(), "no bone stands for the left hand"),
    ):
        path.write_bytes(content)
        refused(lambda: bpy.ops.manient.import_rig(filepath=str(path)), why)
    path.unlink()
    refused(lambda: bpy.ops.manient.import_rig(filepath=str(path)), "No such file")
    assert saved_rigs()[0]["hero"].of("left").thumb_roll == -12.0


@pytest.mark.parametrize("into", ["NEW", "STRIP", "ACTION"])
def test_a_linked_character_needs_an_override_which_keeps_motion_and_table(make_take, tmp_path, into):
    captured(make_take)
    armature, path = mixamo(), str(tmp_path / "character.blend")
    collection = bpy.data.collections.new("Character")
    collection.objects.link(armature)
    bpy.data.libraries.write(path, {collection})
    bpy.data.batch_remove([armature, collection])
    with bpy.data.libraries.load(path, link=True) as (_, wanted):
        wanted.collections = ["Character"]
    (linked,) = wanted.collections
    instance = bpy.data.objects.new("Instance", None)
    instance.instance_type, instance.instance_collection = "COLLECTION", linked
    bpy.context.collection.objects.link(instance)
    bpy.context.view_layer.objects.active = instance
    assert "linked from another file: make a library override" in said()
    assert "into" in drawn(MANIENT_PT_character).grey
    refused(apply, "library override")

    bpy.context.scene.collection.children.link(linked)
    linked.override_hierarchy_create(bpy.context.scene, bpy.context.view_layer, do_fully_editable=True)
    (armature,) = (o for o in bpy.data.objects if o.override_library and o.type == "ARMATURE")
    character, name = select(armature).manient.character, armature.name
    table().side, table().little_3 = "left", ""
    character.into, character.wrist, character.reference = into, "TURNED", 3
    assert apply() == {"FINISHED"}

    def pose():
        return np.array([b.matrix for b in shown_bones(bpy.data.objects[name], 5)])

    before, rest = pose(), np.array([b.matrix_local for b in armature.data.bones])
    assert np.abs(before - rest).max() > 0.1
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    np.testing.assert_allclose(pose(), before, atol=1e-5)
    assert kept_map(bpy.data.objects[name], "left").bones[9] == ""
    assert bpy.data.objects[name].manient.character.wrist == "TURNED"
