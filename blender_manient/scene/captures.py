"""The captures of a scene: which there are, which one is active, what of them is shown, and their removal.

A capture is the collection that keeps its take, wherever in the scene it lies and whatever it is called now.
The active one is that whose own camera the scene has; before a camera of the artist's it is the one that was
chosen last. A capture is hidden by its collection's two switches, "Disable in Viewports" and "Disable in
Renders": what the artist has hidden or excluded object by object, or in one view layer, stays as it is,
and nothing that is hidden is evaluated. What the artist has put into another collection as well stays
visible there.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from handfit_core.common.errors import TakeError
from handfit_core.take.views import Verdict

from ..common.wording import counted
from .background import drive_offset
from .camera import frame_scene
from .confidence import errors_of, is_marked, mark_doubtful
from .matching import Choice, Footage, has_matched_size, has_matched_time, is_of_a_capture, note_matched
from .own_scene import remove_blocks
from .render_setup import OURS, follow_camera
from .simplify import DENSE
from .store import captured_hands, clip_timing, hand_of, has_properties, kept_take
from .timing import Timing, set_timing


def captures(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    """Return the collections of a scene that keep a take, by name."""
    if not has_properties():  # scripts may build hands without the add-on
        return []
    found = dict.fromkeys(c for c in scene.collection.children_recursive if c.manient.is_capture)
    return sorted(found, key=lambda capture: capture.name)


def active_capture(scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """Return the capture that the scene looks at; None where there is none."""
    found = captures(scene)
    if not found:
        return None
    seen = [c for c in found if scene.camera is not None and scene.camera in cameras_of(c)]
    for choice in (seen, found):
        if scene.manient.capture in choice:
            return scene.manient.capture
        if seen:
            return seen[0]
    return next((c for c in found if not c.hide_viewport), found[0])


def own_camera(capture: bpy.types.Collection) -> bpy.types.Object | None:
    """Return the camera that was built with a capture; None where it has the artist's, or the camera was
    deleted or moved to another collection."""
    camera = capture.manient.camera
    return camera if camera in cameras_of(capture) else None


def cameras_of(capture: bpy.types.Collection) -> list[bpy.types.Object]:
    """Return the cameras that were built with a capture, one for each view, without those that were deleted
    or moved to another collection."""
    kept = capture.manient
    return [c for c in (kept.camera, kept.view_camera) if c is not None and c.name in capture.objects]


def other_camera(scene: bpy.types.Scene, capture: bpy.types.Collection) -> bpy.types.Object:
    """Return the capture's camera that the scene does not look through; of two of them the first view's."""
    return next(camera for camera in cameras_of(capture) if camera != scene.camera)


def switch_view(scene: bpy.types.Scene, capture: bpy.types.Collection) -> None:
    """Have the scene look through the capture's other camera; the picture's size follows as in `show`."""
    scene.camera = other_camera(scene, capture)
    _frame(scene, capture)
    follow_camera(scene)


def leave_other_view(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Have the scene look through this camera if it looks through the other one of the same capture, whose
    picture may be of another size."""
    capture = active_capture(scene)
    if capture is None or camera == scene.camera:
        return
    if {camera, scene.camera} <= set(cameras_of(capture)):
        switch_view(scene, capture)


def in_view(scene: bpy.types.Scene) -> bool:
    """True if the scene's camera is one that a capture has built."""
    return has_properties() and scene.camera is not None and is_of_a_capture(scene.camera)


def becomes_active(scene: bpy.types.Scene, choice: Choice, matched: bool) -> bool:
    """True if a new capture becomes the active one, with its own camera: in a scene that is matched to it,
    and in one that looks through another capture's camera, unless the artist keeps that, or is at work on an
    object in another mode."""
    looked_at = matched or (choice == "AUTO" and in_view(scene))
    return looked_at and bpy.context.mode == "OBJECT"


def is_shown(capture: bpy.types.Collection, layer: bpy.types.ViewLayer) -> bool:
    """True if viewports of a view layer show the capture's collection."""
    return any(part.collection == capture and seen for part, seen in _parts(layer.layer_collection))


def others_shown(scene: bpy.types.Scene) -> bool:
    """True if captures other than the active one are shown."""
    active, layer = active_capture(scene), _layer_of(scene)
    return any(is_shown(c, layer) for c in captures(scene) if c != active)


def hide_others(scene: bpy.types.Scene, hide: bool = True) -> None:
    """Hide all captures but the active one in viewports and renders, or show them all again."""
    active = active_capture(scene)
    for capture in captures(scene):
        if hide and capture != active:
            _hide(capture)
        else:
            _show(capture, scene)
    _follow_selection(scene, active)


def add(scene: bpy.types.Scene, capture: bpy.types.Collection, *, in_front: bool) -> None:
    """Link a new capture to a scene, `in_front` as the active one, as `show` makes it."""
    alone = not others_shown(scene)
    scene.collection.children.link(capture)
    if in_front:
        _activate(scene, capture, alone)


