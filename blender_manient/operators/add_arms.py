"""Add Arms: the arms of a capture's hands are found in its pictures, after the hands."""

from __future__ import annotations

import bpy

from handfit_core.common.errors import OptionError
from handfit_core.take import Take

from ..common import preferences, screen
from ..common.block_reference import BlockReference
from ..common.wording import capitalised, counted
from ..rigs.arm import has_arm
from ..scene.arms import add_arms, check_lacks_arms, hands_of
from ..scene.store import captured_take
from ..session import shared_worker
from ..session.cache import temporary_take
from .base import StepsOperator, named_hand, show_frame_again
from .capture import why_no_capture


class MANIENT_OT_add_arms(StepsOperator, bpy.types.Operator):
    """Find the arms of this capture's hands in its pictures, and give each hand an upper arm and a forearm.
    The hands, with all that you changed in them, stay as they are."""

    bl_label = "Add Arms"
    title = "Finding arms"
    undone = "finding arms was stopped by an undo: nothing was changed"

    hand: bpy.props.StringProperty(options={"HIDDEN", "SKIP_SAVE"})

    @classmethod
    def poll_reason(cls, context):
        if cls.bl_idname in cls.running:
            return "Arms are being found already"
        return why_no_capture(context)

    def steps(self, context):
        collection = named_hand(context, self.hand).collection
        check_lacks_arms(collection)
        capture, take = BlockReference.of("collections", collection), captured_take(collection)
        if any(track.arm is None and not track.no_arm for track in take.hands):
            source, found = temporary_take(take.source.name), temporary_take(take.source.name)
            take.save(source)
            yield from shared_worker.ask(
                "arms",
                "Finding arms",
                take=str(source),
                output=str(found),
                compact=True,
                max_megapixels=preferences.get(context).max_megapixels or None,
            )
            take = Take.load(found)
        if type(self).bl_idname in self.running:
            self.running[type(self).bl_idname].can_stop = False
        collection = capture.find()
        if collection is None:
            raise OptionError("the capture is gone: its arms were not added")
        add_arms(collection, take)
        return capture

    def finished(self, context, result):
        show_frame_again(context)
        screen.redraw_sidebars()
        hands = hands_of(result.find())
        count = sum(has_arm(hand.armature) for hand in hands)
        reasons = dict.fromkeys(capitalised(hand.track.no_arm) for hand in hands if hand.track.no_arm)
        said = [f"{counted(count, 'arm')} added"] if count else []
        return self._done(". ".join([*said, *reasons]), kind="INFO" if count else "WARNING")
