"""Live: hands of the scene follow a camera, and what is recorded becomes takes (`live_takes.py`).

A worker of its own opens the source and follows the hands, so that captures go on beside it in the shared
one. Poses are shown without keys.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Generator, Sequence
from dataclasses import replace
from typing import Any

import bpy
import numpy as np

from handfit_core.capturing.options import CaptureOptions, LiveOptions
from handfit_core.common.arrays import unpack
from handfit_core.common.errors import Cancelled, HandfitError, OptionError
from handfit_core.common.skeleton import Side
from handfit_core.common.slices import run_to_completion, slice_clock
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.motion import HandMotion
from handfit_core.worker.events import Event

from ..common.block_reference import BlockReference
from ..common.wording import capitalised, counted
from ..scene.apply import apply_pose
from ..scene.build import ChangeWatch
from ..scene.characters import hand_map_of
from ..scene.live_hands import (
    AsSource,
    CharacterHand,
    Followed,
    LiveHand,
    OpenHand,
    Target,
    remove_leftovers,
)
from ..scene.onto_character import Anchor, applying
from ..scene.store import hand_of
from ..scene.timing import frame_rate
from . import shared_worker
from .live_takes import LiveTake, live_transfer, new_take, takes

PICTURE_WIDTH = 320
"""The width in pixels of the small picture"""
_ENDING_SECONDS = 3.0
"""Seconds that the worker gets to end by itself, a recording's last frames included"""
_SAID_SECONDS = 6.0
"""Seconds for which a sentence is shown while poses come"""
_REFUSED_SECONDS = 2.0
"""Seconds after which a frame that came is recorded, unless the worker cannot"""
_MEASURED = 60
"""How many events the latency is measured over: two seconds of them"""


