"""Add Hand: a relaxed hand is laid into the picture by mouse, for Edit Keypoints to pose."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from handfit_core.common.errors import HandfitError, OptionError
from handfit_core.common.skeleton import NUM_BETAS, NUM_KEYPOINTS, Side
from handfit_core.edit import landmark_points
from handfit_core.edit.adding import KNUCKLE, USUAL_PALM, WRIST, laid, with_added
from handfit_core.geometry.picture_map import mapped
from handfit_core.hand_model.files import kept_model
from handfit_core.take import Take

from ..common import screen
from ..scene.build import add_last_hand
from ..scene.store import active_hand, captures_of, kept_take, rows_at
from ..session import jobs, source_info
from ..session.properties import SIDE_ITEMS
from .base import ModeOperator, select_alone, show_frame_again
from .capture import new_request, why_no_capture
from .modes import drawing, view
from .modes.view import free_corner

_CLICK_PIXELS = 6.0
"""pixels at a user interface scale of 1. A drag that is shorter is a click"""
_KEYS = (
    "Drag from Wrist to Middle Knuckle: Add Hand    Click: Add It Upright    S: Left or Right    "
    "P: Back or Palm    Left/Right: Frame    Esc: Cancel"
)
_SEEN = (("back", "Back", "The back of the hand is seen"), ("palm", "Palm", "The palm is seen"))


class _Mode(view.Overlay):
    """The mode of Add Hand, from its button until a hand is laid into the picture or Esc is pressed."""

    def __init__(self, context, viewport: view.Viewport, capture: bpy.types.Collection) -> None:
        self.capture, self.take = capture.name, kept_take(capture)
        self.camera = capture.manient.camera.name
        self.view = view.CaptureView(viewport, [capture.manient.camera], context)
        self.seen: Any = "back"
        self.ends: np.ndarray | None = None
        """(2, 2) pixels of the picture: where the wrist and the middle finger's knuckle would lie now; None
        while the mouse gives no place"""
        self.pressed: np.ndarray | None = None
        """(2,) pixels of the viewport's region: where the mouse was pressed; None while it is not"""
        self.message = ""
        super().__init__(viewport)

    def end(self, context) -> None:
        """Take the drawing away and put the viewport back as it was. May be called twice."""
        if self.remove():
            self.view.leave(context)

    def matrix(self, viewport: view.Viewport) -> np.ndarray | None:
        """Return the (3, 3) matrix from pixels of the picture to pixels of the viewport's region; None while
        the viewport does not look through the capture camera."""
        camera = bpy.data.objects.get(self.camera)
        if camera is None or not self.view.shows(viewport):
            return None
        return view.picture_matrix(viewport, camera, self.take.intrinsics)

    def follow(self, viewport: view.Viewport, mouse: np.ndarray) -> None:
        """Have the hand lie where the mouse says: its wrist under the mouse, or, while a button is held, from
        the place of the press to the mouse."""
        matrix = self.matrix(viewport)
        if matrix is None:
            self.ends = None
            return
        dragged = (
            self.pressed is not None
            and np.ptp([self.pressed, mouse], axis=0).max() > _CLICK_PIXELS * screen.ui_scale()
        )
        places = mapped(
            np.linalg.inv(matrix), np.array([mouse if self.pressed is None else self.pressed, mouse])
        )
        if not dragged:
            places[1] = places[0] - [0.0, USUAL_PALM * min(self.take.width, self.take.height)]
        self.ends = places

    def points(self, side: Side) -> np.ndarray:
        """Return (21, 2) pixels of the picture: the hand as it would be added; NaN where there is none."""
        if self.ends is None:
            return np.full((NUM_KEYPOINTS, 2), np.nan)
        try:
            model = kept_model(self.take.model, side)
            pose = (a[None] for a in laid(model, self.take.intrinsics, self.ends[0], self.ends[1], self.seen))
            return self.take.intrinsics.project(landmark_points(model, np.zeros(NUM_BETAS), *pose))[0]
        except HandfitError as error:
            self.message = str(error)
            return np.full((NUM_KEYPOINTS, 2), np.nan)

    def draw(self, viewport: view.Viewport) -> None:
        """Draw the hand as it would be added, and a line of text about it."""
        side, matrix = bpy.context.scene.manient.added_side, self.matrix(viewport)
        text = f"{side.capitalize()} hand, its {self.seen} to you: drag from the wrist to the middle knuckle"
        if matrix is None:
            text = "Numpad 0: look through the capture camera again"
        places = np.full((NUM_KEYPOINTS, 2), np.nan) if matrix is None else mapped(matrix, self.points(side))
        drawing.draw(
            drawing.Picture(
                places=places,
                pinned=frozenset((WRIST, KNUCKLE)),
                hovered=None,
                dragged=WRIST if self.pressed is None else KNUCKLE,
                text=self.message or text,
                warning=bool(self.message) or matrix is None,
                corner=free_corner(viewport),
            )
        )


