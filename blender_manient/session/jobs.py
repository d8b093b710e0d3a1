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
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

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
from .shared_worker import Progress

_Step = Progress | float
State = Literal["waiting", "capturing", "building", "done", "failed", "cancelled"]

_CAPTURING = 0.9
"""The share of a job's time that the worker takes; the rest is building"""
_MAX_FINISHED = 6
"""How many finished jobs the panel still shows"""


@dataclass(frozen=True)
class Building:
    """How the take of a job is built into a scene."""

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
    """The frames per second of the scene that a clip of another rate will be retimed to; None where it is not
    retimed"""
    camera: BlockReference | None = None
    """An existing camera to look through instead of a new one"""
    clip: CameraClip | None = None
    """The clip of that camera, if it is what is captured; None otherwise"""


@dataclass(frozen=True)
class CaptureRequest:
    """One capture as it was asked for: its input, its options, and how its hands are built."""

    name: str
    files: tuple[str, ...]
    options: CaptureOptions
    building: Building
    ask_if_many: bool = False
    """True if the artist chooses first where there are more than a few hands"""
    bare: bool = False
    """True if no hands are detected: the picture is shown for an artist to add some"""
    then_add_hand: bool = False
    """True if Add Hand begins in the picture afterwards"""
    output: Path | None = None
    """Where the take is kept; None: in a folder that goes when Blender ends"""
    then: Callable[[BuiltTake], Generator[float, None, None]] | None = None
    """A function that goes on with new hands, in slices, before they become an undo step; None for nothing
    more"""

    def shares(self) -> dict[tuple[str, int], float]:
        """Return the share of the job's time that each stage takes, in their order, by its name and the
        view."""
        # Detection takes nearly all of a capture's time, except with slow solvers.
        solver = SOLVERS.built_in().get(self.options.solver)
        detect = 0.1 if solver is not None and solver.slow else 0.85
        shares, arms = {("detect", 0): detect, ("fit", 0): 0.9 - detect}, {("arms", 0): 0.45}
        if self.options.view is not None:
            shares |= {("detect", 1): detect, ("fit", 1): 0.9 - detect, ("join", 0): 0.1}
            shares |= arms if self.options.arms else {}
        elif self.options.arms:  # which name the sides of hands before these are fitted
            shares = {("detect", 0): detect, **arms, ("fit", 0): 0.9 - detect}
        whole = sum(shares.values())
        return {stage: _CAPTURING * share / whole for stage, share in shares.items()}


@dataclass(frozen=True)
class CaptureResult:
    """The outcome of a job, as panel and reports show it."""

    message: str = ""
    """One sentence about what was built, or about what went wrong"""
    hands: tuple[str, ...] = ()
    """The names of the new hands' armatures"""
    warnings: tuple[str, ...] = ()
    offer: str = ""
    """The operator, `find_hands` or `add_hand`, that helps with the first warning"""
    matched: bool = False
    """True if the scene was given the footage's rate, range, size and camera"""
    in_front: bool = False
    """True if it became the active capture, whose camera the scene looks through"""
    scene_message: str = ""
    """One sentence about how the scene was changed; empty where nothing was built into it"""
    views_message: str = ""
    """The verdict on a capture of two views that fit together; empty for one view, and where a warning says
    that they do not"""
    hands_to_choose: int = 0
    """the number of hands found, where there were too many to build without asking; else 0"""
    collection: BlockReference | None = None
    """The collection of the new hands; None where none were built"""

    def report(self) -> str:
        """Return the result in sentences, without its warnings."""
        return _sentences(self.message, self.views_message, self.scene_message)

    def summary(self) -> str:
        """Return the result in sentences: its message, warnings, and what became of the scene."""
        return _sentences(self.message, *self.warnings, self.views_message, self.scene_message)


def _sentences(*said: str) -> str:
    return ". ".join(text.removesuffix(".") for text in said if text)


