"""What the add-on keeps in a .blend: the panel's settings, captured hands and their takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import bpy
from bpy.props import (
    BoolProperty,
    BoolVectorProperty,
    EnumProperty,
    FloatProperty,
    FloatVectorProperty,
    IntProperty,
    IntVectorProperty,
    PointerProperty,
    StringProperty,
)

from handfit_core.capturing.options import LIVE_OPTIONS, OPTIONS, Option
from handfit_core.common.errors import HandfitError
from handfit_core.common.skeleton import NUM_BETAS, NUM_JOINTS
from handfit_core.fit.solvers import SOLVERS
from handfit_core.media.camera_names import cameras
from handfit_core.media.lenses import saved_lenses

from ..common.preferences import PRESETS, notifier
from ..exporters import EXPORTERS
from ..exporters import PRESETS as PROGRAMS
from ..scene.matching import CHOICES
from ..scene.poses import pose_items
from ..scene.simplify import PARTS
from ..scene.spans import SCOPES
from ..scene.transfer_options import OVERRIDABLE, transfer_properties
from .hand_table import ManientHandTable

# Plug-ins may import anything, which Blender's process is to be spared.
EXPERIMENTS = tuple((name, s.title, s.description) for name, s in SOLVERS.built_in().items() if s.slow)


SIDE_ITEMS = (("left", "Left", "The person's left hand"), ("right", "Right", "The person's right hand"))

MATCHING: Any = {
    "name": "Scene",
    "description": "What becomes of the scene's frame rate, frame range, size, camera, lights and colors",
    "items": CHOICES,
    "default": "AUTO",
}
POSE_CORRECTIVES: Any = {
    "name": "Pose Correctives",
    "description": "Shape keys that fill out bent joints, for hand models that have them",
    "default": True,
}
BLEND: Any = {
    "name": "Blend",
    "description": "How far from the present pose to the chosen one",
    "default": 1.0,
    "min": 0.0,
    "max": 1.0,
    "subtype": "FACTOR",
}


def _lens_names() -> list[str]:
    try:
        return [*saved_lenses()]
    except HandfitError:  # which the capture tells of
        return []


choices_of_option: dict[str, Callable[[], list[str]]] = {"measured_lens": _lens_names}
"""By the name of an option, the function that returns its choices; modules add theirs when they are
registered"""


def _found(option: str) -> Callable[[Any, bpy.types.Context, str], list[str]]:
    """Return a text field's `search` function: it gives the option's choices that contain what is typed."""
    return lambda _settings, _context, typed: [
        name for name in choices_of_option.get(option, list)() if typed.lower() in name.lower()
    ]


EXPORT_FORMATS = tuple(
    (e.name, e.label, e.description) for e in EXPORTERS.values() if e.writes != "collection"
)


def described(option: Option, more_help: str = "") -> str:
    """Return a property's description: the option's help, and more."""
    return option.help[0].upper() + option.help[1:] + more_help


def option_property(name: str, units: float = 1.0, more_help: str = "") -> dict[str, Any]:
    """Return a property's description, default and range, as the capture's option of that name has them.

    `units`: the panel's units in one of the option's; `more_help` is added to the description."""
    option = OPTIONS[name]
    shown: dict[str, Any] = {"description": described(option, more_help)}
    if option.default is not None:
        shown["default"] = option.default
    if math.isfinite(option.most):
        shown |= {"min": option.least * units, "max": option.most * units}
    return shown


def has_surface(obj: bpy.types.Object) -> bool:
    """True if an object is of a type that a hand may hold."""
    return obj.type in ("MESH", "CURVE", "SURFACE", "FONT", "META")


def _is_character(_group: Any, obj: bpy.types.Object) -> bool:
    return obj.type == "ARMATURE" and not obj.manient.is_hand


class ManientLiveHand(bpy.types.PropertyGroup):
    """One of the person's hands before a live source."""

    use: BoolProperty(name="Follow", description="Follow this hand of the person", default=True)
    character: PointerProperty(
        name="Moves",
        description="The character whose hand it moves; empty: an open hand that is made for it",
        type=bpy.types.Object,
        poll=_is_character,
    )
    other_side: BoolProperty(
        name="Other Hand", description="Move the character's other hand instead, mirrored", default=False
    )


