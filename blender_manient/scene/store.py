"""The take kept in the .blend, and which hand is which.

A built take's collection keeps the take itself as text, so that corrections, confidence and exports work
in a file that was moved, sent or opened years later. Without the add-on's properties (headless scripts that
never registered it) nothing is kept and no hand is known.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
from collections import OrderedDict
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from handfit_core.common.batch import scatter
from handfit_core.common.errors import HandModelError, TakeError
from handfit_core.common.files import storable
from handfit_core.common.skeleton import Side
from handfit_core.common.slices import run_to_completion
from handfit_core.hand_model import HandModel, ShapedHand
from handfit_core.hand_model.axes import MIRROR_X, mirrored_pose
from handfit_core.hand_model.files import kept_model
from handfit_core.hand_model.forearm import Wrist, with_wrist
from handfit_core.hand_model.motion import HandMotion
from handfit_core.media.settings import MEDIA
from handfit_core.take import HandTrack, Take

from ..rigs import rig_of
from ..rigs.rig import Rig
from .background import shown_number
from .keys import nearest
from .timing import Timing, view_timing

_CACHED = 8
"""How many takes are kept decoded"""
_CHUNK = 3 << 18
"""How many bytes are encoded at once (a multiple of 3), in some milliseconds"""

_SAME_JOINTS = 1e-3
"""Metres within which the joints of two models count as equal"""

_BEYOND = 2.0**31
"""The frame number from which on Blender raises an error instead of taking it"""

_cache: OrderedDict[str, Take | TakeError] = OrderedDict()
"""By the digest of a take's text, the take that it decodes to, or the error. Undo and other files change the
digest, never what belongs to it"""


@dataclass(frozen=True, eq=False)
class CapturedHand:
    """A hand in the scene and what it was made from."""

    armature: bpy.types.Object
    mesh: bpy.types.Object | None
    """The hand's mesh object; None where the artist deleted it"""
    camera: bpy.types.Object | None
    """The camera that saw the hand; None where the artist deleted it"""
    collection: bpy.types.Collection
    """The collection that keeps the hand's take"""
    take: Take
    track: HandTrack
    index: int
    """the hand's index in `take.hands`"""
    side: Side
    held: tuple[bpy.types.Object, ...] = ()
    """Objects that are to be exported with the hand"""

    @property
    def meshes(self) -> tuple[bpy.types.Object, ...]:
        """Return the objects that exporters write beside the hand's bones."""
        return self.held if self.mesh is None else (self.mesh, *self.held)

    @property
    def rig(self) -> Rig:
        """Return the bones of the armature, as a rig."""
        return rig_of(self.armature, self.side)

    @property
    def betas(self) -> np.ndarray:
        """Return the shape that the hand's sliders say: (10,) coefficients of the hand model."""
        return np.array(self.armature.manient.betas, dtype=np.float64)

    def shaped(self) -> ShapedHand:
        """Return the hand's model in the shape of `betas`. Raises HandModelError."""
        return self.model().shaped(self.betas)

    def model(self) -> HandModel:
        """Return the model that the hand was captured with. Raises HandModelError."""
        return kept_model(self.take.model, self.side)

    def to_bones(self, motion: HandMotion, wrist: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return any hand's motion about this one's bones: quaternions (T, 16, 4) and wrist locations (T, 3)
        in metres, NaN in frames without a hand; mirrored at x = 0 where it is of the other side.

        Fingers get its rotations, the wrist its place. `wrist` (3,) metres in the model frame is where that
        lies before it is moved; None: where this hand's model has it in the motion's shape. Raises
        HandModelError.
        """
        there, shaped = motion.present, self.shaped()
        if wrist is None:
            own = kept_model(self.take.model, motion.side).shaped(motion.betas)
            wrist = np.asarray(own.joints[0])
        orient, pose, transl = (np.asarray(rows[there], dtype=np.float64) for rows in motion.pose)
        place = wrist + transl
        if motion.side != self.side:
            orient, pose = mirrored_pose(orient, pose)
            place = place @ MIRROR_X
        bones = self.rig.to_bones(shaped, orient, pose, place - shaped.joints[0])
        quats, locations = (scatter(rows, there, len(there)) for rows in bones)
        return quats, locations

    def is_of_other_model(self) -> bool:
        """True if the model's joints lie elsewhere now than in the capture; False where the model cannot be
        read."""
        try:
            return is_of_other_model(self.take, self.track, self.model())
        except HandModelError:
            return False


def is_of_other_model(take: Take, track: HandTrack, model: HandModel) -> bool:
    """True if a take's hand has other joints than this model; versions may differ in their skin alone."""
    if take.model_digests.get(model.side) in (None, model.digest):
        return False
    row = int(np.argmax(track.present))
    points = model.keypoints(track.betas, track.global_orient[row], track.hand_pose[row], track.transl[row])
    return bool(np.abs(points - track.joints_3d[row]).max() >= _SAME_JOINTS)


def keeping_take(
    collection: bpy.types.Collection, take: Take, data: bytes | None = None, *, captured: bool = False
) -> Generator[None, None, None]:
    """Keep a take in its collection, in place of the one that is there, in small steps. `data`: the bytes of
    its file, where they are at hand; else the first step compresses the take, which for 10 000 frames of two
    hands takes half a second. `captured`: it is kept beside the one that was retimed from it. Does nothing
    where nothing is kept."""
    if not has_properties():
        return
    data = take.to_bytes(compact=True) if data is None else data
    texts, fingerprint = [], hashlib.sha256()
    for start in range(0, len(data), _CHUNK):
        chunk = data[start : start + _CHUNK]
        fingerprint.update(chunk)
        texts.append(base64.b64encode(chunk).decode("ascii"))
        yield
    text, digest = "".join(texts), fingerprint.hexdigest()[:32]
    collection.manient.is_capture = True
    if captured:
        collection.manient.source_take, collection.manient.source_digest = text, digest
    else:
        collection.manient.take, collection.manient.digest = text, digest
    _remember(digest, take)


def keep_take(collection: bpy.types.Collection, take: Take) -> None:
    """Keep a take in its collection at once, as `keeping_take` does in steps."""
    run_to_completion(keeping_take(collection, take))


def kept_take(collection: bpy.types.Collection) -> Take:
    """Return the take that a collection keeps, decoded once. Raises TakeError."""
    if not has_properties() or not collection.manient.digest:
        raise TakeError(
            f"the collection {collection.name} keeps no take, so its hands cannot be refined; import the "
            "take file, or capture again"
        )
    return _read(collection, "take", collection.manient.digest)


def captured_take(collection: bpy.types.Collection) -> Take:
    """Return the take as it was captured, at the clip's own rate: the kept one, unless that is retimed. Hands
    that were added or mirrored since are in the kept one alone. Raises TakeError."""
    kept = collection.manient
    if has_properties() and kept.source_digest:
        return _read(collection, "source_take", kept.source_digest)
    return kept_take(collection)


def captured_hands(scene: bpy.types.Scene, *, shown: bool = False) -> list[bpy.types.Object]:
    """Return the armatures of a scene's captured hands, by the names of their captures and their own; with
    `shown` without those of hidden captures. Decodes nothing."""
    if not has_properties():
        return []
    hands = [o for o in scene.objects if o.type == "ARMATURE" and o.manient.is_hand]
    hands = [o for o in hands if not (shown and is_in_hidden_capture(o))]
    return sorted(hands, key=lambda o: (o.manient.capture.name if o.manient.capture else "", o.name))


def is_in_hidden_capture(obj: bpy.types.Object) -> bool:
    """True if an object is in hidden captures only (`captures.hide_others`)."""
    return all(c.manient.is_capture and c.hide_viewport for c in obj.users_collection)


def hand_of(obj: bpy.types.Object) -> CapturedHand | None:
    """Return the captured hand that an armature or its mesh belongs to.

    None for all other objects, and for hands whose take is not there, as of ones that were copied to another
    file without their collection. `kept_take` says what is wrong. None also for one whose shape or place is
    not finite, which only a damaged or hostile file holds.
    """
    armature = _armature_of(obj)
    if armature is None:
        return None
    collection = armature.manient.capture
    if collection is None or not np.all(np.isfinite([*armature.manient.betas, *armature.manient.origin])):
        return None
    try:
        take = kept_take(collection)
    except TakeError:
        return None
    index, side = armature.manient.track, armature.manient.side
    if not 0 <= index < len(take.hands) or take.hands[index].side != side:
        return None
    camera = collection.manient.camera
    if camera is not None and camera.type != "CAMERA":  # any script, or file, can name another object
        camera = None
    return CapturedHand(
        armature,
        _mesh_of(armature, take, side),
        camera if camera is not None and camera.users_collection else None,  # deleted ones live on
        collection,
        take,
        take.hands[index],
        index,
        take.hands[index].side,
    )


def active_hand(context: bpy.types.Context) -> CapturedHand | None:
    """Return the captured hand that the artist works on: the active object's, else the only one that is
    shown."""
    if context.active_object is not None:
        hand = hand_of(context.active_object)
        if hand is not None:
            return hand
    armatures = captured_hands(context.scene, shown=True)
    return hand_of(armatures[0]) if len(armatures) == 1 else None


def captures_of(
    context: bpy.types.Context, kind: str, files: Sequence[str]
) -> Iterator[bpy.types.Collection]:
    """Yield the scene's captures of a source: that of the active hand before others, newer ones before older
    ones. Raises TakeError."""
    hand = active_hand(context)
    first = [hand.collection] if hand is not None else []
    for capture in [*first, *reversed(context.scene.collection.children_recursive)]:
        if capture.manient.is_capture:
            took = kept_take(capture).source
            if took.kind == kind and set(took.files) <= set(files):
                yield capture


def attached_objects(hand: CapturedHand) -> list[bpy.types.Object]:
    """Return the other objects that hang on the hand or are deformed by it, by name: rings, gloves, another
    mesh of its own, what it holds."""
    armature = hand.armature
    others = [
        o
        for o in bpy.data.objects
        if o.parent == armature
        or is_deformed_by(o, armature)
        or any(c.type == "CHILD_OF" and c.target == armature for c in o.constraints)
    ]
    return sorted((o for o in others if o != hand.mesh and o.users_collection), key=lambda o: o.name)


def rows_at(collection: bpy.types.Collection, take: Take, frames: np.ndarray) -> np.ndarray:
    """Return the rows (N,) of the take, as indices, that scene frames (N,) show; -1 for frames that lie
    between rows."""
    timing = timing_of(collection)
    numbers = np.asarray(take.frame_numbers, dtype=np.float64)
    wanted = timing.source_frames(frames)
    rows, _ = nearest(numbers, wanted)
    # Retimed, a scene frame may lie between two rows that both are near.
    near = 0.5 * max(1.0, 1.0 / (abs(timing.scale) or 1.0)) + 1e-3
    return np.where(np.abs(numbers[rows] - wanted) <= near, rows, -1)


def timing_of(collection: bpy.types.Collection) -> Timing:
    """Return where the collection's take lies in its scene's time; on its own frames, where the file names a
    place that no timeline reaches."""
    offset, scale = collection.manient.frame_offset, collection.manient.frame_scale
    farthest = abs(offset) + abs(scale) * MEDIA.max_frame_number
    return Timing(offset, scale) if scale and farthest < _BEYOND else Timing()


def clip_timing(collection: bpy.types.Collection) -> Timing:
    """Return where the frames of the captured clip lie in its scene's time; between whole frames, where it is
    retimed. Raises TakeError."""
    rows, take, captured = timing_of(collection), kept_take(collection), captured_take(collection)
    if captured is take:
        return rows
    scale, number = take.fps / captured.fps, int(captured.frame_numbers[0])
    first = float(rows.scene_frames(take.frame_numbers[:1])[0])
    return Timing(first - scale * number, scale)


def row_of_view(collection: bpy.types.Collection, frame: float) -> int | None:
    """Return the row, among the frames of a capture's second view, of the picture that its plate shows on a
    scene frame; None where the clip has none. Raises TakeError."""
    captured = captured_take(collection)
    view, timing = captured.view(1), view_timing(captured, clip_timing(collection))
    rows = np.flatnonzero(view.frame_numbers == shown_number(view, timing, int(np.floor(frame + 1e-3))))
    return int(rows[0]) if len(rows) else None


def scene_frames(collection: bpy.types.Collection, take: Take) -> np.ndarray:
    """Return the scene frames (T,) of the take's rows; they may lie between whole ones."""
    return timing_of(collection).scene_frames(take.frame_numbers)


def has_properties() -> bool:
    """True if the add-on's properties exist, to keep anything in."""
    return hasattr(bpy.types.Collection, "manient")


def describe_capture(
    collection: bpy.types.Collection, camera: bpy.types.Object | None, timing: Timing, rate: float = 0.0
) -> None:
    """Note on a collection where its take lies in the scene, which camera saw it, and at how many frames per
    second of the scene it plays as fast as it was filmed (0: it has no rate)."""
    if has_properties():
        collection.manient.camera = camera
        collection.manient.frame_offset = timing.offset
        collection.manient.frame_scale = timing.scale
        collection.manient.scene_rate = rate


def describe_hand(
    armature: bpy.types.Object, collection: bpy.types.Collection, take: Take, index: int, wrist: Wrist
) -> None:
    """Note on an armature which hand of which take it is; its mesh is there already and ends in `wrist`.

    Custom properties say where the hand comes from, and are exported with it.
    """
    track = take.hands[index]
    armature["side"] = track.side
    armature["betas"] = [float(b) for b in track.betas]
    armature["model"] = storable(take.model)
    armature["solver"] = take.solver
    armature["source"] = storable(take.source.files[0])
    if has_properties():
        hand = armature.manient
        # The shape first: as long as this is no captured hand, its change rebuilds nothing.
        hand.betas = armature["betas"]
        hand.wrist = wrist
        hand.forearm = wrist == "forearm"
        hand.side = track.side
        hand.capture = collection
        hand.mesh = next(iter(_deformed_by(armature)), None)
        hand.track = index
        hand.is_hand = True


def _armature_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    if not has_properties():
        return None
    for candidate in (obj, obj.parent):
        if candidate is not None and candidate.type == "ARMATURE" and candidate.manient.is_hand:
            return candidate
    return None


def _mesh_of(armature: bpy.types.Object, take: Take, side: Side) -> bpy.types.Object | None:
    """Return the hand's own mesh, which the artist may have deleted, among all that may hang on the
    armature."""
    marked = armature.manient.mesh
    # A copy of the armature alone still names the original's mesh, and a mesh that was deleted in the
    # viewport lives on as long as something names it.
    own = marked is not None and (marked.parent == armature or is_deformed_by(marked, armature))
    if marked is not None and own and marked.users_collection:
        return marked
    found = [o for o in _deformed_by(armature) if o.users_collection]
    if found:  # a copy of the hand's mesh, or only a glove over it
        with contextlib.suppress(HandModelError):
            model = kept_model(take.model, side)
            counts = {len(m.v_template) for m in (model, with_wrist(model, "cap"))}
            return next((o for o in found if len(o.data.vertices) in counts), None)
    return None


def _deformed_by(armature: bpy.types.Object) -> list[bpy.types.Object]:
    return [o for o in armature.children if o.type == "MESH" and is_deformed_by(o, armature)]


def is_deformed_by(obj: bpy.types.Object, armature: bpy.types.Object) -> bool:
    """True if a modifier of the object follows the armature."""
    return any(m.type == "ARMATURE" and m.object == armature for m in obj.modifiers)


def _read(collection: bpy.types.Collection, name: str, digest: str) -> Take:
    found = _cache.get(digest)
    if found is None:  # the text of a long take is not read in every frame
        found = _decoded(collection, getattr(collection.manient, name), digest)
        _remember(digest, found)
    if isinstance(found, TakeError):
        raise found
    return found


def _decoded(collection: bpy.types.Collection, text: str, digest: str) -> Take | TakeError:
    where = f"the take in the collection {collection.name}"
    try:
        data = base64.b64decode(text, validate=True)
    except ValueError:
        data = b""
    if hashlib.sha256(data).hexdigest()[:32] != digest:
        return TakeError(f"{where} is damaged; import the take file, or capture again")
    try:
        return Take.from_bytes(data, where=where)
    except TakeError as error:
        return error


def _remember(digest: str, take: Take | TakeError) -> None:
    _cache[digest] = take
    _cache.move_to_end(digest)
    while len(_cache) > _CACHED:
        _cache.popitem(last=False)