@dataclass(eq=False)
class Job:
    """One capture from the button to the rig: a generator that `tick` advances."""

    request: CaptureRequest
    state: State = "waiting"
    progress: Progress = field(default_factory=lambda: Progress("Starting"))
    result: CaptureResult = CaptureResult()
    stopping: bool = False
    """True if it was asked to stop and to keep what is finished"""
    key: str = field(default_factory=lambda: uuid.uuid4().hex[:8])
    """The key under which scenes note the job, so that an undo is seen"""
    steps: Generator[_Step, None, None] | None = None
    """The steps of the job's work, once it has begun; None before"""
    replaces: tuple[Job, ...] = ()
    """The failed jobs that were shown when this one was asked for; once it succeeds they are old"""

    @property
    def running(self) -> bool:
        """True if the job is being captured or built."""
        return self.state in ("capturing", "building")

    @property
    def finished(self) -> bool:
        """True if the job is done, failed or cancelled."""
        return self.state in ("done", "failed", "cancelled")

    @property
    def stop_button(self) -> tuple[str, bool]:
        """Return the text of the button that stops the job, and whether it can be pressed: once, and not when
        finished frames would be lost by it."""
        if self.state == "building":
            return "Building Hands", False
        return ("Stopping", False) if self.stopping else ("Stop", True)

    @property
    def is_gone(self) -> bool:
        """True if an undo took its hands back, or the artist has removed them."""
        if self.state != "done":
            return False
        reference = self.result.collection
        capture = reference and reference.find()
        undone = not any(self.key in _captured(scene) for scene in bpy.data.scenes)
        removed = reference and not any(capture in captures(scene) for scene in bpy.data.scenes)
        return undone or bool(removed)

    @property
    def fraction(self) -> float:
        """Return how much of the whole job is done, 0..1."""
        if self.state == "building":
            return _CAPTURING + (1.0 - _CAPTURING) * self.progress.part
        at, done = (self.progress.stage, self.progress.view), 0.0
        for stage, share in self.request.shares().items():
            if stage == at:
                # Nobody knows how long joining takes.
                return done + share * (1.0 if at[0] == "join" else self.progress.part)
            done += share
        return float(self.finished)

    def activity(self) -> str:
        """Return the present step in words, short enough for a progress bar; of a finished job its result."""
        if self.finished:
            return self.result.message
        if self.state == "waiting":
            return "Waiting"
        if self.stopping and self.state == "capturing":
            return "Stopping, keeping frames"
        return self.progress.stage_text(1 if self.request.options.view is None else 2)

    def speed_text(self) -> str:
        """Return the speed in frames per second and the time that is left, in words; empty while they are
        unknown."""
        rate, left = self.progress.rate, self.progress.total - self.progress.done
        if self.state != "capturing" or self.stopping or self.progress.total <= 1 or not rate:
            return ""
        return f"{rate:.0f} fps  {_duration(left / rate)} left"

    def status(self) -> str:
        """Return `activity` and `speed_text` in one line."""
        return "  ".join(filter(None, (self.activity(), self.speed_text())))


_queue: list[Job] = []


def jobs() -> tuple[Job, ...]:
    """Return all jobs, the oldest first; finished ones are forgotten after a while."""
    return tuple(_queue)


def busy() -> bool:
    """True if something is captured or built, or waits for that."""
    return any(not job.finished for job in _queue)


def current() -> Job | None:
    """Return the job that runs; None where none does."""
    return next((job for job in _queue if job.running), None)


def current_or_next() -> Job | None:
    """Return the job that runs, or is the next to; None where none waits."""
    return next((job for job in _queue if not job.finished), None)


def submit(request: CaptureRequest) -> Job:
    """Put a job behind the others."""
    job = Job(request, replaces=tuple(old for old in _queue if old.state == "failed"))
    _queue.append(job)
    finished = [j for j in _queue if j.finished]
    for old in finished[: max(0, len(finished) - _MAX_FINISHED)]:
        _queue.remove(old)
    return job


def forget_finished() -> None:
    """Drop the jobs that are over from the list."""
    _queue[:] = [job for job in _queue if not job.finished]


def cancel(job: Job) -> None:
    """Stop a job as soon as it can be, keeping finished frames; a second call keeps none."""
    if job.finished:
        return
    if job.state == "capturing" and not job.stopping:
        job.stopping = True
        shared_worker.worker().cancel(job.progress.request)
        return
    if job.state == "capturing":
        shared_worker.worker().stop()
    if job.steps is not None:
        job.steps.close()
    _end(job, "cancelled", "Cancelled")


