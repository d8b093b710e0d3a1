"""Captures that wait, run and are built: a queue that somebody ticks.

The worker process finds and fits; the take that it wrote is read, and the scene built, in slices. There are
no threads: Blender up to 5.0 can crash when another thread runs Python during an operator. Data-blocks are
named, never held, from one tick to the next: an undo may replace them.
"""

from __future__ import annotations

import time
import traceback
import uuid
from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import bpy
import numpy as np

from handfit_core.capturing.options import CROWD, CaptureOptions
from handfit_core.common.errors import BuildInterrupted, Cancelled, HandfitError, InputError
from handfit_core.common.slices import map_yields, slice_clock
from handfit_core.fit.solvers import SOLVERS
from handfit_core.media.source import Source
from handfit_core.take import Take

from ..common.blender_versions import select_bones
from ..common.block_reference import BlockReference
from ..common.wording import capitalised, counted, without_name
from ..scene.apply import apply_track, track_for
from ..scene.build import BuildOptions, BuiltTake, building
from ..scene.camera_clip import CameraClip
from ..scene.captures import becomes_active, captures
from ..scene.controls import add_controls
from ..scene.matching import Choice, Footage, clear_view, matches, scene_sentence
from ..scene.store import hand_of
from . import details, shared_worker
from .cache import folder_path, temporary_take

State = Literal["waiting", "capturing", "building", "done", "failed", "cancelled"]

_MAX_FINISHED = 6
"""finished jobs that the panel still shows"""


@dataclass(frozen=True)
class Building:
    """How a job's take is built into a scene."""

    scene: BlockReference
    target: Literal["NEW", "ANIMATION", "POSE"] = "NEW"
    hand: BlockReference | None = None
    """The armature that ANIMATION and POSE are for"""
    frame: float = 1.0
    """The scene frame of POSE, and of new hands in a scene that keeps its time"""
    pose_correctives: bool = True
    controls: bool = False
    render_setup: bool = True
    matching: Choice = "AUTO"
    retimed: float | None = None
    """Frames per second of the scene that a clip of another rate will be retimed to"""
    camera: BlockReference | None = None
    """An existing camera to look through instead of a new one"""
    clip: CameraClip | None = None
    """That camera's own, if it is what is captured"""