class LiveSession:
    """Hands that follow a source, from Start to Stop."""

    def __init__(self, scene: bpy.types.Scene, options: CaptureOptions, followed: Followed) -> None:
        """Start a worker, which opens the source. Raises HandfitError."""
        self.scene, self.options, self.followed = BlockReference.of("scenes", scene), options, followed
        wanted = scene.manient.live
        for side in followed:
            kept_model(str(options.model), side)  # now, rather than when the first hand is seen
        self.worker = shared_worker.new_worker()
        live = LiveOptions(online=bpy.app.online_access, size=wanted.size, fps=wanted.fps, loop=True)
        self._asking = shared_worker.ask(
            "live",
            "Live",
            self.worker,
            source=wanted.source,
            options=options.to_message(),
            live=live.to_message(),
            picture=PICTURE_WIDTH,
            mirror=wanted.mirror,
        )
        self._progress = next(self._asking)
        self._watch = ChangeWatch()
        self._hands: dict[Side, LiveHand] = {}
        self._newest: dict[Side, HandMotion] = {}
        self.hand_states: dict[Side, str] = {}
        """`seen`, `held` or `resting`, by the side of the person's hand"""
        self._sequence = 0
        self._latencies: list[float] = []
        self._ending_until: float | None = None
        self._record_at: float | None = None
        self._anchors: dict[Target, Anchor] = {}
        self._recording: LiveTake | None = None
        self._recording_since = 0.0
        self._taken: list[LiveTake] = []
        self._previewing: Generator[None, None, None] | None = None
        self._closed = False
        self.recorded: list[LiveTake] = []
        """Recordings that are over and wait to be captured"""
        self._said = 0.0
        self.message = "Starting"
        """A sentence for the panel; empty where there is nothing to say"""
        self.error: HandfitError | None = None
        self.fps, self.dropped = 0.0, 0

    @property
    def over(self) -> bool:
        """True if the worker has ended, and nothing is left to be done."""
        return self._closed and self._previewing is None

    @property
    def _settings(self) -> Any:
        """Return the panel's settings that can be changed while the session runs."""
        return (self.scene.find() or bpy.context.scene).manient.live

    @property
    def _follows(self) -> bool:
        return self._ending_until is None and not self._closed

    # What the panel shows

    @property
    def is_recording(self) -> bool:
        """True if the session records, or counts down to that."""
        return self._recording is not None or self._record_at is not None

    @property
    def latency(self) -> float:
        """Return the median time in milliseconds from a frame's coming to its pose in the scene; 0 while
        unknown."""
        return float(np.median(self._latencies)) if self._latencies else 0.0

    def status(self) -> str:
        """Return the present step in words, and its speed."""
        if self._record_at is not None:
            return f"Recording in {max(1, int(np.ceil(self._record_at - time.monotonic())))}"
        if self._recording is not None:
            return f"Recording take {self._recording.number}: {self._recording.seconds:.1f} s"
        if not self._sequence:
            return "Starting"
        return f"{self.fps:.0f} fps, {self.latency:.0f} ms, {counted(self.dropped, 'frame')} dropped"

    @property
    def has_set_aside(self) -> bool:
        """True if takes are hidden, since hands that follow stand where they do."""
        return bool(self._hands) and any(c.hide_viewport for take in self._taken for c in take.collections)

    # What the artist does

    def toggle_recording(self) -> None:
        """Begin a recording, after the countdown, or end it. Raises OutputError."""
        if self._record_at is not None:
            self._record_at = None
        elif self._recording is not None:
            self._end_recording()
        elif self._follows:
            self._record_at = time.monotonic() + self._settings.countdown

    def calibrate(self) -> None:
        """Have the worker look at an open hand for a second."""
        self._tell("live-calibrate")
        self._say("hold your open hand still, its palm to the camera")

    def snapshot(self) -> None:
        """Key what is shown now at the scene's frame: on the characters that follow, else on the active
        captured hand. Raises HandfitError."""
        context = bpy.context
        frame = float(context.scene.frame_current)
        if not self._newest:
            raise OptionError("no hand was seen yet: hold it before the camera")
        for side, motion in self._newest.items():
            target = self.followed[side]
            if target is None:
                active = context.active_object
                hand = hand_of(active) if active is not None and active.visible_get() else None
                if hand is None:
                    raise OptionError(
                        "select the captured hand that gets the pose, or choose a character in Live"
                    )
                if hand.side == side or len(self._newest) == 1:
                    apply_pose(hand.armature, motion, frame)
            elif (armature := target[0].find()) is not None:
                moved = AsSource(str(self.options.model), motion).motion(motion, np.array([frame]))
                how = live_transfer(armature, target[0], [target[1]], self._anchors, "ACTION")
                run_to_completion(applying(armature, [(hand_map_of(armature, target[1]), moved)], how))

    def stop(self, why: str = "") -> None:
        """End the session: the scene is as before at once, the worker ends within the next steps."""
        if self._follows:
            self._record_at = None
            if self._recording is not None:
                self._end_recording()
            self.hide()
            self.message = why
            self._ending_until = time.monotonic() + _ENDING_SECONDS
            self.worker.cancel(self._progress.request)

    def abandon(self) -> None:
        """End the session and its process now."""
        self._closed, self._previewing = True, None
        self.hide()
        self.worker.stop()

    # Every few milliseconds

    def step(self) -> bool:
        """Take in what the worker says, and show the newest pose. Return whether anything changed."""
        if self._closed:
            return self._preview()
        if self._watch.changed:
            self.stop("Live has ended, since the scene was undone or replaced")
        newest = self._listen()
        try:
            if self._follows and newest is not None and newest["sequence"] > self._sequence:
                self._show(newest)
            if self._follows and self._record_at is not None and time.monotonic() >= self._record_at:
                self._record_at = None
                self._begin_recording()
        except (HandfitError, ReferenceError) as error:
            self.error = error if isinstance(error, HandfitError) else OptionError(str(error))
            self.stop()
        if self._ending_until is not None and not self._closed and time.monotonic() > self._ending_until:
            self._close()
        return self._preview() or bool(self._progress.news) or self._closed

    def _listen(self) -> Event | None:
        """Take in what the worker says; return the event with the newest pose, or None."""
        newest, before = None, self._progress
        try:
            self._progress = next(self._asking)
        except StopIteration as stop:
            if stop.value["recording"] is not None:
                self._recorded(stop.value["recording"])
            if self._ending_until is None:
                self.message = "The source is over"
            self._close()
        except HandfitError as error:
            self.error = None if isinstance(error, Cancelled) else error
            self._close()
        else:
            for warning in self._progress.warnings[len(before.warnings) :]:
                self._say(warning)
            for event in self._progress.news:
                if event["event"] == "live":
                    newest = event
                elif event["event"] == "calibrated":
                    self._calibrated(event["hands"])
                elif event["event"] == "recorded":
                    self._recorded(event)
        return newest

    def _tell(self, kind: str, **fields: Any) -> None:
        self.worker.tell(self._progress.request, kind, **fields)

    def show_again(self) -> None:
        """Put the hands back where they were shown last: a change of the frame shows keys."""
        if self._follows:
            for side, hand in self._hands.items():
                with contextlib.suppress(HandfitError):  # the next step says so
                    hand.show(self._newest[side])

    def hide(self) -> None:
        """Leave the scene as it was before until the next pose comes."""
        for hand in self._hands.values():
            hand.take_away()
        self._hands.clear()
        for take in self._taken:
            take.set_aside(False)

    def _preview(self) -> bool:
        """Do one slice of the last recording's preview. Return whether there was anything to do."""
        if self._previewing is None:
            return False
        is_over = slice_clock()
        try:
            while not is_over():
                next(self._previewing)
        except StopIteration:
            self._previewing = None
        return True

    def _say(self, sentence: str) -> None:
        self.message, self._said = capitalised(sentence), time.monotonic()

    def _show(self, event: Event) -> None:
        if not self._sequence or time.monotonic() - self._said > _SAID_SECONDS:
            self.message = ""
        self._sequence, self.fps, self.dropped = event["sequence"], event["fps"], event["dropped"]
        made = False
        for told in event["hands"]:
            side, motion = told["side"], _motion(told)
            if side not in self._hands:
                if made or told["state"] == "resting":
                    continue  # one at a time takes long enough; or none was seen yet
                self._hands[side], made = self._made(side, motion), True
            self._hands[side].show(motion)
            self._newest[side], self.hand_states[side] = motion, told["state"]
        for take in self._taken if self._hands else ():
            take.set_aside(True)
        self._latencies = [*self._latencies[1 - _MEASURED :], 1000.0 * (time.perf_counter() - event["time"])]
        if self._recording is not None and event["recorded"] is not None:
            if not self._recording.poses:
                self._recording.frame = max(self._recording.frame, _frame_at(event["time"]))
            self._recording.poses.append((event["time"], dict(self._newest)))
            self._recording.seconds = event["time"] - self._recording.poses[0][0]
        elif self._recording is not None and event["time"] > self._recording_since + _REFUSED_SECONDS:
            self._recording = None  # a warning has said why
            self._play(False)
        if event["picture"] is not None:
            pictures.show(unpack(event["picture"]))

    def _made(self, side: Side, motion: HandMotion) -> LiveHand:
        scene, target = self.scene.find(), self.followed[side]
        if scene is None:
            raise OptionError("the scene that Live was started in was deleted")
        if target is None:
            return OpenHand(scene, str(self.options.model), side, motion.betas)
        made = CharacterHand(target, str(self.options.model), motion, self._anchors)
        if made.left_alone:
            self._say(made.left_alone[0])
        return made

    def _begin_recording(self) -> None:
        take = new_take(self.scene, self.options, self.followed)
        self._tell("live-record", output=str(take.path))
        self._recording, self._recording_since = take, time.perf_counter()
        self._play(True)

    def _end_recording(self) -> None:
        self._tell("live-record", output=None)
        self._play(False)

    def _play(self, on: bool) -> None:
        screen_now = bpy.context.screen
        if self._settings.play and screen_now is not None and screen_now.is_animation_playing != on:
            bpy.ops.screen.animation_play()

    def _recorded(self, event: Event) -> None:
        take, self._recording = self._recording, None
        if take is None:
            return
        self._play(False)
        take.seconds = event["seconds"]
        if not event["frames"]:
            self._say("nothing was recorded: no picture came meanwhile")
            return
        take.anchors.update(self._anchors)
        takes.append(take)
        self._taken.append(take)
        if self._previewing is not None:
            run_to_completion(self._previewing)
        self._previewing = self._finishing(take)

    def _finishing(self, take: LiveTake) -> Generator[None, None, None]:
        yield from take.previewing()
        self.recorded.append(take)

    def _calibrated(self, hands: Sequence[dict[str, Any]]) -> None:
        if hands:
            length = float(np.mean([hand["hand_length"] for hand in hands]))
            self.options = replace(self.options, hand_length=length)
            self._say(f"your hand is {100.0 * length:.1f} cm long")
            self._anchors.clear()
            self.hide()  # the next pose makes hands of the shape

    def _close(self) -> None:
        """Close the session whose worker has ended, or has to."""
        self._closed = True
        self.hide()
        self.worker.stop()
        take = self._recording
        if take is not None and take.path.exists():  # frames that were written before it died can be read
            self._recorded({"frames": max(1, len(take.poses)), "seconds": take.seconds})