def cancel_all() -> None:
    """Stop all jobs."""
    for job in list(_queue):
        cancel(job)


def abandon() -> None:
    """Stop all jobs without keeping anything: another file is opened, or the add-on goes."""
    if current() is not None:
        shared_worker.stop()
    for job in _queue:
        if job.steps is not None:
            job.steps.close()
    _queue.clear()


def tick() -> bool:
    """Go on for at most a few milliseconds. Returns whether anything changed."""
    job = current() or next((j for j in _queue if j.state == "waiting"), None)
    if job is None:
        return False
    before, is_over = job.progress, slice_clock()
    try:
        if job.steps is None:
            job.state, job.steps = "capturing", _steps(job)
        while not is_over():
            step = next(job.steps)
            if isinstance(step, Progress):
                job.progress = step
                break
            job.progress = replace(job.progress, title="Building hands", stage="build", done=step, total=1.0)
    except StopIteration:
        pass
    except Cancelled:
        _end(job, "cancelled", "Cancelled")
    except HandfitError as error:
        _fail(job, str(error), error)
    except Exception as error:  # a defect of ours, which must not end the queue
        _fail(job, f"Unexpected {type(error).__name__}: {error}", traceback.format_exc())
    return job.finished or job.progress != before


def run() -> list[Job]:
    """Wait for everything that is queued, without a window; returns the jobs that this finished."""
    waited = [job for job in _queue if not job.finished]
    while busy():
        if not tick():
            time.sleep(0.005)
    return waited


def _end(job: Job, state: State, message: str, hands_to_choose: int = 0) -> None:
    """End a job that built nothing."""
    warnings, offer = job.progress.warnings, job.progress.offer
    job.state = state
    job.result = CaptureResult(message, (), warnings, offer, hands_to_choose=hands_to_choose)


def _fail(job: Job, sentence: str, more: Exception | str) -> None:
    # Wherever it is shown, the job's name stands before it.
    name, files = job.request.name, job.request.files
    names = (name, *files[:1], *(Source(kind, files).name for kind in ("photo", "sequence")))
    _end(job, "failed", capitalised(without_name(sentence or "the capture failed", names)))
    details.write_details(f"Capture of {name}", job.result.message, more)


def _finish(job: Job, result: CaptureResult) -> None:
    """Show what was built, and make it an undo step."""
    job.state, job.result = "done", result
    _queue[:] = [other for other in _queue if other not in job.replaces]
    _make_active(result.hands)
    _note(job)
    bpy.ops.ed.undo_push(message="Capture Hands")


def _steps(job: Job) -> Generator[_Step, None, None]:
    """Do a capture from the request to the worker until the hands are in the scene. Yields how much of them
    is built, 0..1, or what is waited for."""
    request = job.request
    path = request.output or temporary_take(request.name)
    answer = yield from _capturing(request, path)
    warnings, offer, found = job.progress.warnings, job.progress.offer, len(answer["hands"])
    if request.ask_if_many and found > CROWD:
        _end(job, "cancelled", f"{found} hands: choose those to build", hands_to_choose=found)
        return
    job.state = "building"
    data = _bytes_of(path)
    yield 0.0
    take = yield from map_yields(Take.reading(data), lambda: 0.0)
    built = yield from _building_again(request, take, data)
    verdict, agrees = take.verdict, take.verdict is not None and take.verdict.agreement == "good"
    result = replace(
        built,
        message=_summary(request, take) + (", stopped early" if answer["stopped"] else ""),
        warnings=(*warnings, *built.warnings, *([] if verdict is None or agrees else [verdict.text])),
        offer=offer,
        views_message=verdict.text.rstrip(".") if verdict is not None and agrees else "",
    )
    _finish(job, result)


def _capturing(request: CaptureRequest, path: Path) -> shared_worker.Asking:
    """Have the worker write the take to `path`; returns its answer."""
    return shared_worker.ask(
        "capture",
        "Starting",
        input=list(request.files),
        output=str(path),
        options=request.options.to_message(),
        compact=True,
        bare=request.bare,
        retimed=request.building.retimed,
    )


