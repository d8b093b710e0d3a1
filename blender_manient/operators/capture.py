"""The buttons Capture and Capture Frame: find, fit and build hands while the window stays free."""

from __future__ import annotations

from pathlib import Path

import bpy

from handfit_core.capturing.options import CaptureOptions
from handfit_core.common.errors import InputError, OptionError
from handfit_core.detect.detector import Region
from handfit_core.geometry.lens import Lens
from handfit_core.hand_model import OPEN_HAND
from handfit_core.media.frame_range import FrameRange
from handfit_core.media.lenses import saved_lens

from ..common import preferences, screen
from ..common.block_reference import BlockReference
from ..scene.camera import lens_of_camera
from ..scene.camera_clip import part_of_frame
from ..scene.matching import matches
from ..scene.store import active_hand
from ..scene.timing import frame_rate
from ..session import jobs, live, source_info
from .base import LINKED_SCENE, InternalOperator, ManientOperator, ModalOperator


class MANIENT_OT_capture(ModalOperator, bpy.types.Operator):
    """Find the hands in the source, fit a hand model to them and build rigged, animated hands. Blender stays
    usable meanwhile; Esc stops and keeps what is finished."""

    bl_label = "Capture"

    only_frame: bpy.props.BoolProperty(
        name="This Frame",
        description="Capture only the scene's current frame of the source",
        options={"SKIP_SAVE"},
    )

    queued: bpy.props.BoolProperty(
        description="Start nothing new, only follow what is queued", options={"HIDDEN", "SKIP_SAVE"}
    )

    @classmethod
    def description(cls, _context, properties):
        if properties.only_frame:
            return "Capture the hands of the scene's current frame only"
        return cls.bl_description

    @classmethod
    def poll_reason(cls, context):
        return why_no_capture(context)

    def begin(self, context):
        """Queue the capture, and follow the queue where nobody does."""
        if not self.queued:
            jobs.submit(new_request(context, only_frame=self.only_frame, ask_if_many=True))
        if type(self).bl_idname in self.running:
            return self._done("It is captured after the one before")
        self._seen: set[int] = {id(j) for j in jobs.jobs() if j.finished}
        return None

    def follow(self, context, event):
        """Tick the queue; Esc stops everything, and quitting asks first."""
        if event.type == "Q" and event.value == "PRESS" and (event.ctrl or event.oskey):
            return bpy.ops.manient.quit("INVOKE_DEFAULT") and {"RUNNING_MODAL"}
        if event.type == "ESC" and event.value == "PRESS" and live.running() is None:  # which Esc ends first
            jobs.cancel_all()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        if jobs.tick():
            self._show(context)
        self._report_finished(context)
        if jobs.busy():
            return {"RUNNING_MODAL"} if event.type == "ESC" else {"PASS_THROUGH"}
        return self.end(context)

    def cancel(self, context):
        jobs.abandon()
        super().cancel(context)

    def run(self, context):
        """Capture and wait for it: for scripts, and without a window."""
        if not self.queued:
            jobs.submit(new_request(context, only_frame=self.only_frame))
        waited = jobs.run()
        for job in waited:
            self._report(job)
        return {"FINISHED"} if all(job.state == "done" for job in waited) else {"CANCELLED"}

    def ended(self, context):
        screen.redraw_sidebars()

    def _show(self, context) -> None:
        job = jobs.current()
        waiting = sum(j.state == "waiting" for j in jobs.jobs())
        if job is not None:
            more = f"   ({waiting} waiting)" if waiting else ""
            self.show_status(context, f"{job.request.name}: {job.status()}{more}   Esc: Stop")
        screen.redraw_sidebars()

    def _report_finished(self, context) -> None:
        for job in jobs.jobs():
            if job.finished and id(job) not in self._seen:
                self._seen.add(id(job))
                self._report(job)
                self._go_on(context, job)

    def _go_on(self, context, job: jobs.Job) -> None:
        """Show what was built, and begin what comes after it."""
        request, result, is_done = job.request, job.result, job.state == "done"
        adds_hand = request.bare or request.then_add_hand
        if is_done and (result.matched or result.in_front):
            screen.look_through_camera(context)
        elif is_done and request.building.target == "NEW":
            objects = context.view_layer.objects
            screen.frame_selected(context, [o for name in result.hands if (o := objects.get(name))])
        if jobs.busy():
            return
        if is_done and not (result.offer or adds_hand):
            screen.open_edit_tab()
        if result.hands_to_choose:
            bpy.ops.manient.find_hands("INVOKE_DEFAULT")
        if is_done and adds_hand:
            bpy.ops.manient.add_hand("INVOKE_DEFAULT", shown=True)

    def _report(self, job: jobs.Job) -> None:
        for warning in job.result.warnings:
            self.report({"WARNING"}, warning)
        kind = "ERROR" if job.state == "failed" else "INFO"
        self.report({kind}, f"{job.request.name}: {job.result.report()}")


