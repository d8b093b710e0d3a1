"""Live: the buttons that follow a camera, record, and keep or throw away what was recorded."""

from __future__ import annotations

import time
from dataclasses import replace

import bpy

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import OptionError
from handfit_core.common.skeleton import SIDES, Side, other_side

from ..common import screen
from ..common.block_reference import BlockReference
from ..scene.timing import frame_rate
from ..session import jobs, live
from ..session.live_takes import LiveTake, takes
from .base import InternalOperator, ManientOperator, ModalOperator, SceneOperator
from .capture import lens_of, model_of
from .modes.view import FrontView, first_viewport

_REDRAW_EVERY = 0.1
"""Seconds from one drawing of the panel to the next: its numbers are read, not watched"""


class MANIENT_OT_live(ModalOperator, SceneOperator, bpy.types.Operator):
    """Open the camera and have hands of the scene move as yours do, without keys. Space records, Esc ends it
    and leaves the scene as it was."""

    bl_label = "Start"
    bl_options = {"REGISTER"}
    tick = 1 / 60

    @classmethod
    def poll_reason(cls, context):
        runs = "Live runs already" if live.running() is not None else None
        return super().poll_reason(context) or runs

    def run(self, context):
        raise OptionError("Live needs Blender's window")

    def begin(self, context):
        self._session, self._redrawn, self._view = start(context), 0.0, None
        viewport = first_viewport(context)
        if viewport is not None and None in self._session.followed.values():
            self._view = FrontView(viewport, context.scene)

    def follow(self, context, event):
        """Handle an event: Space records, Esc ends."""
        session = self._session
        if event.value == "PRESS" and event.type == "ESC":
            session.stop()
            return {"RUNNING_MODAL"}
        if event.value == "PRESS" and event.type == "SPACE" and _over_viewport(context, event):
            session.toggle_recording()
            return {"RUNNING_MODAL"}
        if event.type != "TIMER" or bpy.app.is_job_running("RENDER"):
            return {"PASS_THROUGH"}
        if session.step():
            screen.redraw("VIEW_3D")
        if time.monotonic() > self._redrawn + _REDRAW_EVERY:
            self._redrawn = time.monotonic()
            screen.redraw_sidebars()
            self.show_status(context, f"Live: {session.status()}   Space: Record   Esc: End")
        queue_recorded(context, session)
        if not session.over:
            return {"PASS_THROUGH"}
        self.end(context)
        if session.error is not None:
            raise session.error
        return self._done(session.message, kind="WARNING" if session.message else "INFO")

    def ended(self, context):
        if not self._session.over:
            self._session.abandon()
        if self._view is not None:
            self._view.leave(context)
            self._view = None
        screen.redraw("VIEW_3D")


class MANIENT_OT_live_stop(InternalOperator, bpy.types.Operator):
    """End Live, and leave the scene as it was before; recorded takes stay."""

    bl_label = "Stop"

    def run(self, context):
        _session().stop()


class MANIENT_OT_live_record(InternalOperator, bpy.types.Operator):
    """Record your hands as a new take, from the scene's current frame on, or end the recording (Space)."""

    bl_label = "Record"

    def run(self, context):
        _session().toggle_recording()


class MANIENT_OT_live_calibrate(InternalOperator, bpy.types.Operator):
    """Hold an open hand still before the camera for a second: it tells how long your hand is, and what is
    straight for it."""

    bl_label = "Calibrate"

    def run(self, context):
        _session().calibrate()


class MANIENT_OT_live_snapshot(ManientOperator, bpy.types.Operator):
    """Key the fingers' present pose at the current frame: on the characters that follow, else on the active
    captured hand."""

    bl_label = "Snapshot"

    @classmethod
    def poll_reason(cls, context):
        return None if live.running() is not None else "Press Start first"

    def run(self, context):
        _session().snapshot()
        return f"Keyed the pose at frame {context.scene.frame_current}"


class MANIENT_OT_live_keep(InternalOperator, bpy.types.Operator):
    """Keep this take: it leaves the list, its hands and files stay."""

    bl_label = "Keep"

    index: bpy.props.IntProperty()

    def run(self, context):
        takes.remove(_take(self.index))


class MANIENT_OT_live_throw_away(ManientOperator, bpy.types.Operator):
    """Remove this take's hands and keys, and its files from the disk."""

    bl_label = "Throw Away"

    index: bpy.props.IntProperty()

    def invoke(self, context, event):
        return context.window_manager.invoke_confirm(self, event)

    def run(self, context):
        take = _take(self.index)
        take.throw_away()
        return f"Take {take.number} and its files are gone"


def start(context: bpy.types.Context) -> live.LiveSession:
    """Start a live session as the panel's settings say, and return it. Raises HandfitError."""
    settings = context.scene.manient
    wanted = settings.live
    sides: list[Side] = [side for side in SIDES if getattr(wanted, side).use]
    if not sides:
        raise OptionError("choose which hand is followed: the left one, the right one or both")
    followed: dict[Side, tuple[BlockReference, Side] | None] = {}
    for side in sides:
        hand = getattr(wanted, side)
        followed[side] = None
        if hand.character is not None:
            its = other_side(side) if hand.other_side else side
            followed[side] = BlockReference.of("objects", hand.character), its
    chosen = [target for target in followed.values() if target is not None]
    if len(set(chosen)) < len(chosen):
        raise OptionError("both of your hands would move the same hand of the character: choose another one")
    options = CaptureOptions(
        hands="both" if len(sides) == 2 else sides[0],
        model=model_of(settings),
        threshold=settings.threshold,
        lens=None if settings.camera == "ACTIVE" else lens_of(settings, context.scene),
        hand_length=settings.hand_length / 100.0 if settings.use_hand_length else None,
    )
    return live.start(context.scene, options, followed)


def queue_recorded(context: bpy.types.Context, session: live.LiveSession) -> None:
    """Have what was recorded captured in full, behind what is queued already."""
    settings = context.scene.manient
    for take in session.recorded:
        scene = take.scene.find()
        options = replace(
            session.options,
            quality="standard" if settings.preset == "PAPER" else settings.preset.lower(),
            smoothing=settings.smoothing,
            arms=settings.arms,
        )
        request = jobs.CaptureRequest(
            name=take.path.name,
            files=(str(take.path),),
            options=options,
            building=jobs.Building(
                scene=take.scene,
                frame=take.frame,
                render_setup=False,
                matching="KEEP",
                retimed=frame_rate(scene or context.scene),
            ),
            output=take.take_path,
            then=take.replacing,
        )
        take.job = jobs.submit(request)
        if not bpy.app.background:
            bpy.ops.manient.capture("INVOKE_DEFAULT", queued=True)
    session.recorded.clear()


def _session() -> live.LiveSession:
    session = live.running()
    if session is None:
        raise OptionError("Live does not run: press Start first")
    return session


def _take(index: int) -> LiveTake:
    if not 0 <= index < len(takes):
        raise OptionError("there is no such take any more")
    return takes[index]


def _over_viewport(context: bpy.types.Context, event: bpy.types.Event) -> bool:
    """True if the mouse is in a 3D viewport, where Space means Record."""
    return any(
        area.type == "VIEW_3D"
        and 0 <= event.mouse_x - area.x < area.width
        and 0 <= event.mouse_y - area.y < area.height
        for area in context.window.screen.areas
    )