class MANIENT_OT_add_hand(ModeOperator, bpy.types.Operator):
    """Lay a relaxed hand into the picture where none was found: drag from its wrist to the knuckle of the
    middle finger. Then drag three to six of its points, fingertips first."""

    bl_label = "Add Hand"
    tick = 0.1

    side: bpy.props.EnumProperty(name="Side", items=SIDE_ITEMS, options={"SKIP_SAVE"})
    seen: bpy.props.EnumProperty(name="Seen", items=_SEEN, options={"SKIP_SAVE"})
    wrist: bpy.props.FloatVectorProperty(
        name="Wrist", description="Pixels from the picture's upper left corner", size=2
    )
    knuckle: bpy.props.FloatVectorProperty(
        name="Middle Knuckle", description="Pixels from the picture's upper left corner", size=2
    )
    shown: bpy.props.BoolProperty(
        description="The picture was shown for this", options={"HIDDEN", "SKIP_SAVE"}
    )

    @classmethod
    def poll_reason(cls, context):
        if cls.current is not None:
            return "A hand is being added already"
        if context.mode not in ("OBJECT", "POSE"):
            return "Go to Object or Pose Mode first"
        return why_no_capture(context, alone=True)

    def begin(self, context):
        """Begin in the viewport under the mouse, or the largest one; the picture is shown first."""
        viewport = view.first_viewport(context)
        if viewport is None:
            raise OptionError("Hands are added in a 3D viewport: open one in this window")
        capture = target_capture(context)
        if capture is None and self.shown:
            raise OptionError("The picture is not in this scene: press Add Hand again")
        if capture is None:
            jobs.submit(new_request(context, only_frame=False, bare=True))
            return bpy.ops.manient.capture("INVOKE_DEFAULT", queued=True)
        type(self).current = _Mode(context, viewport, capture)
        self.show_status(context, _KEYS)
        return None

    def run(self, context):
        """Add the hand with its wrist and knuckle where the properties say: for scripts, and without a
        window."""
        capture = target_capture(context)
        if capture is None:
            jobs.submit(new_request(context, only_frame=False, bare=True))
            for job in jobs.run():
                if job.state != "done":
                    raise OptionError(job.result.message)
            capture = target_capture(context)
        if capture is None:
            raise OptionError("The picture is not in this scene: press Add Hand again")
        add_hand(context, capture, self.side, np.array([self.wrist, self.knuckle], dtype=float), self.seen)
        bpy.ops.ed.undo_push(message="Add Hand")

    def follow(self, context, event):
        laying = self.current
        viewport = laying.viewport() if laying is not None else None
        if laying is None or viewport is None or jobs.busy() or bpy.data.objects.get(laying.camera) is None:
            return self.end(context)
        mouse = viewport.mouse(event)
        inside, settings = viewport.contains(event.mouse_x, event.mouse_y), context.scene.manient
        if event.type in ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE"):
            laying.follow(viewport, mouse)
        elif event.type == "LEFTMOUSE" and event.value == "PRESS" and inside:
            laying.pressed, laying.message = mouse, ""
            laying.follow(viewport, mouse)
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE" and laying.pressed is not None:
            laying.follow(viewport, mouse)
            return self._add(context)
        elif event.value == "PRESS" and event.type in ("ESC", "RIGHTMOUSE"):
            if laying.pressed is None:
                return self.end(context)
            laying.pressed = None
        elif event.value == "PRESS" and event.type == "S" and inside and not (event.ctrl or event.alt):
            settings.added_side = "left" if settings.added_side == "right" else "right"
        elif event.value == "PRESS" and event.type == "P" and inside and not (event.ctrl or event.alt):
            laying.seen = "palm" if laying.seen == "back" else "back"
        elif (factor := view.zoom_of(event)) is not None and inside and laying.view.shows(viewport):
            viewport.enlarge(factor, mouse)
        else:
            return {"PASS_THROUGH"}
        viewport.region.tag_redraw()
        return {"PASS_THROUGH"} if event.type.endswith("MOUSEMOVE") else {"RUNNING_MODAL"}

    def _add(self, context):
        laying = self.current
        capture = bpy.data.collections.get(laying.capture)
        if capture is None or laying.ends is None:
            return self.end(context)
        try:
            add_hand(context, capture, context.scene.manient.added_side, laying.ends, laying.seen)
        except HandfitError as error:
            laying.pressed, laying.message = None, str(error)
            return {"RUNNING_MODAL"}
        self.end(context)
        bpy.ops.ed.undo_push(message="Add Hand")
        bpy.ops.manient.edit_keypoints("INVOKE_DEFAULT")
        return {"FINISHED"}


def target_capture(context: bpy.types.Context) -> bpy.types.Collection | None:
    """Return the capture whose picture a hand is added to: one of the panel's source, that of the active hand
    before others and the newest before older ones; without a source the active hand's. Raises
    HandfitError."""
    settings, hand = context.scene.manient, active_hand(context)
    if not settings.source and hand is not None:
        return hand.collection if hand.camera is not None else None
    source = source_info.resolve(settings.source, as_sequence=settings.as_sequence)
    for capture in captures_of(context, source.kind, source.files):
        camera = capture.manient.camera
        if camera is not None and camera.type == "CAMERA" and camera.users_collection:
            return capture
    return None


def add_hand(
    context: bpy.types.Context, capture: bpy.types.Collection, side: Side, ends: np.ndarray, seen: Any
) -> bpy.types.Object:
    """Lay a hand into the capture's picture at the scene's current frame, with wrist and knuckle at `ends`
    (2, 2) pixels, and make it the active one. Returns its armature. Raises HandfitError."""
    take: Take = kept_take(capture)
    (row,) = rows_at(capture, take, np.array([context.scene.frame_current_final]))
    if row < 0:
        raise OptionError("this frame is not in the capture: go to one of its frames")
    take = with_added(take, kept_model(take.model, side), int(row), ends[0], ends[1], seen)
    armature = add_last_hand(capture, take).armature
    if context.mode == "POSE":
        bpy.ops.object.mode_set(mode="OBJECT")
    select_alone(context, armature)
    show_frame_again(context)
    return armature


unregister = MANIENT_OT_add_hand.leave
HANDLERS = dict.fromkeys(("load_pre", "undo_pre"), lambda *_args: unregister())