class MANIENT_OT_queue_capture(ManientOperator, bpy.types.Operator):
    """Capture this as well, after the captures before."""

    # Not Capture itself: where two buttons are of one operator, and the mouse is on the one that goes,
    # Blender takes the other one for it, and clicks go there.
    bl_label = "Add to Queue"
    bl_options = {"REGISTER"}

    @classmethod
    def poll_reason(cls, context):
        return why_no_capture(context)

    def run(self, context):
        jobs.submit(new_request(context, only_frame=False, ask_if_many=True))
        return bpy.ops.manient.capture("INVOKE_DEFAULT", queued=True)


class MANIENT_OT_quit(InternalOperator, bpy.types.Operator):
    """Quit Blender and lose the capture that runs."""

    bl_label = "Quit"

    def invoke(self, context, event):
        """Ask first."""
        question = "A capture is running. Quit and lose it?"
        return context.window_manager.invoke_confirm(
            self, event, title="Quit Blender", message=question, confirm_text="Quit", icon="WARNING"
        )

    def run(self, context):
        """Blender asks by itself where the file has changes."""
        return bpy.ops.wm.quit_blender("INVOKE_DEFAULT")


class MANIENT_OT_cancel_capture(InternalOperator, bpy.types.Operator):
    """Stop this capture and keep the frames that are finished."""

    bl_label = "Cancel"

    index: bpy.props.IntProperty(default=-1, options={"SKIP_SAVE"})

    def run(self, context):
        queue = jobs.jobs()
        if 0 <= self.index < len(queue):
            jobs.cancel(queue[self.index])
        else:
            jobs.cancel_all()
        screen.redraw_sidebars()


class MANIENT_OT_clear_captures(InternalOperator, bpy.types.Operator):
    """Remove these messages. The captured hands stay."""

    bl_label = "Dismiss"

    def run(self, context):
        jobs.forget_finished()
        screen.redraw_sidebars()


def why_no_capture(context: bpy.types.Context, *, alone: bool = False) -> str | None:
    """Return why no capture can begin, or none as long as another one is under way (`alone`), a sentence for
    a tooltip; None where one can."""
    if context.scene is None or not context.scene.is_editable:
        return LINKED_SCENE
    if alone and jobs.busy():
        return "A capture is running: wait for it, or stop it"
    return None


def new_request(
    context: bpy.types.Context,
    *,
    only_frame: bool,
    regions: tuple[Region, ...] = (),
    ask_if_many: bool = False,
    bare: bool = False,
) -> jobs.CaptureRequest:
    """Return the capture that the panel's settings describe; with `regions`, of the hands in them and no
    others.

    `ask_if_many` and `bare` are fields of the request. Raises HandfitError in the artist's words."""
    settings, scene = context.scene.manient, context.scene
    source = source_info.resolve(settings.source, as_sequence=settings.as_sequence)
    hand = active_hand(context)
    target = "NEW" if bare else settings.target
    if target != "NEW" and hand is None:
        raise OptionError("select the captured hand that is to be animated, or choose New Hands")
    camera = scene.camera if settings.camera == "ACTIVE" else None
    only = _shown_frame(context, source) if only_frame else None
    view = None if only_frame or bare else _second_view(settings, source)
    cameras = _full_path(settings.cameras) if view else None
    clip = source_info.camera_clip(settings, source)
    if settings.camera == "ACTIVE" and (camera is None or camera.type != "CAMERA"):
        raise OptionError("the scene has no active camera: choose another camera setting")
    return jobs.CaptureRequest(
        name=Path(source.files[0]).name if source.kind != "sequence" else Path(source.files[0]).parent.name,
        files=source.files,
        options=CaptureOptions(
            frames=_frames(settings, source, only),
            hands="auto" if regions else settings.hands,
            regions=regions,
            only_regions=bool(regions),
            detector=settings.detector or CaptureOptions.detector,
            solver=settings.experiment
            if settings.preset == "PAPER"
            else settings.solver or CaptureOptions.solver,
            model=model_of(settings),
            threshold=settings.threshold,
            arms=settings.arms and target == "NEW" and source.kind != "data" and not bare,
            smoothing=settings.smoothing,
            plain_detection=settings.preset == "DRAFT",
            quality="standard" if settings.preset == "PAPER" else settings.preset.lower(),
            hand_length=settings.hand_length / 100.0 if settings.use_hand_length else None,
            lens=lens_of(settings, scene),
            view=view,
            view_lens=saved_lens(settings.view_lens).lens
            if view and settings.view_lens and not cameras
            else None,
            cameras=cameras,
            offset=source_info.chosen_offset(settings) if view else None,
            baseline=settings.baseline if view and settings.use_baseline and not cameras else None,
            max_megapixels=preferences.get(context).max_megapixels or None,
            keypoints=_full_path(settings.keypoints) if source.kind != "data" else None,
            picture_size=_picture_size(settings, source),
        ),
        building=jobs.Building(
            scene=BlockReference.of("scenes", scene),
            target=target,
            hand=BlockReference.of("objects", hand.armature) if hand else None,
            frame=float(scene.frame_current),
            pose_correctives=settings.pose_correctives,
            controls=settings.add_controls,
            matching=settings.matching,
            render_setup=settings.render_setup,
            retimed=_retimed(context, only_frame) if target == "NEW" and clip is None else None,
            camera=BlockReference.of("objects", camera) if camera else None,
            clip=clip,
        ),
        bare=bare,
        ask_if_many=ask_if_many and source.kind == "photo" and settings.target == "NEW",
    )


