"""From a take to a Blender scene, on one page.

The scene is built in slices, so that a window stays alive meanwhile. Until the last of them nothing is
linked to the scene: nobody sees half a hand, nothing is evaluated or drawn twice, and an undo step that is
made meanwhile shows none. Between two slices only data-blocks are held, because Blender tells when those
are gone. There are no threads: while one runs Python, Blender may crash in operators and drivers that call
Python too (up to Python 3.11 it cannot tell which of its threads holds the interpreter).
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, TypeVar

import bpy
import numpy as np
from mathutils import Matrix

from handfit_core.common.errors import BuildInterrupted
from handfit_core.common.skeleton import NUM_JOINTS, NUM_KEYPOINTS, Side
from handfit_core.common.slices import map_yields, run_to_completion, slice_clock
from handfit_core.edit.corrections import Correction, CorrectionField
from handfit_core.hand_model import HandModel, axes, load_model
from handfit_core.hand_model.forearm import Wrist, with_wrist
from handfit_core.take import HandTrack, Take

from ..common.wording import NAME_BYTES, hand_part, named_after, shortened_name
from ..rigs.captured_hand import build_rig
from . import captures
from .arms import keying_arm
from .background import Plate, loading_plate, path_of
from .camera import build_camera, frame_scene, is_moved, put_before, show_behind
from .corrections import keep_field
from .keys import CURVES, animating, computing_keys
from .matching import Footage, note_matched
from .mesh import adding_correctives, build_mesh, follow_arm
from .render_setup import add_picture_plane, put_in_force, set_up
from .store import (
    describe_capture,
    describe_hand,
    has_properties,
    is_of_other_model,
    keep_take,
    keeping_take,
    timing_of,
)
from .timing import Timing, check_range, frame_rate, has_rate, in_scene, set_timing, view_timing

_T = TypeVar("_T")

_VIEW_DISPLAY_SIZE = 0.1
"""The size at which a second camera is drawn, as a share of Blender's usual one: either of two cameras may
stand in the other's picture, before the hand"""


@dataclass(frozen=True)
class BuiltHand:
    """One hand of a take in Blender."""

    side: Side
    armature: bpy.types.Object
    mesh: bpy.types.Object
    action: bpy.types.Action
    wrist: Wrist
    """How the mesh ends"""

    @property
    def meshes(self) -> tuple[bpy.types.Object, ...]:
        """Return the mesh objects that exporters write beside the hand's bones."""
        return (self.mesh,)


@dataclass(frozen=True)
class BuiltTake:
    """The hands, camera and warnings that `build_take` made; everything lies in `collection`."""

    collection: bpy.types.Collection
    camera: bpy.types.Object
    hands: tuple[BuiltHand, ...]
    warnings: tuple[str, ...]
    """Sentences for the user about what is not as it should be"""


@dataclass(frozen=True)
class BuildOptions:
    """The options by which a take is built into the scene."""

    model: str | None = None
    """The hand model, instead of `take.model`, for takes whose model file has moved; None: the take's own"""
    pose_correctives: bool = True
    """True if shape keys fill out bent joints, where the model has any"""
    picture: bool = True
    match_scene: bool = True
    """True if the scene gets the take's frame rate, frame range, picture size and camera; else it stays as it
    is, and the take starts at `frame`, at its rate"""
    in_front: bool = False
    """True if this becomes the active capture (`captures.show`), which hides the others"""
    render_setup: bool = True
    """True if a scene that is matched, or shows this in front, gets lights and the picture in its renders
    too"""
    wrist: Wrist | None = None
    """How the meshes end; None: by a cap, and by a forearm where a hand has an arm"""
    frame: float | None = None
    """The scene frame at which the take starts; None: the current one"""
    timing: Timing | None = None
    """Where the clip's frames lie in the scene's time; None: from `frame` on, at the clip's rate"""
    camera: bpy.types.Object | None = None
    """A camera that is there already: the hands hang on it, and its lens and the scene's size stay; None: one
    is built"""
    data: bytes | None = None
    """The bytes of the take's file, where the caller has them; None: the take is compressed anew"""
    max_megapixels: float | None = None
    """How large the picture behind the hands may be, in megapixels; None: as the preferences say"""