class ManientLive(bpy.types.PropertyGroup):
    """Scene.manient.live: the panel Live."""

    source: StringProperty(
        name="Source",
        description="A camera by number or name, the address of a network camera or phone, or file:CLIP to "
        "play a clip",
        default="0",
        search=lambda _group, _context, typed: [
            name for _, name in cameras() if typed.lower() in name.lower() or typed.isdecimal()
        ],
        search_options={"SUGGESTION"},
    )
    size: EnumProperty(
        name="Size",
        description=described(LIVE_OPTIONS["size"], "; pictures of other sizes are followed, too"),
        items=tuple(
            (size, size.replace("x", " × "), "Pixels") for size in ("640x480", "1280x720", "1920x1080")
        ),
        default=LIVE_OPTIONS["size"].by_default,
    )
    fps: IntProperty(
        name="Rate",
        description=described(LIVE_OPTIONS["fps"]),
        default=int(LIVE_OPTIONS["fps"].default),
        min=1,
        max=240,
    )
    mirror: BoolProperty(
        name="Mirror Picture",
        description="Show the small picture as a mirror does; hands and recordings stay as they are",
        default=True,
    )
    left: PointerProperty(type=ManientLiveHand)
    right: PointerProperty(type=ManientLiveHand)
    countdown: IntProperty(
        name="Countdown", description="Seconds from Record to the first frame", default=3, min=0, max=20
    )
    play: BoolProperty(
        name="Play Scene", description="Play the scene's animation while recording", default=False
    )
    folder: StringProperty(
        name="Folder",
        description="Where recordings and their takes are written; of a .blend that was never saved: in a "
        "folder of the add-on's",
        subtype="DIR_PATH",
        default="//live",
    )


