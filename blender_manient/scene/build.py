"""From a take to a Blender scene, on one page.

The scene is built in slices, so that a window stays alive meanwhile. Until the last of them nothing is
linked to the scene: nobody sees half a hand, nothing is evaluated or drawn twice, and an undo step that is
made meanwhile shows none. Between two slices only data-blocks are held, because Blender tells when those
are gone. There are no threads: while one runs Python, Blender may crash in operators and drivers that call
Python too (up to Python 3.11 it cannot tell which of its threads holds the interpreter).
"""

from __future__ import annotations

import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import bpy

from handfit_core.errors import BuildInterrupted, OptionError
from handfit_core.hand_model import HandModel, load_model
from handfit_core.hand_model.forearm import Wrist, with_wrist
from handfit_core.skeleton import NUM_JOINTS, Side
from handfit_core.take import HandTrack, Take

from .. import axes
from ..slices import result_of, retold
from ..wording import NAME_BYTES, named_after, shortened_name
from .animation import CURVES, animating, computing_keys, describe
from .armature import build_armature, rest_frames
from .camera import build_camera, frame_scene, put_before, show_behind
from .correctives import adding_correctives
from .matching import Footage, note_matched
from .mesh import build_mesh
from .plate import Plate, loading_plate
from .render_setup import put_in_force, set_up
from .store import describe_capture, describe_hand, keep_packed, kept_here, packing_take
from .timing import Timing, check_range, set_timing, timing_in

_SLICE = 0.008
"""seconds after which a slice ends, when its last step is over"""

_T = TypeVar("_T")


@dataclass(frozen=True)
class BuiltHand:
    """One hand of a take in Blender."""

    side: Side
    armature: bpy.types.Object
    mesh: bpy.types.Object
    action: bpy.types.Action


@dataclass(frozen=True)
class BuiltTake:
    """What `build_take` made; everything lies in `collection`."""

    collection: bpy.types.Collection
    camera: bpy.types.Object
    hands: tuple[BuiltHand, ...]
    warnings: tuple[str, ...]
    """Sentences for the user about what is not as it should be"""


def build_take(
    take: Take,
    *,
    scene: bpy.types.Scene | None = None,
    model: str | None = None,
    pose_correctives: bool = True,
    picture: bool = True,
    match_scene: bool = True,
    render_setup: bool = True,
    wrist: Wrist = "forearm",
    frame: float | None = None,
    camera: bpy.types.Object | None = None,
    data: bytes | None = None,
    max_megapixels: float | None = None,
) -> BuiltTake:
    """Build a take's hands, their animation and the camera that saw them, in a collection of their own.

    `scene` is the current one or None. With `match_scene` it gets the take's frame rate, frame range,
    picture size and camera, and with `render_setup` lights and the picture in its renders too; else it
    stays as it is, and the take starts at `frame` (None: the current one), at its rate. `wrist` is how the
    meshes end. `model` replaces `take.model`, for takes whose model file has moved. `camera` is one that is
    there already: the hands hang on it, and its lens and the scene's size stay. `data` are the bytes of the
    take's file, where the caller has them. `max_megapixels` is how large the picture behind the hands may
    be, instead of what the preferences say. Hands are life-size in any unit of length: in scenes whose unit
    is not the metre their armatures are scaled. Building twice makes a second set and leaves the
    first alone. Raises HandModelError and OptionError.
    """
    steps = building(
        take,
        scene=scene,
        model=model,
        pose_correctives=pose_correctives,
        picture=picture,
        match_scene=match_scene,
        render_setup=render_setup,
        wrist=wrist,
        frame=frame,
        camera=camera,
        data=data,
        max_megapixels=max_megapixels,
    )
    return result_of(steps)


def building(
    take: Take,
    *,
    scene: bpy.types.Scene | None = None,
    model: str | None = None,
    pose_correctives: bool = True,
    picture: bool = True,
    match_scene: bool = True,
    render_setup: bool = True,
    wrist: Wrist = "forearm",
    frame: float | None = None,
    camera: bpy.types.Object | None = None,
    data: bytes | None = None,
    max_megapixels: float | None = None,
) -> Generator[float, None, BuiltTake]:
    """`build_take` in slices of some milliseconds. Yields how much is done, 0..1; returns what was made.

    Closing it early removes what it made. Raises BuildInterrupted where an undo, another file or a
    deletion took something away meanwhile: nothing is left of it, and it can be started again.
    """
    made: list[bpy.types.ID] = []
    finished = False
    steps = None
    try:
        with _Watch() as watch:
            open_scene = _checked_scene(scene)
            steps = _steps(
                made,
                take,
                open_scene,
                model,
                pose_correctives,
                picture,
                match_scene,
                render_setup,
                wrist,
                frame,
                camera,
                data,
                max_megapixels,
            )
            done = 0.0
            while True:
                end = time.perf_counter() + _SLICE
                while time.perf_counter() < end:
                    step = next(steps)
                    if step is None:
                        break
                    done = step
                yield done
                if watch.changed:
                    raise BuildInterrupted("the scene was undone or replaced while hands were being built")
    except StopIteration as stop:
        finished = True
        return stop.value
    except ReferenceError as error:
        raise BuildInterrupted(f"something was deleted while hands were being built ({error})") from error
    finally:
        if not finished:
            _remove(made)