@dataclass(eq=False)
class Job:
    """One capture from the button to the rig."""

    name: str
    files: tuple[str, ...]
    options: CaptureOptions
    building: Building
    ask_if_many: bool = False
    """Whether the artist chooses first where there are more than a few hands"""
    bare: bool = False
    """Whether no hands are detected: the picture is shown for an artist to add some"""
    then_add_hand: bool = False
    """Whether Add Hand begins in the job's picture afterwards"""
    output: Path | None = None
    """Where its take is kept; None: in a folder that goes when Blender ends"""
    then: Callable[[BuiltTake], Generator[float, None, None]] | None = None
    """What is done with new hands before they are an undo step, in slices"""
    hands_to_choose: int = 0
    """the number of hands found, where there were too many to build without asking; else 0"""
    state: State = "waiting"
    stage: str = ""
    done: int = 0
    total: int = 0
    fraction: float = 0.0
    """0..1 of the whole job"""
    message: str = ""
    """What went wrong, or what is to be known, in one sentence"""
    warnings: list[str] = field(default_factory=list)
    offer: str = ""
    """The operator, `find_hands` or `add_hand`, that helps with the first warning"""
    matched: bool = False
    """Whether the scene was given the footage's rate, range, size and camera"""
    in_front: bool = False
    """Whether it became the active capture, whose camera the scene looks through"""
    scene_message: str = ""
    """What became of the scene, in one sentence; empty where nothing was built into it"""
    views_message: str = ""
    """The verdict on a capture of two views that fit together; empty for one view, and where a warning says
    that they do not"""
    stopped: bool = False
    """Whether it was cancelled, and what was finished kept"""
    hands: tuple[str, ...] = ()
    """Names of the armatures that came of it"""
    key: str = field(default_factory=lambda: uuid.uuid4().hex[:8])
    """the key under which scenes note the job, so that an undo is seen"""
    _request: int = 0
    _stage_began: float = 0.0
    _stage_first: int = 0
    _views_done: int = 0
    _take_path: Path | None = None
    _builder: Generator[float, None, Any] | None = None
    _capture: BlockReference | None = None
    """The collection of the new hands"""
    _stopping: bool = False
    _replaces: tuple[Job, ...] = ()
    """Failures that were shown when it was asked for; once it succeeds they are old"""

    @property
    def running(self) -> bool:
        """Whether the job is being captured or built."""
        return self.state in ("capturing", "building")

    @property
    def finished(self) -> bool:
        """Whether the job is done, failed or cancelled."""
        return self.state in ("done", "failed", "cancelled")

    @property
    def stop_button(self) -> tuple[str, bool]:
        """The text of the button that stops the job, and whether it can be pressed: once, and not when
        finished frames would be lost by it."""
        if self.state == "building":
            return "Building Hands", False
        return ("Stopping", False) if self._stopping else ("Stop", True)

    @property
    def is_gone(self) -> bool:
        """True if an undo took its hands back, or the artist has removed them."""
        if self.state != "done":
            return False
        capture = self._capture and self._capture.find()
        undone = not any(self.key in _captured(scene) for scene in bpy.data.scenes)
        removed = self._capture and not any(capture in captures(scene) for scene in bpy.data.scenes)
        return undone or bool(removed)

    @property
    def rate(self) -> float:
        """Frames per second of the present stage; 0 while nobody knows."""
        spent, frames = time.monotonic() - self._stage_began, self.done - self._stage_first
        return frames / spent if self._stage_began and frames > 0 and spent > 0.2 else 0.0

    def activity(self) -> str:
        """What the job does now, short enough for a progress bar; of a finished job its result."""
        if self.state == "waiting":
            return "Waiting"
        if self.state == "building":
            return self.message or "Building hands"
        if self.state != "capturing":
            return self.message
        if self._stopping:
            return "Stopping, keeping frames"
        if not self.stage:
            return "Starting"
        named = {"detect": "Finding hands", "fit": "Fitting", "join": "Joining views", "arms": "Finding arms"}
        text = named.get(self.stage, self.stage)
        if self.options.view is not None and self.stage in ("detect", "fit"):
            text = f"{text}, view {self._views_done + 1}"
        return f"{text}  {self.done}/{self.total}" if self.total > 1 else text

    def speed_text(self) -> str:
        """Frames per second and the time that is left; empty while they are unknown."""
        if self.state != "capturing" or self._stopping or self.total <= 1 or not self.rate:
            return ""
        left = (self.total - self.done) / self.rate
        return f"{self.rate:.0f} fps  {_duration(left)} left"

    def summary(self) -> str:
        """The result of the job in sentences: its message, warnings, and what became of the scene."""
        said = (self.message, *self.warnings, self.views_message, self.scene_message)
        return ". ".join(text.removesuffix(".") for text in said if text)

    def status(self) -> str:
        """`activity` and `speed_text` in one line."""
        return "  ".join(filter(None, (self.activity(), self.speed_text())))


_queue: list[Job] = []


def jobs() -> tuple[Job, ...]:
    """All jobs, the oldest first; finished ones are forgotten after a while."""
    return tuple(_queue)


def busy() -> bool:
    """Whether something is captured, built, or waits for it."""
    return any(not job.finished for job in _queue)


def current() -> Job | None:
    """The job that runs."""
    return next((job for job in _queue if job.running), None)


def current_or_next() -> Job | None:
    """The job that runs, or is the next to."""
    return next((job for job in _queue if not job.finished), None)


def submit(job: Job) -> None:
    """Put a job behind the others."""
    job._replaces = tuple(old for old in _queue if old.state == "failed")
    _queue.append(job)
    finished = [j for j in _queue if j.finished]
    for old in finished[: max(0, len(finished) - _MAX_FINISHED)]:
        _queue.remove(old)


def forget_finished() -> None:
    """Drop what is over from the list."""
    _queue[:] = [job for job in _queue if not job.finished]


def cancel(job: Job) -> None:
    """Stop a job as soon as it can be, keeping finished frames; a second call keeps none."""
    if job.state == "waiting":
        job.state, job.message = "cancelled", "Cancelled"
    elif job.state == "capturing" and not job._stopping:
        job._stopping = True
        shared_worker.worker().cancel(job._request)
    elif job.state == "capturing":
        shared_worker.worker().stop()
        job.state, job.message = "cancelled", "Cancelled"
    elif job.state == "building":
        if job._builder is not None:
            job._builder.close()
        job.state, job.message = "cancelled", "Cancelled"


def cancel_all() -> None:
    """Stop everything."""
    for job in list(_queue):
        if not job.finished:
            cancel(job)


def abandon() -> None:
    """Stop everything without keeping anything: another file is opened, or the add-on goes."""
    if current() is not None:
        shared_worker.stop()
    for job in _queue:
        if job._builder is not None:
            job._builder.close()
    _queue.clear()