def build_take(take: Take, **options: Any) -> BuiltTake:
    """Build a take's hands, their animation and the camera that saw them, in a collection of their own.

    `options` are fields of `BuildOptions`. Hands are life-size in any unit of length: in scenes whose unit
    is not the metre their armatures are scaled. Building twice makes a second set and leaves the first alone.
    Raises HandModelError and OptionError.
    """
    return run_to_completion(building(take, BuildOptions(**options)))


def building(take: Take, how: BuildOptions = BuildOptions()) -> Generator[float, None, BuiltTake]:
    """Build a take as `build_take` does, in slices of some milliseconds. Yields how much is done, 0..1;
    returns what was made.

    Closing it early removes what it made. Raises BuildInterrupted where an undo, another file or a
    deletion took something away meanwhile: nothing is left of it, and it can be started again.
    """
    made: list[bpy.types.ID] = []
    finished = False
    watch = ChangeWatch()
    try:
        steps = _Build(made, take, bpy.context.scene, how).steps()
        done = 0.0
        while True:
            is_over = slice_clock()
            while not is_over():
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


class _Build:
    """A build in steps, each of them a method, and the results that the steps hand on to each other; every
    data-block goes into `made`."""

    def __init__(
        self, made: list[bpy.types.ID], take: Take, scene: bpy.types.Scene, how: BuildOptions
    ) -> None:
        self.made, self.scene, self.how = made, scene, how
        self.take = self.captured = take
        self.units = 1.0 / scene.unit_settings.scale_length
        self.unmatched = None if how.match_scene else scene
        self.models: dict[Side, HandModel] = {}
        self.warnings: list[str] = []
        self.plate: Plate | None = None
        self.view: tuple[bpy.types.Object, Take, Plate | None] | None = None
        """The camera of the second view, its clip, and the picture behind it"""
        self.stage: list[bpy.types.Object] = []
        self.hands: list[BuiltHand] = []
        self._done = 0.0

    def steps(self) -> Generator[float | None, None, BuiltTake]:
        """Build the take. Yields how much is done, or None where the slice should end: the step that follows
        is a long one."""
        # Read every model before anything is made: a missing file must not leave half a rig behind.
        yield from self._read_models()
        self._choose_times()
        self._add_collection()
        yield None
        self.plate = yield from self._load_plate(self.captured, self.clip)
        yield None
        name = self.collection.name
        self.camera = self.how.camera or self._add_camera(name, self.take, self.plate)
        if self.captured.cameras is not None:
            yield from self._add_second_view()
        self._add_render_setup()
        yield from self._add_hands()
        yield from self._keep_takes()
        yield None
        # From here on the artist sees it.
        self._describe()
        self._show()
        yield from self._link_hands()
        yield None
        if self.how.match_scene:
            self.scene.frame_set(int(self.take.frame_numbers[0]))
        return BuiltTake(self.collection, self.camera, tuple(self.hands), tuple(self.warnings))

    def done(self, more: float) -> float:
        """Count a step, a curve being one; return how much of all is done, 0..1."""
        self._done += more
        of_correctives = 0.3 * 9 * (NUM_JOINTS - 1)
        tracks = self.take.hands
        whole = sum(CURVES + 3 + of_correctives * self._has_correctives(track.side) for track in tracks)
        return min(1.0, self._done / (whole or 1.0))

    def counting(self, steps: Generator[Any, None, _T]) -> Generator[float, None, _T]:
        """Go through steps whose numbers are not counted, since they are fast; return their result."""
        return map_yields(steps, lambda: self.done(0))

    def _has_correctives(self, side: Side) -> bool:
        return self.how.pose_correctives and self.models[side].has_pose_blendshapes

    def _keep(self, block: _T) -> _T:
        self.made.append(block)  # type: ignore[arg-type]
        return block

    def _read_models(self) -> Generator[None, None, None]:
        take = self.captured
        for track in take.hands:
            loaded = load_model(self.how.model or take.model, track.side)
            if is_of_other_model(take, track, loaded):
                self.warnings.append(
                    f"the {track.side} hand was captured with another version of the hand model "
                    f"{loaded.name}, whose joints lie elsewhere: it may differ from the fit; capture it "
                    "again to be exact"
                )
            yield None
            self.models[track.side] = loaded
            with_wrist(loaded, self._wrist(track))  # which is cached
            yield None

    def _wrist(self, track: HandTrack) -> Wrist:
        """Return how a hand's mesh ends. A model without an edge where a cap or a forearm could begin stays
        open."""
        wrist = self.how.wrist or ("cap" if track.arm is None else "forearm")
        loaded = self.models[track.side]
        return "open" if with_wrist(loaded, wrist) is loaded else wrist

    def _choose_times(self) -> None:
        self.timing = self.clip = self.how.timing or Timing()
        if not self.how.match_scene and self.how.timing is None:
            self.take, self.timing, self.clip = in_scene(self.scene, self.captured, self.how.frame)
        check_range(self.take, self.timing)

    def _add_collection(self) -> None:
        program = f" ({self.take.program})" if self.take.program else ""
        stem = shortened_name(self.take.source.name + program, NAME_BYTES - len(".001"))
        self.collection = self._keep(bpy.data.collections.new(stem))

    def _load_plate(self, take: Take, timing: Timing) -> Generator[float, None, Plate | None]:
        if not self.how.picture:
            return None
        loading = loading_plate(take, timing, self.how.max_megapixels)
        plate, warnings = yield from self.counting(loading)
        self.warnings += warnings
        if plate is not None:
            self._keep(plate.image)
        return plate

    def _add_camera(self, name: str, take: Take, plate: Plate | None) -> bpy.types.Object:
        name = named_after(name, "camera")
        camera = build_camera(name, take, plate, scene=self.unmatched, units_per_metre=self.units)
        self._link(camera)
        return camera

    def _link(self, obj: bpy.types.Object) -> None:
        self.made += [obj, obj.data]
        self.made.extend(getattr(obj.data, "materials", ()))
        self.collection.objects.link(obj)

    def _add_second_view(self) -> Generator[float, None, None]:
        """Build the second camera, where it stood, before its own picture; it hangs on the artist's camera
        where the hands do."""
        cameras, view = self.captured.cameras, self.captured.view(1)
        assert cameras is not None
        timing = view_timing(self.captured, self.clip)
        check_range(view, timing)
        plate = yield from self._load_plate(view, timing)
        if plate is not None and cameras.views[0].mirrored:
            plate = plate.mirrored()
        camera = self._add_camera(view.source.name, view, plate)
        place = axes.camera_in_world(cameras.rotation[1], cameras.translation[1])
        place[:3, 3] *= self.units
        camera.matrix_basis = Matrix(place.tolist())
        if self.how.camera is not None:
            put_before(camera, self.how.camera)
        for shown in (camera, self.camera) if self.how.camera is None else (camera,):
            shown.data.display_size *= _VIEW_DISPLAY_SIZE
        self.view = camera, view, plate

    def _add_render_setup(self) -> None:
        how = self.how
        if not how.render_setup or not (how.match_scene or how.in_front) or how.camera is not None:
            return
        self.stage = set_up(self.scene, self.collection.name, self.camera, self.take, self.plate)
        if self.view is not None:
            camera, view, plate = self.view
            if plate is not None:
                # First, so that where renders fall back to the last one's camera it is the first view's.
                self.stage.insert(0, add_picture_plane(view.source.name, camera, view, plate))
                self.stage[0].hide_render = True
        for thing in self.stage:
            self._link(thing)

    def _add_hands(self) -> Generator[float | None, None, None]:
        for track in self.take.hands:
            others = sum(hand.side == track.side for hand in self.hands)
            name = named_after(self.collection.name, hand_part(track.side, others))
            hand = yield from self.build_hand(track, name)
            self.hands.append(hand)

    def build_hand(self, track: HandTrack, name: str) -> Generator[float | None, None, BuiltHand]:
        wrist = self._wrist(track)
        model = with_wrist(self.models[track.side], wrist)
        shaped = model.shaped(track.betas)
        rig = build_rig(name, shaped, track.side)
        armature = rig.armature
        self.made += [armature, armature.data]
        armature.scale = (self.units,) * 3
        if self.how.camera is not None:
            put_before(armature, self.how.camera)
        if track.arm is not None:
            rig.add_arm(track.arm.lengths)
        rest = rig.rest
        yield self.done(1)
        mesh = build_mesh(f"mesh of {armature.name}", model, shaped, rig)
        follow_arm(mesh, model, armature)
        self.made += [mesh, mesh.data, *mesh.data.materials]
        yield self.done(1)
        if self._has_correctives(track.side):
            offsets = axes.corrective_offsets(model, rest.frames)
            yield None
            for _ in adding_correctives(mesh, rig, offsets):
                yield self.done(0.3)
        frames = self.timing.scene_frames(self.take.frame_numbers)
        keys = yield from self.counting(computing_keys(track, shaped, rest, frames))
        action = None
        for action in animating(rig, keys):
            if action not in self.made:
                self.made.append(action)
            yield self.done(1)
        assert action is not None
        if track.arm is not None:
            yield from self.counting(keying_arm(rig, track.arm, frames))
        return BuiltHand(track.side, armature, mesh, action, wrist)

    def _keep_takes(self) -> Generator[float | None, None, None]:
        """Have the collection keep the take as captured, and beside it the one that was retimed."""
        retimed, data = self.take is not self.captured, self.how.data
        keeping = keeping_take(self.collection, self.captured, data, captured=retimed)
        yield from self.counting(keeping)
        if retimed:
            yield None
            yield from self.counting(keeping_take(self.collection, self.take))

    def _describe(self) -> None:
        placed = self.how.timing is not None  # it plays with the artist's plate, at any rate
        rate = 0.0 if placed else _rate(self.scene, self.captured, self.how.match_scene)
        describe_capture(self.collection, self.camera, self.timing, rate)
        if self.view is not None and has_properties():
            self.collection.manient.view_camera = self.view[0]
        for index, hand in enumerate(self.hands):
            _describe_hand(hand, self.collection, self.take, index)

    def _show(self) -> None:
        """Link the collection to the scene, which gets the take's times, size and camera where it is
        matched."""
        how, scene, take = self.how, self.scene, self.take
        if how.camera is not None and self.plate is not None:
            self.warnings += self._show_behind_own(how.camera, self.plate)
        captures.add(scene, self.collection, in_front=how.in_front)
        if how.match_scene:
            if len(take.frame_numbers) > 1:  # one picture has no rate, and is no reason to shorten a timeline
                set_timing(scene, take)
            scene.frame_current = int(take.frame_numbers[0])
            if how.camera is None:
                frame_scene(scene, take)
                scene.camera = self.camera
            note_matched(scene, Footage.of_take(take, own_camera=how.camera is not None))
        if self.stage:
            put_in_force(scene, self.stage)

    def _show_behind_own(self, camera: bpy.types.Object, plate: Plate) -> list[str]:
        """Put the picture behind the artist's own camera, unless that shows it already."""
        path = Path(self.take.source.files[0])
        for background in camera.data.background_images:
            if background.image is not None and path_of(background.image) == path.absolute():
                bpy.data.images.remove(plate.image)
                return []
        if not camera.data.is_editable:
            bpy.data.images.remove(plate.image)
            linked = f"the camera {camera.name} is linked from another file"
            return [f"{linked}, so no picture is shown behind the hands"]
        show_behind(camera.data, plate, self.take, self.scene)
        if has_properties():
            self.collection.manient.plate = plate.image
        return []

    def _link_hands(self) -> Generator[None, None, None]:
        for hand in self.hands:
            yield None
            self.collection.objects.link(hand.armature)
            self.collection.objects.link(hand.mesh)
            if bpy.context.scene == self.scene:
                bpy.context.view_layer.update()  # copies the whole action, which takes longest of all


