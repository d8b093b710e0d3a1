"""Files of Blender's with hostile takes, corrections and properties in them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from tests.hostile import takes
from tests.hostile.engine import Case, Place
from tests.hostile.mutations import json_with, mutants
from tests.hostile.npz import DEEP, VALUES, header_lies, lies, some

CORRECTION: dict[str, Any] = {
    "version": 1,
    "frames": {
        "3": {
            "pins": {"8": [10.0, 20.0]}, "touches": {"12": 4}, "spread": 4.0, "added_key": False, "keyed": True,
            "rotation": np.zeros((16, 3)).tolist(), "location": [0.0, 0.0, 0.0],
            "start_rotation": np.zeros((16, 3)).tolist(), "start_location": [0.0, 0.0, 0.0],
        }
    },
}  # fmt: skip
"""As docs and `CorrectionField.to_json` have it."""

TEXTS: dict[str, str] = {
    "words": "words", "brackets": "[" * DEEP, "number": "5", "null": "null", "list": "[]", "object": "{}",
    "long": "A" * 5_000_000, "names": '{"x": 5, "Wrist": [1, 2, 3, 4]}', "nested": '{"frames": {"1": 5}, "version": 1}',
    "newline": "a\nb", "shell": "$(touch canary)",
}  # fmt: skip
NUMBERS = {
    "minus": -1, "huge": 2**31 - 1, "infinity": float("inf"), "nan": float("nan"), "zero": 0, "large": 1e30,
}  # fmt: skip
RAW: dict[str, Any] = {
    "text": "x", "number": 5, "float": 1e300, "list": [1, 2], "dict": {"a": 1}, "empty": "",
}  # fmt: skip
PROPERTIES: dict[str, str] = {
    "hand": "is_hand side capture mesh track betas corrections locked show_confidence own_colors",
    "capture": "is_capture take digest camera frame_offset frame_scale source_take source_digest scene_rate",
    "scene": "source spread hands",
}
"""Which of an owner's properties hold each of RAW"""
OTHERS: dict[str, tuple[str, str]] = {
    "marks": ("action", "[manient_corrections]"),
    "manient_all_keys": ("action", "[manient_all_keys]"),
    "manient_simplified": ("action", "[manient_simplified]"),
    "manient_below": ("action", "[manient_below]"),
    "pose": ("pose", "[manient_pose]"),
    "pose-side": ("pose", "[manient_pose][side]"),
    "pose-hand_pose": ("pose", "[manient_pose][hand_pose]"),
}
"""Properties that belong to no group and do so too"""


def _blend(name: str, *changes: tuple[str, str, Any], known: bool = False) -> Case:
    return Case(f"blend-{name}", "blender.blend", lambda _: {"changes": changes}, known=known)


def _corrections(text: str) -> tuple[str, str, Any]:
    """The change that gives the hand's action this text for corrections."""
    return "action", "[manient_corrections]", {"0": text}


def _holding(case: Case) -> Case:
    """A file that keeps the take of another case, which is called x-NAME."""

    def make(place: Place) -> dict[str, Any]:
        return {"changes": [], "take": case.make(place)["path"]}

    return Case(f"blend-take{case.name[1:]}", "blender.blend", make, known=case.known)


def cases() -> Iterator[Case]:
    for owner, names, values in (
        ("hand", "side own_colors", TEXTS), ("capture", "take digest", TEXTS),
        ("scene", "source model_path", TEXTS), ("hand", "track", NUMBERS), ("capture", "frame_offset frame_scale", NUMBERS),
    ):  # fmt: skip
        for name in names.split():
            shown = [("hand", "show_confidence", True)] if name == "own_colors" else []
            for kind, value in values.items():
                yield _blend(f"{owner}-{name}-{kind}", *shown, (owner, name, value))
    for kind, text in TEXTS.items():
        yield _blend(f"corrections-{kind}", _corrections(text))
    yield _blend("betas-huge", ("hand", "betas", [1e30] * 10))
    yield _blend("betas-nan", ("hand", "betas", [float("nan")] * 10), known=True)
    yield _blend("no-capture", ("hand", "capture", None))
    yield _blend("mesh-is-itself", ("hand", "mesh", "hand"))
    yield _blend("camera-is-a-hand", ("capture", "camera", "hand"))
    for raw, value in RAW.items():
        for owner, names in PROPERTIES.items():
            yield _blend(f"{owner}-group-{raw}", (owner, "[manient]", value))
            for name in names.split():
                yield _blend(f"{owner}-{name}-raw-{raw}", (owner, f"[manient][{name}]", value))
        for name, (owner, place) in OTHERS.items():
            yield _blend(f"{name}-{raw}", (owner, place, value))
    of_frame = ("pins", "touches", "spread", "rotation", "location", "start_rotation", "start_location")
    for path in (("version",), ("frames",), ("frames", "3"), *(("frames", "3", name) for name in of_frame)):
        for lie, text in VALUES.items():
            yield _blend(f"correction-{path[-1]}-{lie}", _corrections(json_with(CORRECTION, path, text)))
    kept = ("x", "core.take", takes.one_hand, "take.npz")
    for case in (*lies(*kept), *header_lies(*kept, takes.HEADER)):
        if case.known or some(case.name, 6):
            yield _holding(case)
    for case in mutants("x", "core.take", takes.good_bytes, "take.npz", 1):
        yield _holding(case)