def tick() -> bool:
    """Go on for at most a few milliseconds. Returns whether anything changed."""
    job = current() or next((j for j in _queue if j.state == "waiting"), None)
    if job is None:
        return False
    try:
        if job.state == "waiting":
            _start(job)
            return True
        if job.state == "capturing":
            return _follow(job)
        return _build(job)
    except Cancelled:
        job.state, job.message = "cancelled", "Cancelled"
    except HandfitError as error:
        _fail(job, str(error), error)
    except Exception as error:  # a defect of ours, which must not end the queue
        _fail(job, f"Unexpected {type(error).__name__}: {error}", traceback.format_exc())
    return True


def run() -> list[Job]:
    """Wait for everything that is queued, without a window; returns the jobs that this finished."""
    waited = [job for job in _queue if not job.finished]
    while busy():
        if not tick():
            time.sleep(0.005)
    return waited


def _start(job: Job) -> None:
    job._take_path = job.output or temporary_take(job.name)
    job._request = shared_worker.worker().submit(
        "capture",
        input=list(job.files),
        output=str(job._take_path),
        options=job.options.to_message(),
        compact=True,
        bare=job.bare,
        retimed=job.building.retimed,
    )
    job.state = "capturing"


def _follow(job: Job) -> bool:
    changed = False
    for event in shared_worker.worker().events(job._request):
        changed = True
        kind = event.get("event")
        if kind == "progress":
            _on_progress(job, event)
        elif kind == "warning":
            offer, text = str(event.get("offer", "")), str(event.get("message", ""))
            job.warnings.insert(0 if offer else len(job.warnings), text)
            job.offer = offer or job.offer
        elif kind == "error":
            if event.get("type") == "Cancelled":
                raise Cancelled(str(event.get("message", "")))
            _fail(job, str(event.get("message", "")), str(event.get("details", "")))
        elif kind == "done":
            job.stopped = bool(event.get("stopped"))
            job.state, job.fraction = "building", 0.9
            if job.ask_if_many and len(event.get("hands", ())) > CROWD:
                job.hands_to_choose = len(event["hands"])
                job.state, job.message = "cancelled", f"{job.hands_to_choose} hands: choose those to build"
    return changed


def _on_progress(job: Job, event: dict[str, Any]) -> None:
    stage, done, total = str(event.get("stage")), int(event.get("done", 0)), int(event.get("total", 0))
    views = 1 if job.options.view is None else 2
    if stage == "detect" and job.stage in ("fit", "join", "arms"):  # pictures are read again
        if job.stage == "fit" and job._views_done < views - 1:
            job._views_done += 1
        else:
            stage = "arms"
    if stage != job.stage:
        job.stage, job._stage_began, job._stage_first = stage, time.monotonic(), done
    job.done, job.total = done, total
    part = done / total if total else float(stage == "join")
    # Detection takes nearly all of a capture's time, except with slow solvers.
    solver = SOLVERS.built_in().get(job.options.solver)
    share = 0.1 if solver is not None and solver.slow else 0.85
    own = share * part if stage == "detect" else share + (0.9 - share) * part
    fraction = (0.9 * job._views_done + own) / views
    if job.options.arms:
        fraction = 0.9 - 0.3 * (1.0 - part) if stage == "arms" else fraction * 2.0 / 3.0
    job.fraction = fraction


def _build(job: Job) -> bool:
    is_over = slice_clock()
    try:
        if job._builder is None:
            job._builder = _builder(job)
        while not is_over():
            job.fraction = 0.9 + 0.1 * next(job._builder)
    except StopIteration as stop:
        job._builder = None
        job.hands, warnings, job.message = stop.value
        job.warnings += warnings
        job.state, job.fraction = "done", 1.0
        _queue[:] = [other for other in _queue if other not in job._replaces]
        _make_active(job.hands)
        _note(job)
        bpy.ops.ed.undo_push(message="Capture Hands")
    except BuildInterrupted:
        job._builder = None  # an undo took away what was half built: from the start
    return True


