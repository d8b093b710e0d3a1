"""Edit Keypoints: drag the 21 points over the picture, and the hand follows; the same for scripts."""

from __future__ import annotations

import bpy

from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import NUM_KEYPOINTS
from handfit_core.edit.corrections import Pins

from ..scene.store import active_hand, hand_of
from ..session import shared_worker
from ..session.refiner import Refiner, why_not
from .base import ManientOperator, ModeOperator, finish, show_frame_again
from .modes import keypoints as mode
from .modes import view

_KEYS = (
    "Drag: Move Point    X or Ctrl Click: Remove Pin    H: Solid Hand    Ctrl Z: Undo    "
    "Left/Right: Frame    Wheel: Zoom    Home: Hand    Shift Home: Picture    Enter, Esc: Done"
)
_SWITCH = "    V: Other View"
_ENDS = {"RET", "NUMPAD_ENTER", "TAB", "ESC"}


class MANIENT_OT_edit_keypoints(ModeOperator, bpy.types.Operator):
    """Show the 21 points of the hand over the picture. Dragging one fits the hand again so that it lies
    there, and the frames around follow as far as Spread says."""

    bl_label = "Edit Keypoints"
    tick = 0.008

    @classmethod
    def poll_reason(cls, context):
        return "Keypoints are being edited already" if cls.current else why_not(context, active_hand(context))

    def begin(self, context):
        """Begin the mode in the viewport under the mouse, or the largest one."""
        hand, viewport = active_hand(context), view.first_viewport(context)
        if viewport is None:
            raise OptionError("Keypoints are edited in a 3D viewport: open one in this window")
        if hand is None or hand.camera is None:
            raise OptionError("The hand's capture camera is gone: undo its removal, or import the take")
        type(self).current = mode.KeypointMode(context, Refiner(hand.armature), viewport)
        # So that undoing the first drag leads back to here.
        bpy.ops.ed.undo_push(message="Edit Keypoints")
        self.show_status(context, _KEYS + (_SWITCH if len(self.current.refiner.cameras) > 1 else ""))

    def run(self, context):
        raise OptionError("Keypoints are edited in a window; scripts use manient.move_keypoint")

    def follow(self, context, event):
        if self.current is None:
            return self.end(context)
        trouble = self.current.trouble(context)
        if trouble is not None:
            self.report({"INFO"}, trouble)
            return self.end(context)
        self.current.tick(context)
        if event.type == "TIMER":
            return {"PASS_THROUGH"}
        viewport = view.viewport_at(context, self.current.view.address)
        if viewport is None:
            return self.end(context)
        if self.current.drag is not None and not self.current.drag.released:
            return self._while_dragging(context, event, viewport)
        return self._between_drags(context, event, viewport)

    def _while_dragging(self, context, event, viewport):
        if event.type == "MOUSEMOVE":
            # Moves in between have been overtaken already.
            self.current.move(viewport, event.mouse_x, event.mouse_y)
            self.current.follow(context)
        elif event.type == "LEFTMOUSE" and event.value == "RELEASE":
            self.current.move(viewport, event.mouse_x, event.mouse_y)
            self.current.release()
            self.current.tick(context)
        elif event.type in ("ESC", "RIGHTMOUSE") and event.value == "PRESS":
            self.current.cancel_drag(context)
        return {"RUNNING_MODAL"}

    def _between_drags(self, context, event, viewport):
        inside = viewport.contains(event.mouse_x, event.mouse_y)
        if event.type in ("MOUSEMOVE", "INBETWEEN_MOUSEMOVE"):
            hovered = self.current.handle_at(viewport, event.mouse_x, event.mouse_y) if inside else None
            if hovered != self.current.hovered:
                self.current.hovered = hovered
                viewport.area.tag_redraw()
            return {"PASS_THROUGH"}
        factor = view.zoom_of(event)
        if factor is not None and inside and self.current.view.shows(viewport):
            viewport.enlarge(factor, viewport.mouse(event))
            return {"RUNNING_MODAL"}
        if event.value != "PRESS":
            return {"PASS_THROUGH"}
        if event.type in ("LEFTMOUSE", "RIGHTMOUSE") and inside and not event.alt:
            keypoint = self.current.handle_at(viewport, event.mouse_x, event.mouse_y)
            if keypoint is None and viewport.has_gizmos(viewport.mouse(event)):
                return {"PASS_THROUGH"}
            # What hits no point is swallowed: it would select, or deselect, what lies behind.
            if keypoint is not None and event.type == "LEFTMOUSE":
                if event.ctrl:
                    self.current.unpin(keypoint)
                else:
                    self.current.press(context, viewport, event.mouse_x, event.mouse_y)
                viewport.area.tag_redraw()
            return {"RUNNING_MODAL"}
        if event.type == "Z" and (event.ctrl or event.oskey):
            self.current.undo(context, redo=event.shift)
            context.area.tag_redraw() if context.area else None
            return {"RUNNING_MODAL"}
        if not inside:
            return {"PASS_THROUGH"}
        if event.type in ("X", "DEL", "BACK_SPACE") and self.current.hovered is not None:
            self.current.unpin(self.current.hovered)
            return {"RUNNING_MODAL"}
        if event.type == "V" and not (event.ctrl or event.shift or event.alt or event.oskey):
            self.current.switch_view(context, viewport)
            return {"RUNNING_MODAL"}
        if event.type == "H" and not (event.ctrl or event.shift or event.alt or event.oskey):
            self.current.toggle_solid()
            return {"RUNNING_MODAL"}
        if event.type in ("LEFT_ARROW", "RIGHT_ARROW") and not (event.ctrl or event.shift or event.alt):
            self.current.step(context.scene, -1 if event.type == "LEFT_ARROW" else 1)
            return {"RUNNING_MODAL"}
        if event.type == "HOME" and not (event.ctrl or event.alt or event.oskey):
            (self.current.show_picture if event.shift else self.current.show_hand)(viewport)
            return {"RUNNING_MODAL"}
        if event.type in _ENDS:
            return self.end(context)
        return {"PASS_THROUGH"}