def _bytes_of(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: the captured take is gone ({error.strerror})") from error


def _building_again(
    request: CaptureRequest, take: Take, data: bytes
) -> Generator[_Step, None, CaptureResult]:
    """Build the take, from the start where an undo takes away what is half built."""
    while True:
        try:
            return (yield from _building(request, take, data))
        except BuildInterrupted:
            yield 0.0


def _building(request: CaptureRequest, take: Take, data: bytes) -> Generator[_Step, None, CaptureResult]:
    """Build the take as the request says: onto the hand that it names, or as new hands."""
    plan, warnings = request.building, []
    if plan.target != "NEW":
        assert plan.hand is not None
        hand = plan.hand.find()
        if hand is not None and hand_of(hand) is not None:
            yield 0.5
            timing, track = plan.clip.timing if plan.clip else None, track_for(take, hand.manient.side)
            apply_track(hand, take, track, plan.target, plan.frame, timing=timing)
            return CaptureResult(hands=(hand.name,))
        warnings.append(f"the hand {plan.hand.name} is gone, so new hands were built")
    while (scene := plan.scene.find()) is not None and bpy.context.scene != scene:
        yield Progress(f"Open the scene {scene.name} to get the captured hands")
    if scene is None:
        warnings.append(f"the scene {plan.scene.name} is gone, so the hands were built in the open one")
    return (yield from _building_new(request, take, data, scene, warnings))


def _building_new(
    request: CaptureRequest, take: Take, data: bytes, scene: bpy.types.Scene | None, warnings: list[str]
) -> Generator[_Step, None, CaptureResult]:
    """Build new hands into the open scene. `scene` is the one that they are meant for, None if it is gone."""
    plan = request.building
    camera = plan.camera.find() if plan.camera else None
    clip = plan.clip if scene is not None and camera is not None else None
    timing = clip.timing if clip else None
    footage = Footage.of_take(take, own_camera=plan.camera is not None, placed=timing)
    frame = plan.frame if scene is not None else float(bpy.context.scene.frame_current)
    matched = scene is not None and not warnings and matches(scene, plan.matching, footage)
    in_front = scene is not None and becomes_active(scene, plan.matching, matched)
    how = BuildOptions(
        data=data,
        in_front=in_front,
        pose_correctives=plan.pose_correctives,
        match_scene=matched,
        frame=frame,
        timing=timing,
        picture=clip is None or not clip.is_shown,
        render_setup=plan.render_setup,
        camera=camera,
    )
    built = yield from building(take, how)
    for hand in built.hands:
        hand.armature.manient.smoothing = request.options.smoothing
    for hand in filter(None, (hand_of(h.armature) for h in built.hands if plan.controls)):
        add_controls(hand)
    if request.then is not None:
        yield from map_yields(request.then(built), lambda: 1.0)
    _pack_cached_pictures(take)
    after, said = list[str](), ""
    if not request.bare:
        said = scene_sentence(bpy.context.scene, plan.matching, footage, frame, done=matched)
    if (matched or in_front) and plan.camera is None:
        after = clear_view(built.camera, built.collection, bpy.context.view_layer)
    return CaptureResult(
        hands=tuple(hand.armature.name for hand in built.hands),
        warnings=(*warnings, *built.warnings, *after),
        matched=matched,
        in_front=in_front,
        scene_message=said,
        collection=BlockReference.of("collections", built.collection),
    )


def _summary(request: CaptureRequest, take: Take) -> str:
    if request.bare:
        return "the picture, for hands that you add"
    seen, count = int(np.any([track.present for track in take.hands], axis=0).sum()), len(take.frame_numbers)
    frames = counted(count, "frame") if seen == count else f"{seen} of {count} frames"
    return f"{counted(len(take.hands), 'hand')} in {frames}"


def _captured(scene: bpy.types.Scene) -> list[str]:
    return scene.manient.captured.split()


def _note(job: Job) -> None:
    """Note in the open scene that this capture is in it, so that undo and redo change that as well."""
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


def _duration(seconds: float) -> str:
    if seconds < 60:
        return f"{max(1, round(seconds))} s"
    return f"{int(seconds // 60)}:{int(seconds % 60):02d} min"


HANDLERS = {"load_pre": lambda *_args: abandon()}


def unregister() -> None:
    """Stop all jobs."""
    abandon()