def _retimed(context: bpy.types.Context, only_frame: bool) -> float | None:
    """Return the scene's rate in frames per second, where it stays and the source may be retimed to it; else
    None."""
    scene, settings = context.scene, context.scene.manient
    known = source_info.footage(settings, source_info.of(settings))
    kept = not only_frame and not matches(scene, settings.matching, known)
    return frame_rate(scene) if kept else None


def _frames(settings, source: source_info.SourceFiles, only: int | None) -> FrameRange | None:
    if source.kind == "photo":
        return None
    if only is not None:
        return FrameRange(only, only)
    if not settings.use_frames:
        return FrameRange(step=settings.frame_step) if settings.frame_step > 1 else None
    if settings.last_frame < settings.first_frame:
        raise OptionError("the last frame lies before the first: mend the frame range")
    return FrameRange(settings.first_frame, settings.last_frame, settings.frame_step)


def _shown_frame(context: bpy.types.Context, source: source_info.SourceFiles) -> int:
    """Return the source's frame at the scene's current one. Raises OptionError where it has none there."""
    info, shown = source_info.of(context.scene.manient), source_info.shown_frame(context, source)
    if not info.has_frame(shown):
        raise OptionError(
            f"the source has no frame {shown}, which the scene shows: go to its frames {info.first} to "
            f"{info.last}"
        )
    return shown


def _second_view(settings, source: source_info.SourceFiles) -> str | None:
    """Return the second view's file or folder; None where there is none. Raises InputError where it is not
    there."""
    if not settings.second_view or source.kind not in ("video", "sequence"):
        return None
    view = source_info.resolve(settings.second_view, as_sequence=False)
    return view.files[0] if len(view.files) == 1 else str(Path(view.files[0]).parent)


def _full_path(chosen: str) -> str | None:
    """Return the path of a file that the panel names; None where that is empty."""
    return str(Path(bpy.path.abspath(chosen)).expanduser().absolute()) if chosen else None


def _picture_size(settings, source: source_info.SourceFiles) -> tuple[int, int] | None:
    if source.kind != "data":
        return None
    width, height = settings.picture_size
    if source_info.lacks_size(settings, source_info.of(settings)) or bool(width) != bool(height):
        raise OptionError(
            "type the source's width and height: its file does not tell how large its pictures are"
        )
    return (width, height) if width else None


def model_of(settings) -> str | None:
    """Return the hand model that the settings name, as options do. Raises InputError."""
    if settings.model == "OPEN":
        return OPEN_HAND
    path = settings.model_path or preferences.get().mano_folder
    if not path:
        raise InputError("choose your MANO files, or the Open Hand as the model")
    return str(Path(bpy.path.abspath(path)).expanduser())


def lens_of(settings, scene: bpy.types.Scene) -> Lens | tuple[float, float, float] | None:
    """Return the lens chosen in the settings, as `CaptureOptions` take it; None where the capture is to find
    it itself. Raises HandfitError."""
    if settings.camera == "LENS":
        if not settings.measured_lens:
            raise OptionError("choose the measured lens, or measure one, or choose another camera setting")
        return saved_lens(settings.measured_lens).lens
    if settings.camera == "FOCAL":
        return settings.focal_length / 36.0, 0.5, 0.5
    if settings.camera == "ACTIVE":
        focal, x, y = lens_of_camera(scene.camera, scene)
        clip = source_info.camera_clip(settings, source_info.of(settings).files)
        width, height = part_of_frame(scene, clip) if clip else (1.0, 1.0)
        return focal / width, 0.5 + (x - 0.5) / width, 0.5 + (y - 0.5) / height
    return None