def _builder(job: Job) -> Generator[float, None, tuple[tuple[str, ...], list[str], str]]:
    """Yields how far it is; returns the armatures' names, warnings and a summary."""
    assert job._take_path is not None
    try:
        data = job._take_path.read_bytes()
    except OSError as error:
        raise InputError(f"{job._take_path}: the captured take is gone ({error.strerror})") from error
    take = yield from map_yields(Take.reading(data), lambda: 0.0)
    plan, warnings = job.building, []
    if plan.target != "NEW":
        assert plan.hand is not None
        target = plan.hand.find()
        if target is not None and hand_of(target) is not None:
            yield 0.5
            timing = plan.clip.timing if plan.clip else None
            track = track_for(take, target.manient.side)
            apply_track(target, take, track, plan.target, plan.frame, timing=timing)
            return (target.name,), _verdict(job, take), _summary(job, take)
        warnings.append(f"the hand {plan.hand.name} is gone, so new hands were built")
    scene = plan.scene.find()
    while scene is not None and bpy.context.scene != scene:
        job.message = f"Open the scene {scene.name} to get the captured hands"
        yield 0.0
        scene = plan.scene.find()
    if scene is None:
        warnings.append(f"the scene {plan.scene.name} is gone, so the hands were built in the open one")
    job.message = ""
    camera = plan.camera.find() if plan.camera else None
    clip = plan.clip if scene is not None and camera is not None else None
    timing = clip.timing if clip else None
    footage = Footage.of_take(take, own_camera=plan.camera is not None, placed=timing)
    frame = plan.frame if scene is not None else float(bpy.context.scene.frame_current)
    job.matched = scene is not None and not warnings and matches(scene, plan.matching, footage)
    job.in_front = scene is not None and becomes_active(scene, plan.matching, job.matched)
    how = BuildOptions(
        data=data,
        in_front=job.in_front,
        pose_correctives=plan.pose_correctives,
        match_scene=job.matched,
        frame=frame,
        timing=timing,
        picture=clip is None or not clip.is_shown,
        render_setup=plan.render_setup,
        camera=camera,
    )
    built = yield from building(take, how)
    job._capture = BlockReference.of("collections", built.collection)
    for hand in built.hands:
        hand.armature.manient.smoothing = job.options.smoothing
    for hand in filter(None, (hand_of(h.armature) for h in built.hands if plan.controls)):
        add_controls(hand)
    if job.then is not None:
        yield from map_yields(job.then(built), lambda: 1.0)
    _pack_cached_pictures(take)
    warnings += built.warnings
    warnings += _verdict(job, take)
    if not job.bare:
        job.scene_message = scene_sentence(bpy.context.scene, plan.matching, footage, frame, done=job.matched)
    if (job.matched or job.in_front) and plan.camera is None:
        warnings += clear_view(built.camera, built.collection, bpy.context.view_layer)
    return (tuple(hand.armature.name for hand in built.hands), warnings, _summary(job, take))


def _verdict(job: Job, take: Take) -> list[str]:
    """Note how well both views fit together; returns it where it is a warning."""
    if take.verdict is None:
        return []
    if take.verdict.agreement != "good":
        return [take.verdict.text]
    job.views_message = take.verdict.text.rstrip(".")
    return []


def _captured(scene: bpy.types.Scene) -> list[str]:
    return scene.manient.captured.split()


def _note(job: Job) -> None:
    """Have the open scene say that this capture is in it, so that undo and redo change that as well."""
    scene = bpy.context.scene
    listed = {other.key for other in _queue}
    scene.manient.captured = " ".join([*(key for key in _captured(scene) if key in listed), job.key])


def _pack_cached_pictures(take: Take) -> None:
    """Keep pictures in the .blend that lie in the cache folder, from where they will vanish."""
    path = Path(take.source.files[0])
    if not path.is_relative_to(folder_path()):
        return
    for image in bpy.data.images:
        if image.filepath and not image.packed_file and Path(bpy.path.abspath(image.filepath)) == path:
            image.pack()


def _make_active(hands: tuple[str, ...]) -> None:
    """Select what was built, unless the artist is in the middle of something else. Bones are selected anyway,
    since the Timeline shows keys of selected ones alone."""
    layer = bpy.context.view_layer
    armatures = [o for name in hands if (o := layer.objects.get(name)) is not None]
    for armature in armatures:
        select_bones(armature)
    if bpy.context.mode != "OBJECT" or not armatures:
        return
    for other in layer.objects.selected:
        other.select_set(False)
    for armature in armatures:
        armature.select_set(True)
    layer.objects.active = armatures[0]


def _fail(job: Job, sentence: str, more: Exception | str) -> None:
    # Wherever it is shown, the job's name stands before it.
    names = (job.name, *job.files[:1], *(Source(kind, job.files).name for kind in ("photo", "sequence")))
    job.state, job.message = "failed", capitalised(without_name(sentence or "the capture failed", names))
    job._builder = None
    details.write_details(f"Capture of {job.name}", job.message, more)


def _summary(job: Job, take: Take) -> str:
    if job.bare:
        return "the picture, for hands that you add"
    seen, count = int(np.any([track.present for track in take.hands], axis=0).sum()), len(take.frame_numbers)
    frames = counted(count, "frame") if seen == count else f"{seen} of {count} frames"
    text = f"{counted(len(take.hands), 'hand')} in {frames}"
    return f"{text}, stopped early" if job.stopped else text


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{max(1, round(seconds))} s"
    return f"{int(seconds // 60)}:{int(seconds % 60):02d} min"


HANDLERS = {"load_pre": lambda *_args: abandon()}


def unregister() -> None:
    """Stop everything."""
    abandon()