class ManientSettings(bpy.types.PropertyGroup):
    """Scene.manient: what the panel shows and the next capture uses."""

    # Source
    source: StringProperty(
        name="Source",
        description="Photo, video, or one picture or the folder of an image sequence",
        subtype="FILE_PATH",
        update=notifier("source"),
    )
    as_sequence: BoolProperty(
        name="Image Sequence",
        description="The numbered pictures beside this one are the frames of one clip",
        update=notifier("as_sequence"),
    )
    keypoints: StringProperty(
        name="Other Tracker's File",
        description="Hands or keypoints that another program has found in this source, such as OpenPose; "
        "empty: hands are looked for",
        subtype="FILE_PATH",
    )
    picture_size: IntVectorProperty(
        name="Picture Size",
        description="Pixels of the pictures in which another program has found the hands; 0: not told",
        size=2,
        min=0,
        max=(1 << 24) - 1,
    )
    second_view: StringProperty(
        name="Second View",
        description="A clip of the same hands that a second camera filmed at the same time from elsewhere. "
        "Both cameras must stand still",
        subtype="FILE_PATH",
        update=notifier("second_view"),
    )
    use_offset: BoolProperty(
        name="Offset", description="Tell how much later the second view begins; else it is found"
    )
    offset: FloatProperty(name="Offset", precision=3, step=1, **option_property("offset"))
    use_pair: BoolProperty(
        name="Pair Two Frames",
        description="Tell the offset by a frame of each clip that shows the same moment, such as a touch of "
        "fingers",
    )
    pair: IntVectorProperty(
        name="Same Moment",
        description="A frame of this clip that shows the same moment as the other clip's",
        size=2,
        default=(1, 1),
        min=0,
        update=notifier("pair"),
    )
    cameras: StringProperty(
        name="Cameras",
        description="A calibration of both cameras in aniposelib's TOML layout, as FreeMoCap, caliscope and "
        "Pose2Sim write it; empty: they are found from the hands",
        subtype="FILE_PATH",
    )
    view_lens: StringProperty(
        name="Lens",
        description="The measured lens of the second view's camera; empty: found, or what the clip tells",
        search=_found("measured_lens"),
    )
    use_baseline: BoolProperty(
        name="Baseline", description="Tell how far apart both cameras stood; else the hand's size tells it"
    )
    baseline: FloatProperty(name="Baseline", default=0.5, precision=3, **option_property("baseline"))
    use_frames: BoolProperty(
        name="Frame Range", description="Capture only some of the source's frames", default=False
    )
    first_frame: IntProperty(name="First", description="First source frame", default=1, min=0)
    last_frame: IntProperty(name="Last", description="Last source frame", default=100, min=0)
    frame_step: IntProperty(name="Step", description="Use every n-th frame", default=1, min=1, soft_max=10)

    # Hand
    model: EnumProperty(
        name="Model",
        description="Hand model that is fitted and built",
        items=(
            ("OPEN", "Open Hand", "The hand that ships with the add-on"),
            ("MANO", "MANO Files", "Your own MANO model files"),
        ),
        default="OPEN",
    )
    model_path: StringProperty(
        name="MANO",
        description="MANO file, or the folder with both (empty: the one in the preferences)",
        subtype="FILE_PATH",
    )
    hands: EnumProperty(
        name="Hands",
        items=(
            ("auto", "Auto", "All hands that are found in a photo, up to two in a clip"),
            ("left", "Left", "The person's left hand only"),
            ("right", "Right", "The person's right hand only"),
            ("both", "Both", "One left and one right hand"),
        ),
        **option_property("hands"),
    )
    added_side: EnumProperty(
        name="Side", description="Which hand Add Hand adds", items=SIDE_ITEMS, default="right"
    )
    use_hand_length: BoolProperty(
        name="Expected Size", description="Tell how large the hand is, for its distance and shape"
    )
    hand_length: FloatProperty(
        name="Length", default=18.5, precision=1, **option_property("hand_length", 100.0, ", in centimeters")
    )

    # Capture
    preset: EnumProperty(
        name="Quality",
        description="How closely hands are looked at, and how long that takes",
        items=PRESETS,
        default="STANDARD",
    )
    experiment: EnumProperty(name="Experiment", items=EXPERIMENTS, default="paper-a-plus")
    # Texts, which stay what they are in a file that is opened where there is no such plug-in.
    solver: StringProperty(name="Solver", search=_found("solver"), **option_property("solver"))
    detector: StringProperty(name="Detector", search=_found("detector"), **option_property("detector"))
    arms: BoolProperty(name="Arms", **option_property("arms"))
    smoothing: FloatProperty(name="Smoothing", soft_max=4.0, **option_property("smoothing"))
    threshold: FloatProperty(
        name="Detection", subtype="FACTOR", soft_min=0.05, soft_max=0.95, **option_property("threshold")
    )
    camera: EnumProperty(
        name="Camera",
        description="Where the lens comes from",
        items=(
            ("SOLVE", "Solve", "From the photo's own data, or a common lens"),
            ("ACTIVE", "Scene Camera", "The lens of the scene's active camera"),
            ("FOCAL", "Focal Length", "A focal length that you know"),
            ("LENS", "Measured Lens", "A camera of yours that was measured with a chessboard, once for all"),
        ),
        default="SOLVE",
    )
    measured_lens: StringProperty(
        name="Lens",
        description="The name of the measured lens. Its distortion is taken out of the captured hands",
        search=_found("measured_lens"),
    )
    focal_length: FloatProperty(
        name="Focal Length",
        description="Millimeters on a 36 mm wide sensor (35 mm equivalent)",
        default=35.0,
        min=5.0,
        max=500.0,
        precision=1,
    )
    matching: EnumProperty(**MATCHING)
    matched_time: StringProperty(
        description="The rate and range that the scene was given by footage (scene/matching.py)"
    )
    matched_size: StringProperty(description="The picture size that the scene was given by footage")
    render_setup: BoolProperty(
        name="Ready to Render",
        description="Where the scene is matched, add lights if it has none and show the picture behind the "
        "hands in renders, its colors as they are (the view transform Standard for Blender's AgX). Your own "
        "lights and world stay as they are",
        default=True,
    )
    rendered_camera: PointerProperty(
        type=bpy.types.Object,
        description="The capture's camera whose picture and lights renders show (scene/render_setup.py)",
        options={"HIDDEN"},
    )
    pose_correctives: BoolProperty(**POSE_CORRECTIVES)
    add_controls: BoolProperty(
        name="Controls",
        description="Give new hands controls to animate them with by hand (Pose > Add Controls)",
    )
    target: EnumProperty(
        name="Put On",
        description="What becomes of the captured hands",
        items=(
            ("NEW", "New Hands", "Build new hands with their own camera"),
            ("ANIMATION", "Animate Active Hand", "Key the captured motion on the active hand"),
            ("POSE", "Pose Active Hand", "Key the captured pose on the active hand at the current frame"),
        ),
        default="NEW",
    )

    captured: StringProperty(
        description="Keys of the listed captures that are in this scene: undo and redo take them along",
        options={"HIDDEN"},
    )

    capture: PointerProperty(
        type=bpy.types.Collection,
        description="The capture that was chosen last (scene/captures.py)",
        options={"HIDDEN"},
    )

    live: PointerProperty(type=ManientLive)

    # Poses
    pose: EnumProperty(
        name="Pose", description="A ready pose, or a pose asset of this file", items=pose_items
    )
    pose_blend: FloatProperty(**BLEND)
    pose_scope: EnumProperty(**SCOPES, update=notifier("pose_scope"))
    pose_first: IntProperty(name="First", description="First scene frame of the range", default=1)
    pose_last: IntProperty(name="Last", description="Last scene frame of the range", default=250)

    # Refine
    spread: IntProperty(
        name="Spread",
        description="A correction fades out over so many frames before and after; so does a pose that is put "
        "on a range",
        default=6,
        min=0,
        soft_max=50,
        max=1000,
    )

    grip_prop: PointerProperty(
        name="Object",
        description="What the hand holds",
        type=bpy.types.Object,
        poll=lambda _group, obj: has_surface(obj),
    )

    # Character
    hand_table: PointerProperty(type=ManientHandTable)

    # Keys
    keys_degrees: FloatProperty(
        name="Degrees",
        description="No bone turns farther than this from where all keys have it, in any frame",
        default=2.0,
        min=0.05,
        soft_max=10.0,
        max=90.0,
        precision=1,
        step=10,
    )
    keys_pixels: FloatProperty(
        name="Pixels",
        description="No joint or fingertip of a captured hand moves farther than this in the picture",
        default=2.0,
        min=0.05,
        soft_max=20.0,
        max=1000.0,
        precision=1,
        step=10,
    )
    keys_together: EnumProperty(
        name="Together",
        description="Which bones have their keys on the same frames",
        items=(
            ("ALL", "Whole Hand", "All bones have keys on the same frames: whole poses, and the most keys"),
            ("FINGER", "Each Finger", "The bones of a finger have keys on the same frames"),
            ("BONE", "Each Bone", "Every bone has keys of its own: the fewest"),
        ),
        default="FINGER",
    )
    keys_parts: EnumProperty(
        name="Simplify",
        description="What gets fewer keys; the rest keeps them",
        items=tuple(
            (part.upper(), part.capitalize(), f"Simplify the {part}", 1 << i) for i, part in enumerate(PARTS)
        ),
        default={part.upper() for part in PARTS},
        options={"ENUM_FLAG"},
    )

    # Export
    export_format: EnumProperty(name="Format", items=EXPORT_FORMATS, default="fbx")
    export_preset: EnumProperty(name="For", items=PROGRAMS, default="PLAIN")
    export_meshes: BoolProperty(
        name="Meshes", description="Write also what the character deforms or carries", default=True
    )


