"""Find Hands: choosing hands over the picture with the mouse."""

from __future__ import annotations

import bpy
import numpy as np

from scenarios.capturing import done, finish, hands, jobs, part, summary

HER_LEFT_HAND = (60, 885, 200, 135)
"""x, y, width and height in pixels of samples/mona_lisa"""
FOUND = 120.0
"""seconds that a cold worker may take to find the hands of a picture"""
NOWHERE = (2.0, 2.0, 40.0, 40.0)
"""A box without a hand"""


def chosen(stage, source):
    """Of four hands one is left out, one gets another side, and one is thrown out, which is taken back;
    thrown out again, it is found in a box. A box about a hand that is there, and an empty one, change nothing
    and say so. Then what is chosen is captured."""
    yield from stage.open_sidebar()
    yield from begun(stage, source)
    first, second, third, fourth = (hand.side for hand in mode().choice.hands)
    assert sorted([first, second, third, fourth]) == ["left", "left", "right", "right"]
    turned = {"left": "right", "right": "left"}[second]
    objects, images = len(bpy.data.objects), len(bpy.data.images)
    yield from stage.click(over(mode().choice.hands[0]))
    yield from stage.click(tag_of(mode().choice.hands[1]))
    dropped = mode().choice.hands[2].points
    yield from stage.move_to(over(mode().choice.hands[2]))
    yield from stage.key("X")
    yield 0.1
    rest = [(first, False), (turned, True), (fourth, True)]
    assert described() == rest
    yield from stage.key("Z", ctrl=True)
    yield 0.1
    assert described() == [*rest[:2], (third, True), rest[2]]
    yield from stage.key("X")
    yield 0.1
    low, size = dropped.min(axis=0) - 20, np.ptp(dropped, axis=0) + 40
    yield from boxed_around(stage, (*low, *size))
    assert described() == [*rest, (third, True)]
    yield from boxed_around(stage, (*low - 5, *size + 10), "find-again")
    assert mode().status_line()[0].startswith("The box shows no other hand")
    assert described() == [*rest, (third, True)]
    yield from boxed_around(stage, NOWHERE)
    assert mode().status_line()[0].startswith("No hand was found in the box")
    assert (len(bpy.data.objects), len(bpy.data.images)) == (objects, images), "nothing is built yet"
    yield from captured(stage)
    assert sorted(hand["side"] for hand in summary()) == sorted([turned, third, fourth])


def added(stage, source):
    """Esc leaves. A box with nothing in it, and the button that is offered then: the chosen hand is captured,
    and another one can be laid into its picture."""
    yield from stage.open_sidebar()
    yield from begun(stage, source)
    yield from stage.key("ESC")
    yield from stage.until(lambda: mode() is None, 5.0, "the mode to end")
    assert not jobs()
    yield from begun(stage, source)
    yield from boxed_around(stage, NOWHERE)
    (place,) = [_middle_of(button) for button in mode().buttons(viewport()) if button.name == "add"]
    yield from stage.click(place)
    yield from _finished(stage)
    assert [hand["side"] for hand in summary()] == ["right"]
    adding = part("operators.add_hand").MANIENT_OT_add_hand
    yield from stage.until(lambda: adding.current is not None, 10.0, "the mode in which a hand is added")
    yield from stage.move_to(stage.region())
    yield from stage.key("ESC")
    yield from stage.until(lambda: adding.current is None, 5.0, "the mode to end")


def captured(stage):
    """Enter, and wait for the hands."""
    yield from stage.move_to(stage.region())
    yield from stage.key("RET")
    yield from _finished(stage)


def _finished(stage):
    (job,) = yield from stage.until(jobs, 10.0, "the capture of what was chosen")
    yield from finish(stage, job)
    done(job)
    assert mode() is None
    assert hands()


def begun(stage, source):
    """Press Find Hands, and wait for the picture and its hands."""
    bpy.context.scene.manient.source = source
    yield 0.5
    yield from stage.invoke("manient.find_hands")
    there = lambda: mode() is not None and mode().picture_view is not None and not mode().busy  # noqa: E731
    yield from stage.until(there, FOUND, "the hands of the picture")
    assert not mode().message, mode().message
    yield 0.3


def mode():
    return part("operators.find_hands").MANIENT_OT_find_hands.current


def viewport():
    return part("operators.modes.view").viewport_at(bpy.context, mode().address)


def described() -> list[tuple[str, bool]]:
    """Side of every hand, and whether it is chosen."""
    return [(hand.side, hand.chosen) for hand in mode().choice.hands]


def in_window(place) -> tuple[float, float]:
    """Pixels of the picture -> of the window."""
    there = viewport()
    matrix = mode().picture_view.matrix(mode().room(there))
    x, y, w = matrix @ [*place, 1.0]
    return float(x / w + there.region.x), float(y / w + there.region.y)


def over(hand) -> tuple[float, float]:
    """The middle of a hand's palm, in pixels of the window."""
    return in_window(hand.points[9])


def tag_of(hand) -> tuple[float, float]:
    """The middle of the tag with a hand's side, in pixels of the window."""
    (button,) = [button for button in mode().buttons(viewport()) if button.hand is hand]
    return _middle_of(button)


def _middle_of(button) -> tuple[float, float]:
    region, (left, bottom, right, top) = viewport().region, button.box
    return (left + right) / 2 + region.x, (bottom + top) / 2 + region.y


def boxed_around(stage, box, shot=""):
    """Drag a box (x, y, width, height) over the picture, and wait until the worker has looked into it."""
    path = [np.add(box[:2], np.multiply(box[2:], t)) for t in (0.0, 0.3, 0.6, 1.0)]
    yield from stage.move_to(stage.region())
    yield from stage.drag([in_window(place) for place in path], pause=0.05)
    if shot:
        yield 0.05
        stage.screenshot_now(shot)
    yield from stage.until(lambda: not mode().busy, FOUND, "a look into a box")
    yield 0.2