def show(scene: bpy.types.Scene, capture: bpy.types.Collection) -> None:
    """Make a capture the active one: show it, and hide the others if those beside the active one are hidden.

    The scene looks through the capture's camera, unless it has a camera of the artist's. Picture size, rate
    and range follow as long as they are what other footage has given to the scene.
    """
    _activate(scene, capture, not others_shown(scene))


def _activate(scene: bpy.types.Scene, capture: bpy.types.Collection, alone: bool) -> None:
    scene.manient.capture = capture
    _show(capture, scene)
    camera = own_camera(capture)
    if camera is not None and (scene.camera is None or in_view(scene)):
        scene.camera = camera
        _frame(scene, capture)
    follow_camera(scene)
    if alone:
        for other in captures(scene):
            if other != capture:
                _hide(other)
    _follow_selection(scene, capture)


def remove(scene: bpy.types.Scene, capture: bpy.types.Collection) -> None:
    """Take a capture out of the scene, with its hands, their actions and markers, its camera, lights and
    picture, also behind a camera of the artist's.

    What the artist has put into its collection moves to the scene's own, as do copies of hands; that and what
    hangs on its objects elsewhere stands where it stood. Hands that another collection holds as well stay
    there, and these and copies keep their take. A collection that another scene has, too, or that is linked
    from a file, only leaves this scene.
    """
    left = [c for c in captures(scene) if c != capture]
    if left and active_capture(scene) == capture:  # first, since a view without a camera turns away
        show(scene, next((c for c in left if is_shown(c, _layer_of(scene))), left[-1]))
    elsewhere = any(capture in s.collection.children_recursive for s in bpy.data.scenes if s != scene)
    if scene.manient.capture == capture:
        scene.manient.capture = None
    if elsewhere or not capture.is_editable:
        _unlink(scene, capture)
    else:
        _delete(scene, capture)


def verdict(capture: bpy.types.Collection) -> Verdict | None:
    """Return how well the views of a capture agree; None where it has no such verdict, or its take is
    damaged."""
    try:
        return kept_take(capture).verdict
    except TakeError:
        return None


def in_words(scene: bpy.types.Scene, capture: bpy.types.Collection) -> str:
    """Return how many hands a capture has, and how good the worst of them is, as words for a list."""
    hands = [
        hand
        for thing in captured_hands(scene)
        if thing.manient.capture == capture
        if (hand := hand_of(thing))
    ]
    found = [(errors.scale, errors.mean) for errors in map(errors_of, hands)]
    words = {scale.quality(mean) for scale, mean in found if mean is not None}
    worst = [word for word in ("poor", "fair", "good") if word in words][:1]
    views = verdict(capture)
    if views is not None and views.agreement != "good":
        worst = ["views differ"]
    count = [] if worst and len(hands) == 1 else [counted(len(hands), "hand")]
    return ", ".join([*count, *worst])


def _layer_of(scene: bpy.types.Scene) -> bpy.types.ViewLayer:
    """Return the view layer of a scene that the window shows, else its first."""
    return bpy.context.view_layer if bpy.context.scene == scene else scene.view_layers[0]


def _parts(
    part: bpy.types.LayerCollection, seen: bool = True
) -> Iterator[tuple[bpy.types.LayerCollection, bool]]:
    """Yield all collections below a layer's collection, each with whether viewports show it."""
    for child in part.children:
        hidden = child.exclude or child.hide_viewport or child.collection.hide_viewport
        yield child, seen and not hidden
        yield from _parts(child, seen and not hidden)


def _hide(capture: bpy.types.Collection) -> None:
    if capture.is_editable and not capture.hide_viewport:
        capture.manient.rendered = not capture.hide_render
        capture.hide_viewport = capture.hide_render = True


def _show(capture: bpy.types.Collection, scene: bpy.types.Scene) -> None:
    if capture.is_editable and capture.hide_viewport:
        capture.hide_viewport = False
        capture.hide_render = not capture.manient.rendered
    for part, _ in list(_parts(_layer_of(scene).layer_collection)):
        if part.collection == capture:
            part.exclude = part.hide_viewport = False


def _frame(scene: bpy.types.Scene, capture: bpy.types.Collection) -> None:
    """Give the scene the capture's size, and the time of a capture that lies on its own frames, where the
    scene has those of other footage now."""
    try:
        take = kept_take(capture)
        seen = take.view(1) if scene.camera == capture.manient.view_camera and take.cameras else take
        on_own_frames = clip_timing(capture) == Timing()  # a retimed one lies on the scene's
    except TakeError:
        return
    timed = has_matched_time(scene) and on_own_frames and len(take.frame_numbers) > 1
    sized = has_matched_size(scene)
    if sized:
        frame_scene(scene, seen)
    if timed:
        set_timing(scene, take)
        if not scene.frame_start <= scene.frame_current <= scene.frame_end:
            scene.frame_set(scene.frame_start)
    footage = Footage.of_take(take, own_camera=not sized)
    note_matched(scene, footage if timed else Footage(width=footage.width, height=footage.height))