def _steps(
    made: list[bpy.types.ID],
    take: Take,
    scene: bpy.types.Scene,
    model: str | None,
    pose_correctives: bool,
    picture: bool,
    match_scene: bool,
    render_setup: bool,
    wrist: Wrist,
    frame: float | None,
    own_camera: bpy.types.Object | None,
    data: bytes | None,
    max_megapixels: float | None,
) -> Generator[float | None, None, BuiltTake]:
    """The work in small steps. Yields how much is done, or None where the slice should end: what follows
    is one long step. Every data-block goes into `made`."""
    # Read every model before anything is made: a missing file must not leave half a rig behind.
    models: dict[Side, HandModel] = {}
    wrists: dict[Side, Wrist] = {}
    warnings: list[str] = []
    for track in take.hands:
        loaded = load_model(model or take.model, track.side)
        warnings += _digest_warning(take, loaded)
        yield None
        models[track.side] = with_wrist(loaded, wrist)
        # A model without an edge where a piece of forearm could begin comes back as it is.
        wrists[track.side] = "open" if models[track.side] is loaded else wrist
        yield None
    shapes = [models[t.side].shaped(t.betas) for t in take.hands]
    timing = Timing() if match_scene else timing_in(scene, take, frame)
    check_range(take, timing)
    units = 1.0 / scene.unit_settings.scale_length
    work = _Work(take, models, pose_correctives)

    def keep(block: _T) -> _T:
        made.append(block)  # type: ignore[arg-type]
        return block

    stem = shortened_name(take.source.name, NAME_BYTES - len(".001"))
    collection = keep(bpy.data.collections.new(stem))
    name = collection.name
    yield None
    plate, plate_warnings = None, []
    if picture:
        plate, plate_warnings = yield from work.counting(loading_plate(take, timing, max_megapixels))
    if plate is not None:
        keep(plate.image)
    yield None
    camera = own_camera
    if camera is None:
        unmatched = None if match_scene else scene
        camera = keep(
            build_camera(named_after(name, "camera"), take, plate, scene=unmatched, units_per_metre=units)
        )
        keep(camera.data)
        collection.objects.link(camera)
    stage = []
    if render_setup and match_scene and own_camera is None:
        stage = set_up(scene, camera, take, plate)
        for thing in stage:
            keep(thing)
            keep(thing.data)
            made.extend(getattr(thing.data, "materials", ()))
            collection.objects.link(thing)

    hands = []
    for track, shaped in zip(take.hands, shapes, strict=True):
        model_of_side = models[track.side]
        armature = keep(build_armature(named_after(name, f"{track.side} hand"), shaped, track.side))
        keep(armature.data)
        armature.scale = (units, units, units)
        if own_camera is not None:
            put_before(armature, own_camera)
        describe(armature, take, track)
        frames = rest_frames(armature, track.side)
        yield work.done(1)
        mesh = keep(build_mesh(f"{armature.name} mesh", model_of_side, shaped))
        keep(mesh.data)
        made.extend(mesh.data.materials)
        mesh.parent = armature
        mesh.modifiers.new("Armature", "ARMATURE").object = armature
        yield work.done(1)
        if work.has_correctives(track):
            offsets = axes.corrective_offsets(model_of_side, frames)
            yield None
            for _ in adding_correctives(mesh, armature, track.side, offsets):
                yield work.done(0.3)
        keys = yield from work.counting(computing_keys(take, track, shaped, frames, timing))
        action = None
        for action in animating(armature, track, keys):
            if action not in made:
                keep(action)
            yield work.done(1)
        assert action is not None
        hands.append(BuiltHand(track.side, armature, mesh, action))

    if kept_here():
        packed = yield from work.counting(packing_take(take, data))
        yield None
        keep_packed(collection, take, packed)  # a copy of up to 20 MB
        yield None

    # From here on the artist sees it.
    describe_capture(collection, camera, timing)
    for index, hand in enumerate(hands):
        describe_hand(hand.armature, collection, take, index, wrists[hand.side])
    if own_camera is not None and plate is not None:
        warnings += _show_behind_own(own_camera, plate, take, scene)
    scene.collection.children.link(collection)
    if match_scene:
        if len(take.frame_numbers) > 1:  # one picture has no rate, and is no reason to shorten a timeline
            set_timing(scene, take)
        scene.frame_current = int(take.frame_numbers[0])
        if own_camera is None:
            frame_scene(scene, take)
            scene.camera = camera
            put_in_force(scene, stage)
        note_matched(scene, Footage.of_take(take, own_camera=own_camera is not None))
    for hand in hands:
        yield None
        collection.objects.link(hand.armature)
        collection.objects.link(hand.mesh)
        if bpy.context.scene == scene:
            bpy.context.view_layer.update()  # copies the whole action, which takes longest of all
    yield None
    if match_scene:
        scene.frame_set(int(take.frame_numbers[0]))
    return BuiltTake(collection, camera, tuple(hands), (*warnings, *plate_warnings))


