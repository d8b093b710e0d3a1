"""Find Hands: choosing hands over the picture with the mouse."""

from __future__ import annotations

import bpy
import numpy as np

from scenarios.capturing import done, finish, hands, jobs, part, summary

HER_LEFT_HAND = (60, 885, 200, 135)
"""x, y, width and height in pixels of samples/mona_lisa"""
FOUND = 120.0
"""seconds that a cold worker may take to find the hands of a picture"""


def chosen(stage, source):
    """One hand is left out, one gets another side, one is thrown out and that taken back. Then what is chosen
    is captured."""
    yield from stage.open_sidebar()
    yield from begun(stage, source)
    yield from stage.screenshot("find-begun")
    before = [hand.side for hand in mode().choice.hands]
    objects, images = len(bpy.data.objects), len(bpy.data.images)

    first, second, third, _ = mode().choice.hands
    yield from stage.click(over(first))
    yield from stage.move_to(tag_of(second))
    yield from stage.screenshot("find-side-hovered")
    yield from stage.click(tag_of(second))
    yield from stage.move_to(over(third))
    yield from stage.screenshot("find-hovered")
    yield from stage.key("X")
    yield 0.1
    dropped = len(mode().choice.hands)
    yield from stage.key("Z", ctrl=True)
    yield 0.1
    answer = {"before": before, "dropped": dropped, "now": described()}
    yield from boxed(stage, (2.0, 2.0), (40.0, 40.0))
    answer["nothing"] = mode().status_line()[0]
    yield from stage.screenshot("find-nothing")
    answer["untouched"] = [len(bpy.data.objects) - objects, len(bpy.data.images) - images]
    return {**answer, **(yield from captured(stage, "find-captured"))}


def boxed_hand(stage, source):
    """At a threshold that no hand reaches, one is found in a box that is dragged around it, and captured."""
    yield from stage.open_sidebar()
    bpy.context.scene.manient.threshold = 1.0
    yield from begun(stage, source)
    answer = {"found": described(), "line": mode().status_line()[0]}
    yield from boxed_around(stage, HER_LEFT_HAND, shot="find-box")
    answer["with_box"] = described()
    return {**answer, **(yield from captured(stage, "find-box-captured"))}


def captured(stage, shot):
    """Enter, and wait for the hands."""
    yield from stage.move_to(stage.region())
    yield from stage.key("RET")
    (job,) = yield from stage.until(jobs, 10.0, "the capture of what was chosen")
    yield from finish(stage, job, timeout=180.0)
    done(job)
    yield from stage.screenshot(shot)
    left = part("operators.modes.find_hands").current is None
    return {"built": sorted(armature.manient.side for armature in hands()), "left": left}


def added(stage, source):
    """A box with nothing in it, and the button that is offered then: the chosen hand is captured, and another
    one can be laid into its picture."""
    yield from stage.open_sidebar()
    yield from begun(stage, source)
    yield from boxed(stage, (2.0, 2.0), (60.0, 60.0))
    there = viewport()
    (box,) = [b.box for b in mode().buttons(there) if b.name == "add"]
    place = (box[0] + box[2]) / 2 + there.region.x, (box[1] + box[3]) / 2 + there.region.y
    yield from stage.move_to(place)
    yield from stage.screenshot("find-add-offered")
    yield from stage.key("LEFTMOUSE")
    (job,) = yield from stage.until(jobs, 10.0, "the capture of what was chosen")
    yield from finish(stage, job, timeout=180.0)
    done(job)
    adding = part("operators.add_hand")
    yield from stage.until(lambda: adding._mode is not None, 10.0, "the mode in which a hand is added")
    yield from stage.screenshot("find-add-begun")
    yield from stage.move_to(stage.region())
    yield from stage.key("ESC")
    yield from stage.until(lambda: adding._mode is None, 5.0, "the mode to end")
    return [armature.manient.side for armature in hands()]


