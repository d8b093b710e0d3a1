"""From a take to a Blender scene, on one page."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import bpy

from handfit_core.errors import OptionError
from handfit_core.hand_model import HandModel, load_model
from handfit_core.skeleton import Side
from handfit_core.take import HandTrack, Take

from .animation import animate
from .armature import build_armature
from .camera import build_camera, frame_scene
from .correctives import add_correctives
from .mesh import build_mesh
from .plate import load_plate


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
) -> BuiltTake:
    """Build a take's hands, their animation and the camera that saw them, in a collection of their own.

    `scene` is the current one or None; it gets the take's frame rate, frame range, picture size and
    camera. `model` replaces `take.model`, for takes whose model file has moved. Building twice makes
    a second set and leaves the first alone. Raises HandModelError.
    """
    open_scene = _checked_scene(scene)
    # Read every model before anything is made: a missing file must not leave half a rig behind.
    models = {track.side: load_model(model or take.model, track.side) for track in take.hands}
    warnings = [w for track in take.hands for w in _digest_warning(take, models[track.side])]

    collection = bpy.data.collections.new(take.source.name)
    open_scene.collection.children.link(collection)
    name = collection.name
    plate, plate_warnings = load_plate(take) if picture else (None, [])
    camera = build_camera(f"{name} camera", take, plate)
    collection.objects.link(camera)

    hands = tuple(
        _build_hand(f"{name} {t.side} hand", take, t, models[t.side], collection, pose_correctives)
        for t in take.hands
    )
    _set_up(open_scene, take, camera)
    return BuiltTake(collection, camera, hands, (*warnings, *plate_warnings))


def set_timing(scene: bpy.types.Scene, take: Take) -> None:
    """Give the scene the take's frame rate and range."""
    # Blender keeps 29.97 as 30 / 1.001.
    nearest = max(1, round(take.fps))
    rate = Fraction(take.fps / nearest).limit_denominator(1001)
    scene.render.fps = nearest
    scene.render.fps_base = float(1 / rate)
    scene.frame_start = int(take.frame_numbers[0])
    scene.frame_end = int(take.frame_numbers[-1])


def _build_hand(
    name: str,
    take: Take,
    track: HandTrack,
    model: HandModel,
    collection: bpy.types.Collection,
    pose_correctives: bool,
) -> BuiltHand:
    """Armature, mesh bound to it, and action of one hand."""
    shaped = model.shaped(track.betas)
    armature = build_armature(name, shaped, track.side, collection.objects.link)
    mesh = build_mesh(f"{name} mesh", model, shaped)
    collection.objects.link(mesh)
    mesh.parent = armature
    modifier = mesh.modifiers.new("Armature", "ARMATURE")
    modifier.object = armature
    if pose_correctives and model.has_pose_blendshapes:
        add_correctives(mesh, armature, model)
    action = animate(armature, take, track, shaped)
    return BuiltHand(track.side, armature, mesh, action)


def _set_up(scene: bpy.types.Scene, take: Take, camera: bpy.types.Object) -> None:
    set_timing(scene, take)
    frame_scene(scene, take)
    scene.camera = camera
    scene.frame_set(scene.frame_start)


def _checked_scene(scene: bpy.types.Scene | None) -> bpy.types.Scene:
    """Bones can only be edited in the scene that Blender has open."""
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