class _Work:
    """How much of all steps is done, a curve being one."""

    def __init__(self, take: Take, models: dict[Side, HandModel], pose_correctives: bool) -> None:
        self._correctives = {
            side: pose_correctives and model.has_pose_blendshapes for side, model in models.items()
        }
        keys = 0.3 * 9 * NUM_JOINTS
        self._all = sum(CURVES + 3 + keys * self._correctives[t.side] for t in take.hands) or 1.0
        self._done = 0.0

    def has_correctives(self, track: HandTrack) -> bool:
        return self._correctives[track.side]

    def counting(self, steps: Generator[Any, None, _T]) -> Generator[float, None, _T]:
        """Go through steps that are not counted, as numbers are fast; returns what they return."""
        return retold(steps, lambda: self.done(0))

    def done(self, more: float) -> float:
        """Count a step; returns how much is done, 0..1."""
        self._done += more
        return min(1.0, self._done / self._all)


class _Watch:
    """Notices an undo, a redo and another file."""

    def __init__(self) -> None:
        self.changed = False

        @bpy.app.handlers.persistent
        def notice(*_args) -> None:
            self.changed = True

        self._notice = notice
        handlers = bpy.app.handlers
        self._lists = (handlers.undo_post, handlers.redo_post, handlers.load_post)

    def __enter__(self) -> _Watch:
        for handlers in self._lists:
            handlers.append(self._notice)
        return self

    def __exit__(self, *_error: object) -> None:
        for handlers in self._lists:
            if self._notice in handlers:
                handlers.remove(self._notice)


def _remove(made: Sequence[bpy.types.ID]) -> None:
    """Take away what is still there of what was made."""
    there = []
    for block in made:
        try:
            block.name  # noqa: B018  (it raises where the block is gone)
        except ReferenceError:
            continue
        there.append(block)
    bpy.data.batch_remove(there)


def _show_behind_own(camera: bpy.types.Object, plate: Plate, take: Take, scene: bpy.types.Scene) -> list[str]:
    """Put the picture behind the artist's own camera, unless that shows it already."""
    path = Path(take.source.files[0])
    for background in camera.data.background_images:
        shown = background.image
        if shown is not None and Path(bpy.path.abspath(shown.filepath)) == path.absolute():
            bpy.data.images.remove(plate.image)
            return []
    if not camera.data.is_editable:
        bpy.data.images.remove(plate.image)
        return [
            f"the camera {camera.name} is linked from another file, so no picture is shown behind the hands"
        ]
    show_behind(camera.data, plate, take, scene)
    return []


def _checked_scene(scene: bpy.types.Scene | None) -> bpy.types.Scene:
    """The scene that Blender has open is the one that is evaluated, and that has a current frame to show."""
    current = bpy.context.scene
    assert current is not None
    if scene is not None and scene != current:
        raise OptionError(
            f"the scene {scene.name!r} is not the one that is open ({current.name!r}); switch to it first"
        )
    return current


def _digest_warning(take: Take, model: HandModel) -> list[str]:
    expected = take.model_digests.get(model.side)
    if expected is None or expected == model.digest:
        return []
    return [
        f"the {model.side} hand was captured with another version of the hand model {model.name}: "
        "the rig's proportions may differ from the fit"
    ]