current: LiveSession | None = None
"""The session that was started last, which may be over"""


def start(scene: bpy.types.Scene, options: CaptureOptions, followed: Followed) -> LiveSession:
    """Begin to follow a source. Raises HandfitError."""
    global current
    if current is not None and not current.over:
        raise OptionError("Live runs already: stop it first")
    current = LiveSession(scene, options, followed)
    return current


def running() -> LiveSession | None:
    """Return the session that is neither over nor ending; None where there is none."""
    return current if current is not None and not current.over else None


class _Pictures:
    """The small picture of the live source, as an icon."""

    def __init__(self) -> None:
        self._all: Any = None

    def show(self, rgb: np.ndarray) -> None:
        """Show a picture (H, W, 3), uint8 RGB."""
        if self._all is None:
            self._all = bpy.utils.previews.new()
            self._all.new("live")
        height, width = rgb.shape[:2]
        side = max(height, width)
        top, left = (side - height) // 2, (side - width) // 2
        pixels = np.zeros((side, side, 4), dtype=np.uint8)  # icons are square
        pixels[top : top + height, left : left + width] = np.insert(rgb, 3, 255, axis=-1)
        preview = self._all["live"]
        preview.image_size = (side, side)
        preview.image_pixels.foreach_set(pixels[::-1].copy().view(np.int32).ravel())

    @property
    def icon(self) -> int:
        """Return the icon's number; 0 where no picture has come."""
        return 0 if self._all is None else self._all["live"].icon_id

    def forget(self) -> None:
        """Forget the picture."""
        if self._all is not None:
            bpy.utils.previews.remove(self._all)
            self._all = None