def _follow_selection(scene: bpy.types.Scene, capture: bpy.types.Collection | None) -> None:
    """Make a hand of this capture the active object, unless the active object is one of its hands already or
    a visible one of the artist's."""
    layer = _layer_of(scene)
    active = layer.objects.active
    if capture is None or (active is not None and capture in active.users_collection):
        return
    of_capture = active is not None and any(c.manient.is_capture for c in active.users_collection)
    if active is not None and not of_capture and active.visible_get(view_layer=layer):
        return
    if active is not None and active.mode != "OBJECT" and bpy.context.scene == scene:
        bpy.ops.object.mode_set(mode="OBJECT")
    hand = next((h for h in captured_hands(scene) if capture in h.users_collection), None)
    for thing in list(layer.objects.selected):
        thing.select_set(False, view_layer=layer)
    layer.objects.active = hand
    if hand is not None:
        hand.select_set(True, view_layer=layer)


def _unlink(scene: bpy.types.Scene, capture: bpy.types.Collection) -> None:
    for parent in (scene.collection, *scene.collection.children_recursive):
        if capture in parent.children.values() and parent.is_editable:
            parent.children.unlink(capture)


def _delete(scene: bpy.types.Scene, capture: bpy.types.Collection) -> None:
    _show(capture, scene)  # of what is hidden nobody knows where it stands
    _layer_of(scene).update()
    for hand in filter(None, map(hand_of, capture.objects)):
        if is_marked(scene, hand):
            mark_doubtful(scene, hand, False)
    own = [thing for thing in capture.objects if _is_own(thing, capture)]
    kept = [thing for thing in capture.objects if thing not in own]
    shared = {thing for thing in own if len(thing.users_collection) > 1}
    gone = [thing for thing in own if not {thing, thing.parent} & shared]
    active = _layer_of(scene).objects.active
    if active in gone and active.mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    for thing in bpy.data.objects:
        if thing.parent in gone and thing not in gone and thing.is_editable:
            place = thing.matrix_world.copy()
            thing.parent = None
            thing.matrix_world = place
    for thing in (*kept, *own):
        if thing not in gone and len(thing.users_collection) == 1:
            home = thing.parent.users_collection if thing.parent in shared else (scene.collection,)
            next(c for c in home if c != capture).objects.link(thing)
    for child in capture.children:
        if child not in scene.collection.children.values():
            scene.collection.children.link(child)
    _unlink(scene, capture)
    blocks: list[bpy.types.ID] = [*gone, *_plate_taken(capture)]
    if any(thing.manient.is_hand for thing in (*shared, *kept)):  # their take is here
        for thing in list(capture.objects):
            capture.objects.unlink(thing)
    else:
        blocks.append(capture)
    with_all_keys = {action.get(DENSE) for action in bpy.data.actions}  # kept by a fake user of ours
    remove_blocks(blocks, with_all_keys)


def _plate_taken(capture: bpy.types.Collection) -> list[bpy.types.Image]:
    """Take the picture that a capture has put behind the artist's camera away from there, unless another
    capture is seen before it, which has it from then on. Return the image where nobody else uses it."""
    plate, camera = capture.manient.plate, capture.manient.camera
    if plate is None or camera is None or camera.type != "CAMERA":  # any file can name another object
        return []
    capture.manient.plate = None
    others = [c for c in bpy.data.collections if c != capture and c.manient.is_capture]
    heir = next((c for c in others if c.manient.camera == camera and _files(c) & _files(capture)), None)
    if heir is not None:
        heir.manient.plate = plate
        return []
    backgrounds = camera.data.background_images
    for background in [b for b in backgrounds if b.image == plate][::-1]:
        drive_offset(background.image_user, "")
        background.image = None  # which Blender would else count as used by nobody
        backgrounds.remove(background)
    return [] if plate.users or plate.use_fake_user else [plate]


def _files(capture: bpy.types.Collection) -> set[str]:
    try:
        return set(kept_take(capture).source.files)
    except TakeError:
        return set()


def _is_own(thing: bpy.types.Object, capture: bpy.types.Collection) -> bool:
    """True if a capture has made an object of its collection: a hand, a mesh, the camera, lights, card."""
    if thing in (capture.manient.camera, capture.manient.view_camera) or OURS in thing:
        return True
    stem, _, number = thing.name.rpartition(".")
    if number.isdigit() and stem in capture.objects:  # Blender names copies so
        return False
    hand = thing if thing.manient.is_hand else thing.parent
    return hand is not None and hand.manient.capture == capture and thing in (hand, hand.manient.mesh)


def _index(scene: bpy.types.Scene) -> int:
    active = active_capture(scene)
    return -1 if active is None else bpy.data.collections.find(active.name)


def _choose(scene: bpy.types.Scene, index: int) -> None:
    chosen = bpy.data.collections[index] if 0 <= index < len(bpy.data.collections) else None
    if chosen in captures(scene):
        show(scene, chosen)


PROPERTIES = {
    (bpy.types.Scene, "manient_capture"): lambda: bpy.props.IntProperty(
        name="Active Capture",
        description="The capture whose picture and camera are shown, among all collections of the file. "
        "Click one to show it",
        get=_index,
        set=_choose,
        options={"HIDDEN"},
    )
}
"""The place of the active capture among all collections, which is kept nowhere; for the list of captures"""