def crowded(stage, source, most):
    """A photo with more than `most` hands, which are not built before somebody has chosen."""
    for module in ("session.jobs", "operators.modes.choice"):
        part(module).CROWD = most
    try:
        yield from stage.open_sidebar()
        bpy.context.scene.manient.source = source
        yield from stage.invoke("manient.capture")
        (job,) = yield from stage.until(jobs, 10.0, "the capture")
        yield from finish(stage, job, timeout=FOUND)
        yield from found(stage)
        yield from stage.screenshot("find-crowd")
        answer = {"state": job.state, "message": job.message, "built": len(hands()), "shown": described()}
        place = yield from stage.find_button("bpy.ops.manient.capture_found(")
        yield from stage.click(place)
        yield from stage.until(lambda: len(jobs()) == 2, 10.0, "the second capture")
        yield from finish(stage, *jobs(), timeout=180.0)
        return {**answer, "then": len(hands())}
    finally:
        for module in ("session.jobs", "operators.modes.choice"):
            part(module).CROWD = 10


def of_a_frame(stage, source, frame):
    """The scene's frame of a clip; zoomed in and out, and left by Esc. Then its hand is turned and the clip
    captured."""
    yield from stage.open_sidebar()
    bpy.context.scene.manient.source = source
    bpy.context.scene.frame_set(frame)
    yield 1.0
    yield from begun(stage, source)
    shown = mode().source.frame
    yield from stage.screenshot("find-clip")
    (hand,) = mode().choice.hands
    place = over(hand)
    yield from stage.move_to(place)
    for _ in range(6):
        yield from stage.key("WHEELUPMOUSE")
    yield 0.2
    yield from stage.screenshot("find-zoomed")
    zoomed = float(np.abs(np.subtract(over(hand), place)).max())
    yield from stage.key("HOME")
    yield from stage.key("ESC")
    yield from stage.until(lambda: part("operators.modes.find_hands").current is None, 5.0, "the mode to end")
    answer = {"frame": shown, "zoomed": zoomed, "jobs": len(jobs())}
    yield from begun(stage, source)
    yield from stage.move_to(over(mode().choice.hands[0]))
    yield from stage.key("S")
    answer |= yield from captured(stage, "find-clip-captured")
    return {**answer, "hands": summary()}


def begun(stage, source):
    """Press Find Hands, and wait for the hands."""
    bpy.context.scene.manient.source = source
    yield 0.5
    yield from stage.invoke("manient.find_hands")
    yield from stage.until(
        lambda: mode() is not None and mode().picture_view is not None, FOUND, "the picture"
    )
    stage.screenshot_now("find-waiting")
    yield from found(stage)


def found(stage):
    """Wait for the hands of the picture."""
    yield from stage.until(lambda: mode() is not None and not mode().busy, FOUND, "the hands of the picture")
    assert not mode().message, mode().message
    yield 0.3


def mode():
    return part("operators.modes.find_hands").current


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
    there = viewport()
    (box,) = [b.box for b in mode().buttons(there) if b.hand is hand]
    return (box[0] + box[2]) / 2 + there.region.x, (box[1] + box[3]) / 2 + there.region.y


def boxed_around(stage, box, shot=""):
    """Drag a box (x, y, width, height) of the picture."""
    yield from boxed(stage, box[:2], np.add(box[:2], box[2:]), shot)


def boxed(stage, start, stop, shot=""):
    """Drag a box over the picture, and wait until the worker has looked into it."""
    path = [np.add(start, np.subtract(stop, start) * t) for t in (0.0, 0.3, 0.6, 1.0)]
    yield from stage.move_to(stage.region())
    yield from stage.drag([in_window(place) for place in path], pause=0.05)
    if shot:
        yield 0.05
        stage.screenshot_now(shot)
    yield from stage.until(lambda: not mode().busy, FOUND, "a look into a box")
    yield 0.2
    if shot:
        yield from stage.screenshot(f"{shot}-found")