_OF_CHARACTER: Any = {"update": notifier("character"), "override": OVERRIDABLE}
_OF_HAND_MOTION: Any = {"update": notifier("hand_motion"), "override": OVERRIDABLE}


class ManientCharacterHand(bpy.types.PropertyGroup):
    """One hand of Object.manient.character."""

    use: BoolProperty(name="Use", description="Whether this hand gets motion", default=True, **_OF_CHARACTER)
    source: PointerProperty(
        name="Source",
        description="The captured hand whose motion it gets, one of the other side mirrored; empty: the "
        "scene's only one of its side",
        type=bpy.types.Object,
        poll=lambda _group, obj: obj.type == "ARMATURE" and obj.manient.is_hand,
        **_OF_CHARACTER,
    )
    offset: PointerProperty(
        name="Offset",
        description="The empty by whose location this hand's whole motion is moved",
        type=bpy.types.Object,
        poll=lambda _group, obj: obj.type == "EMPTY",
        **_OF_HAND_MOTION,
    )
    hand_map: StringProperty(
        description="Which bones are this hand, as JSON (handfit_core/retarget/hand_map.py); empty: those "
        "that are recognised",
        **_OF_CHARACTER,
    )


class ManientCharacter(bpy.types.PropertyGroup):
    """Object.manient.character of an armature that gets motion from captured hands."""

    left: PointerProperty(type=ManientCharacterHand, override=OVERRIDABLE)
    right: PointerProperty(type=ManientCharacterHand, override=OVERRIDABLE)
    live: BoolProperty(
        name="Live Link",
        description="Show every change of the captured hands on this character at once, and key it",
        **_OF_CHARACTER,
    )
    action: PointerProperty(
        type=bpy.types.Action,
        description="The action that the live link keys (live_link.py)",
        override=OVERRIDABLE,
    )
    linked: StringProperty(description="Changes with what the live link has keyed", override=OVERRIDABLE)