pictures = _Pictures()


def _frame_at(moment: float) -> float:
    """Return the scene frame that was shown at a moment of `time.perf_counter`, not long ago."""
    scene, windows = bpy.context.scene, bpy.context.window_manager.windows
    plays = any(window.screen.is_animation_playing for window in windows)
    late = (time.perf_counter() - moment) * frame_rate(scene) if plays else 0.0
    return float(round(scene.frame_current - late))


def _motion(told: dict[str, Any]) -> HandMotion:
    """Return a hand of an event as a motion of one frame."""
    betas, *pose = (unpack(told[name]) for name in ("betas", "global_orient", "hand_pose", "transl"))
    return HandMotion(told["side"], betas, *(rows[None] for rows in pose))


def _on_other_file(*_args) -> None:
    if current is not None and not current.over:
        current.abandon()
    takes.clear()


def _on_time_travel(*_args) -> None:
    """Have leftovers removed after another file or an undo, which may hold hands that followed when it was
    made."""
    if not bpy.app.timers.is_registered(_sweep):
        bpy.app.timers.register(_sweep, first_interval=0.0)


def _sweep() -> None:
    if running() is None:
        remove_leftovers()


def _on_save(*_args) -> None:
    if current is not None:
        current.hide()


def _on_frame(*_args) -> None:
    if current is not None:
        current.show_again()


HANDLERS = {
    "load_pre": _on_other_file,
    **dict.fromkeys(("undo_post", "redo_post", "load_post"), _on_time_travel),
    "save_pre": _on_save,
    "frame_change_post": _on_frame,
}
TIMERS = (_sweep,)


def unregister() -> None:
    """End a live session, and forget its pictures."""
    _on_other_file()
    pictures.forget()