def add_last_hand(collection: bpy.types.Collection, take: Take) -> BuiltHand:
    """Build the last hand of a take into the collection of the others, which keeps the take from then on.

    It stands before the capture's camera, wherever that has been moved. Raises HandModelError.
    """
    track = take.hands[-1]
    camera = collection.manient.camera
    if camera is not None and camera.name in collection.objects and not is_moved(camera):
        camera = None
    others = sum(hand.side == track.side for hand in take.hands[:-1])
    name = named_after(collection.name, hand_part(track.side, others))
    build = _Build([], replace(take, hands=(track,)), bpy.context.scene, BuildOptions(camera=camera))
    build.models[track.side], build.timing = load_model(take.model, track.side), timing_of(collection)
    try:
        hand = run_to_completion(build.build_hand(track, name))
    except BaseException:
        _remove(build.made)
        raise
    keep_take(collection, take)
    _describe_hand(hand, collection, take, len(take.hands) - 1)
    collection.objects.link(hand.armature)
    collection.objects.link(hand.mesh)
    return hand


def _describe_hand(hand: BuiltHand, collection: bpy.types.Collection, take: Take, index: int) -> None:
    """Note on the armature which hand it is, and the points that a person has put in place or made to touch,
    so that they can be dragged on."""
    describe_hand(hand.armature, collection, take, index, hand.wrist)
    if not has_properties():
        return
    track = take.hands[index]
    count = len(take.frame_numbers)
    nothing = np.full((count, NUM_KEYPOINTS, 2), np.nan)
    placed = nothing if track.placed is None else track.placed
    touches = nothing[..., 0] if track.touches is None else track.touches
    kept: dict[float, Correction] = {}
    own = np.isfinite(placed).all(axis=2) | np.isfinite(touches)
    for row in np.flatnonzero(own.any(axis=1) & track.present).tolist():
        kept[int(take.frame_numbers[row])] = Correction(
            {k: (x, y) for k, (x, y) in enumerate(placed[row].tolist()) if isfinite(x + y)},
            touches={k: int(other) for k, other in enumerate(touches[row].tolist()) if isfinite(other)},
        )
    if kept:
        keep_field(hand.armature, CorrectionField(kept))


_changes = 0
"""How many undos, redos and other files there were since the add-on was registered"""


def _count_change(*_args) -> None:
    global _changes
    _changes += 1


HANDLERS = dict.fromkeys(("undo_post", "redo_post", "load_post"), _count_change)


class ChangeWatch:
    """Notices an undo, a redo and another file from now on."""

    def __init__(self) -> None:
        self._before = _changes

    @property
    def changed(self) -> bool:
        """True if there was an undo, a redo or a file load since."""
        return _changes != self._before


def _remove(made: Sequence[bpy.types.ID]) -> None:
    """Remove those data-blocks of `made` that are still there."""
    there = []
    for block in made:
        try:
            block.name  # noqa: B018  (it raises where the block is gone)
        except ReferenceError:
            continue
        there.append(block)
    bpy.data.batch_remove(there)


def _rate(scene: bpy.types.Scene, take: Take, matched: bool) -> float:
    """Return the frames per second of the scene at which the take plays as fast as it was filmed; 0 for a
    take that has no rate, or does not move."""
    if not has_rate(take) or len(take.frame_numbers) == 1:
        return 0.0
    return take.fps if matched else frame_rate(scene)
