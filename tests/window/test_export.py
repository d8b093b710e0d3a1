"""Export in the window: nothing that it shows is changed, and formats that are not there are grey."""

from __future__ import annotations


def test_export_leaves_all_as_it_is(blender, photo):
    played = blender.play("exporting.leaves_all_as_it_is", source=str(photo), timeout=600.0).value
    assert {"fbx", "glb", "bvh", "npz", "vrma"} <= set(played["written"])
    for fmt, files in played["written"].items():
        assert len(files) == 1, "nothing else is left beside the file"
        assert played["after"][fmt] == played["before"], fmt
        assert played["pixels"][fmt] == 0, f"{fmt}: so many places of the views look different"
    # The pose that has no keys is not Blender's to bring back.
    assert {**played["undone"], "pose": None} == {**played["before"], "pose": None}


def test_formats_that_this_blender_lacks_are_grey(blender, photo):
    chosen = blender.play("exporting.formats", source=str(photo), timeout=600.0).value
    assert chosen == ["bvh", "fbx", "glb", "npz", "vrma"], "Debian's Blender has neither USD nor Alembic"
