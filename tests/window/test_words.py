"""What the sidebar says, in the window."""

from __future__ import annotations

import shutil

NAME = "interview with the glove maker, second day, third take, camera B, before the rain, left.jpg"


def test_long_names_and_failures_that_are_over(blender, photo, tmp_path):
    source = shutil.copy(photo, tmp_path / NAME)
    broken = tmp_path / "anna's broken clip.jpg"
    broken.write_bytes(b"no picture")
    played = blender.play("words.long_names", source=source, broken=broken, timeout=240).value
    ((name, state, message),) = played["first"]
    assert (name, state) == ("anna's broken clip.jpg", "failed")
    # The name stands before the sentence, which does not repeat it.
    assert name not in message
    assert message[0].isupper()
    # What failed before is over, now that another capture has succeeded.
    assert played["then"] == [[NAME, "done"]]
    assert not any(name in text for text in played["shown"])
    for end in ("hand", "mesh", "camera"):
        named = played[end]
        assert len(named.encode()) <= 63
        assert "interview with" in named
        assert "left" in named
    assert played["hand"].startswith("right hand of interview with")
    assert played["hand"].endswith("rain, left")
    # In the list of captures and in the hand's block both ends can be read.
    assert any(text.startswith("interview") and "left.jpg" in text for text in played["shown"])
    assert any(text.startswith("right hand") and text.endswith("left") for text in played["shown"])


def test_shapes_have_names(blender, photo):
    shown = blender.play("words.shapes", source=photo, timeout=240).value
    names = [text.partition(": ")[0] for text in shown]  # a value follows
    effects = ("Larger", "Shorter", "Longer", "Thinner", "Narrower", "Shape ")
    sliders = [name for name in names if name.startswith(effects)]
    assert sliders == [
        "Larger Hand",
        "Shorter Thumb",
        "Longer Middle Finger",
        "Longer Ring Finger",
        "Shorter Little Finger",
        "Thinner Hand",
        "Narrower Palm",
        "Shape 2",
        "Shape 8",
        "Shape 10",
    ]
