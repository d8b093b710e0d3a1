"""Blender's doors: takes that are imported, and files that are opened.

Needs one of the bpy wheels. What an operator raises is a report of Blender's: a sentence, or a traceback.
"""

from __future__ import annotations

import base64
import contextlib
import hashlib
import io
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy

import blender_manient
from blender_manient import modules
from blender_manient.scene import corrections, store
from blender_manient.scene.build import build_take
from handfit_core.common.errors import HandfitError
from handfit_core.media.source import Source
from scripts import batch_fit
from tests.drawn import drawn
from tests.hostile.core import check_ending, check_take
from tests.hostile.takes import good_take

blender_manient.register()


def _empty() -> None:
    store._cache.clear()
    bpy.ops.wm.read_factory_settings(use_empty=True)


@contextlib.contextmanager
def _reports() -> Iterator[None]:
    """Blender's reports of errors as HandfitErrors; tracebacks as they are."""
    try:
        yield
    except RuntimeError as error:
        if "Traceback" in str(error) or not str(error).startswith(
            ("Error: ", "Warning: ", "Operator bpy.ops")
        ):
            raise
        lines = str(error).strip().splitlines()
        assert all(line.startswith(("Error: ", "Warning: ", "Operator ", "Info: ")) for line in lines), error
        raise HandfitError(lines[-1]) from error


def import_take(path: str) -> None:
    """File > Import, and what is drawn and done with the hands then."""
    _empty()
    with _reports():
        bpy.ops.manient.import_take(filepath=path)
    for armature in store.captured_hands(bpy.context.scene):
        check_take(store.kept_take(armature.manient.capture))
    _work_on()


def import_of(path: str, kind: str) -> None:
    """A take whose picture has this name, relative ones included; Blender loads the picture."""
    _empty()
    build_take(good_take(source=Source(kind, (path,))))  # type: ignore[arg-type]
    _work_on()


def blend(changes: list[tuple[str, str, Any]], take: str = "") -> None:
    """A file with captured hands, of which something was changed behind the add-on's back; opened again.

    changes: (owner, property, value), with `hand`, `capture`, `scene`, `action` and `pose` as owners; a property in
    brackets is one of the owner's own, as [manient], or one of the add-on's group as any script can set it.
    take: the file of a take that is kept instead of the good one, with the digest that belongs to it.
    """
    _empty()
    built = build_take(good_take())
    armature = built.hands[0].armature
    owners = {
        "hand": armature,
        "capture": built.collection,
        "scene": bpy.context.scene,
        "action": armature.animation_data.action,
    }
    if any(owner == "pose" for owner, _, _ in changes):
        bpy.context.view_layer.objects.active = armature
        bpy.ops.manient.save_pose_asset(asset_name=OWN_POSE)
        owners["pose"] = bpy.data.actions[OWN_POSE].asset_data
    if take:
        data = Path(take).read_bytes()
        built.collection.manient.take = base64.b64encode(data).decode()
        built.collection.manient.digest = hashlib.sha256(data).hexdigest()[:32]
    for owner, name, value in changes:
        block = owners[owner]
        with contextlib.suppress(TypeError, ValueError, KeyError, AttributeError, OverflowError):
            # What Blender itself refuses cannot get into a file.
            if name.startswith("["):
                *groups, last = name.strip("[]").split("][")
                for group in groups:
                    block = block[group]
                block[last] = value
            else:
                setattr(block.manient, name, owners.get(value, value) if isinstance(value, str) else value)
    bpy.ops.wm.save_as_mainfile(filepath=os.path.abspath("result/a.blend"))  # noqa: PTH100
    store._cache.clear()
    corrections._read.cache_clear()
    bpy.ops.wm.open_mainfile(filepath=os.path.abspath("result/a.blend"))  # noqa: PTH100
    _work_on()


OWN_POSE = "Fist"
"""An asset that a file may hold, and else a ready pose"""
OPERATORS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("lock_joints", {"lock": True}),
    ("jump_doubtful", {"hand": "?"}),
    ("mark_doubtful", {"hand": "?"}),
    ("select_hand", {"hand": "?"}),
    ("clear_corrections", {"scope": "FRAME"}),
    ("apply_pose", {}),
    ("apply_pose", {"pose": OWN_POSE}),
    ("reset_shape", {}),
    ("apply_take", {"source": "?"}),
    ("mirror_hand", {}),
    ("save_pose_asset", {}),
    ("clear_corrections", {"scope": "ALL"}),
    ("restore_keys", {}),
    ("simplify_keys", {}),
    ("add_key_layer", {}),
    ("end_key_layer", {"merge": True}),
    ("export_hand", {"filepath": "result/hand.npz"}),
)


def _work_on() -> None:
    """Draw every panel, ask every operator, and run those that change the hands; raises the first refusal."""
    refusals: list[HandfitError] = []
    scene = bpy.context.scene
    hands = [o for o in scene.objects if o.type == "ARMATURE"]
    names = [hand.name for hand in hands]
    if hands:
        bpy.context.view_layer.objects.active = hands[0]
    _draw()
    for name in dir(bpy.ops.manient):
        getattr(bpy.ops.manient, name).poll()
    scene.manient.export_format = "npz"
    for name, arguments in OPERATORS:
        given = {
            key: (names[0] if names else "") if value == "?" else value for key, value in arguments.items()
        }
        operator = getattr(bpy.ops.manient, name)
        try:
            with _reports():
                if operator.poll():
                    operator(**given)
        except HandfitError as error:
            refusals.append(error)
    for hand in names:
        with contextlib.suppress(HandfitError), _reports():
            bpy.data.objects[hand].manient.show_confidence ^= True
    _draw()
    for frame in (-5, 3, 900):
        scene.frame_set(frame)
    if refusals:
        raise refusals[0]


def _draw() -> None:
    for cls in (c for module in modules.MODULES for c in module.classes):
        if issubclass(cls, bpy.types.Panel):
            drawn(cls)


def batch(argv: list[str], code: int) -> None:
    """scripts/batch_fit.py in this process: its exit code, and what stands in its report."""
    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()) as out:
        ended = batch_fit.main(argv)
    report = Path("result/report.json")
    if report.exists():
        for result in json.loads(report.read_text())["inputs"]:
            assert not result["error"].startswith("unexpected"), result["error"]
            assert result["status"] in ("ok", "failed"), result
    assert ended == code, f"exit code {ended}: {out.getvalue()}{said.getvalue()}"
    if ended == 2:
        check_ending(1, said.getvalue())


DOORS: dict[str, Callable[..., Any]] = {
    door.__name__: door for door in (import_take, import_of, blend, batch)
}
