"""Live: the camera, which hands move what, and the recorded takes."""

from __future__ import annotations

import bpy

from handfit_core.common.skeleton import SIDES

from ..common.section import Section, note, props, row_of, split
from ..common.wording import capitalised
from ..session import live
from ..session.live_takes import takes

_PICTURE = 10.0
"""The height of the small picture, in heights of a button"""


class MANIENT_PT_live(Section, bpy.types.Panel):
    bl_label = "Live"
    bl_order = 3

    def draw(self, context):
        layout, settings, session = self.layout, context.scene.manient.live, live.running()
        column = split(layout.column())
        column.enabled = session is None
        props(column, settings, "source", "size", "fps", "mirror")
        for side in SIDES:
            self._hand(column, getattr(settings, side), side)
        column = split(layout.column())
        props(column, settings, "countdown", "play", "folder")
        row = row_of(layout, scale=1.5)
        if session is None:
            row.operator("manient.live", icon="RADIOBUT_ON")
            if live.current is not None and live.current.error is not None:
                note(layout, capitalised(str(live.current.error)), "ERROR")
            elif live.current is not None and live.current.message:
                note(layout, live.current.message, "INFO")
        else:
            row.operator("manient.live_stop", icon="CANCEL")
            self._running(context, session)
        self._takes(context)

    def _hand(self, layout, hand, side: str) -> None:
        column = layout.column(heading=f"{side.capitalize()} Hand")
        row = column.row(align=True)
        row.prop(hand, "use", text="")
        part = row_of(row, hand.use)
        part.prop(hand, "character", text="")
        if hand.character is not None:
            part.prop(hand, "other_side", text="", icon="MOD_MIRROR")
            row_of(column, hand.use).prop(hand.character.manient.character, "wrist", text="")

    def _running(self, context, session: live.LiveSession) -> None:
        layout = self.layout
        row = layout.row(align=True)
        text = "Stop Recording" if session.is_recording else "Record"
        row.operator("manient.live_record", text=text, icon="SNAP_FACE" if session.is_recording else "REC")
        row.operator("manient.live_snapshot", icon="KEYTYPE_KEYFRAME_VEC")
        layout.operator("manient.live_calibrate", icon="VIEW_PAN")
        note(layout, session.status(), "REC" if session.is_recording else "TIME")
        states = [f"{side}: {state}" for side, state in session.hand_states.items()]
        if states:
            note(layout, ", ".join(states).capitalize(), "VIEW_PAN")
        if session.message:
            note(layout, session.message, "INFO")
        if live.pictures.icon:
            layout.template_icon(live.pictures.icon, scale=_PICTURE)

    def _takes(self, context) -> None:
        session = live.running()
        if session is not None and session.has_set_aside:
            note(self.layout, "Takes are hidden while the hands follow", "HIDE_ON")
        for index, take in enumerate(takes):
            row = self.layout.row(align=True)
            row.label(text=take.text(), icon="FILE_MOVIE", translate=False)
            for collection in take.collections[:1]:
                row.prop(collection, "hide_viewport", text="")
            row.operator("manient.live_keep", text="", icon="CHECKMARK").index = index
            row.operator("manient.live_throw_away", text="", icon="TRASH").index = index
            if take.trouble:
                note(self.layout, capitalised(take.trouble), "INFO")