class MANIENT_OT_move_keypoint(ManientOperator, bpy.types.Operator):
    """Pin a point of the hand to a place in the picture and fit the hand to it again."""

    bl_label = "Move Keypoint"

    hand: bpy.props.StringProperty(
        name="Hand", description="Name of the hand's armature (empty: the active one)"
    )
    frame: bpy.props.IntProperty(name="Frame", description="Scene frame", options={"SKIP_SAVE"})
    keypoint: bpy.props.IntProperty(
        name="Keypoint", description="0 is the wrist, 8 the index tip", min=0, max=NUM_KEYPOINTS - 1
    )
    x: bpy.props.FloatProperty(name="X", description="Pixels from the picture's left edge")
    y: bpy.props.FloatProperty(name="Y", description="Pixels from the picture's upper edge")
    remove: bpy.props.BoolProperty(
        name="Remove", description="Remove the point's pin instead", options={"SKIP_SAVE"}
    )

    @classmethod
    def poll_reason(cls, context):
        """Return why the active hand cannot be refined, a sentence; None where it can, and without one, since
        `run` checks the hand that it is given."""
        hand = active_hand(context)
        return why_not(context, hand) if hand is not None else None

    def run(self, context):
        refiner = Refiner(self._armature(context))
        frame = self.frame if self.properties.is_property_set("frame") else context.scene.frame_current
        row = refiner.row_at(frame)
        if row is None:
            raise OptionError(f"frame {frame} was not captured: give a frame of the source")
        pins = self._pins(refiner.pins(row))
        if pins or refiner.touches(row):
            fields = refiner.request([row], [pins], refiner.start_poses([row]))()
            poses = refiner.poses(finish(shared_worker.ask("refit", "Move Keypoint", **fields)))
            if not poses.present[0]:
                raise OptionError("no hand can be fitted to these points: move them nearer to the hand")
            refiner.correct(row, pins, poses, context.scene.manient.spread)
        else:
            refiner.unpin(row)
        show_frame_again(context)

    def _armature(self, context) -> bpy.types.Object:
        if not self.hand:
            hand = active_hand(context)
            if hand is None:
                raise OptionError("no captured hand is active: select one, or give its name")
            return hand.armature
        obj = context.scene.objects.get(self.hand)
        hand = hand_of(obj) if obj is not None else None
        if hand is None:
            raise OptionError(f"there is no captured hand {self.hand!r} in this scene")
        why = why_not(context, hand)
        if why is not None:
            raise OptionError(why)
        return hand.armature

    def _pins(self, pins: Pins) -> Pins:
        others = {k: place for k, place in pins.items() if k != self.keypoint}
        if not self.remove:
            return {**others, self.keypoint: (self.x, self.y)}
        if self.keypoint not in pins:
            raise OptionError(f"keypoint {self.keypoint} has no pin in this frame")
        return others


def _on_undo(*_args) -> None:
    editing = MANIENT_OT_edit_keypoints.current
    if editing is not None and not editing.own_undo:
        editing.ended = "Keypoints: ended by an undo"


def _on_load(*_args) -> None:
    unregister()
    mode.saved_views.clear()


unregister = MANIENT_OT_edit_keypoints.leave


HANDLERS = {"undo_post": _on_undo, "redo_post": _on_undo, "load_pre": _on_load}