ManientCharacter.__annotations__ |= transfer_properties()


class ManientHand(bpy.types.PropertyGroup):
    """Object.manient of a captured hand's armature."""

    character: PointerProperty(type=ManientCharacter, override=OVERRIDABLE)
    is_hand: BoolProperty(default=False)
    side: StringProperty()
    capture: PointerProperty(type=bpy.types.Collection, description="The collection that keeps the take")
    mesh: PointerProperty(
        type=bpy.types.Object, description="The hand's own mesh, among all that hangs on the armature"
    )
    track: IntProperty(default=0)
    betas: FloatVectorProperty(
        name="Shape",
        description="Proportions of the hand, in standard deviations",
        size=NUM_BETAS,
        soft_min=-3.0,
        soft_max=3.0,
        min=-10.0,
        max=10.0,
        update=notifier("shape"),
    )
    forearm: BoolProperty(
        name="Forearm",
        description="Show a piece of forearm behind the wrist, which follows a captured arm; without it the "
        "wrist is capped. "
        "Exports have what is shown",
        update=notifier("shape"),
    )
    wrist: StringProperty(default="open", description="How the mesh ends now: open, cap or forearm")
    corrections: StringProperty(
        description="Corrected frames in files of earlier versions (scene/corrections.py)"
    )
    fitted: StringProperty(
        description="Poses that Re-fit Range has keyed, as base64 text (scene/own_keys.py)"
    )
    smoothing: FloatProperty(
        **option_property(
            "smoothing"
        )  # of the keys; not set in files of older versions (refiner.smoothing_of)
    )
    locked: BoolVectorProperty(
        name="Locked Joints",
        description="Joints that refining leaves as they are, in the order of the bones",
        size=NUM_JOINTS,
    )
    origin: FloatVectorProperty(
        size=3, description="Where the object's origin lies in the space of the capture (scene/origin.py)"
    )
    use_controls: BoolProperty(
        name="Controls",
        description="Have the controls move the hand; without them it does what its keys say",
        default=True,
        update=notifier("controls"),
    )
    limits: BoolProperty(
        name="Joint Limits",
        description="Stop fingers where joints do, but no sooner than the captured motion goes",
        default=True,
        update=notifier("controls"),
    )
    show_confidence: BoolProperty(
        name="Confidence Colors",
        description="Color bones by how well they meet the picture in this frame",
        update=notifier("confidence"),
    )
    own_colors: StringProperty(
        description="The bones' own colors while they show confidence, as JSON (scene/confidence.py)"
    )


class ManientCapture(bpy.types.PropertyGroup):
    """Collection.manient of a built take."""

    is_capture: BoolProperty(default=False)
    is_live: BoolProperty(
        default=False, description="Whether it holds hands that follow a live source (scene/live_hands.py)"
    )
    is_aside: BoolProperty(default=False, description="Whether it is hidden while hands follow a live source")
    take: StringProperty(description="The take as base64 text (scene/store.py)")
    digest: StringProperty()
    camera: PointerProperty(type=bpy.types.Object)
    view_camera: PointerProperty(
        type=bpy.types.Object, description="The camera of the second view (scene/build.py)"
    )
    plate: PointerProperty(
        type=bpy.types.Image, description="The picture that it put behind the artist's own camera"
    )
    rendered: BoolProperty(
        default=True, description="Whether renders showed it before it was hidden (scene/captures.py)"
    )
    frame_offset: FloatProperty(default=0.0)
    frame_scale: FloatProperty(
        default=1.0, description="Scene frame = frame_offset + frame_scale * the take's frame number"
    )
    source_take: StringProperty(
        description="The take as it was captured, where the kept one is retimed, as base64 text"
    )
    source_digest: StringProperty()
    scene_rate: FloatProperty(
        description="Frames per second of the scene that the clip was built for; 0: it has no rate, or an "
        "older version built it"
    )


PROPERTIES = {
    (bpy.types.Scene, "manient"): lambda: PointerProperty(type=ManientSettings, override=OVERRIDABLE),
    (bpy.types.Object, "manient"): lambda: PointerProperty(type=ManientHand, override=OVERRIDABLE),
    (bpy.types.Collection, "manient"): lambda: PointerProperty(type=ManientCapture, override=OVERRIDABLE),
}
