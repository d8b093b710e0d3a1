"""Files of Blender's with hostile takes, corrections and properties in them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from tests.hostile import takes
from tests.hostile.engine import Case, Place
from tests.hostile.mutations import MUTATIONS, mutated, told
from tests.hostile.npz import DEEP, VALUES, header_lies, lies

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
    "text": "x",
    "number": 5,
    "float": 1e300,
    "list": [1, 2],
    "dict": {"a": 1},
    "empty": "",
}

HAND = "is_hand side capture mesh track betas corrections locked show_confidence own_colors".split()
CAPTURE = (
    "is_capture take digest camera frame_offset frame_scale source_take source_digest scene_rate".split()
)


def _blend(name: str, *changes: tuple[str, str, Any], known: bool = False) -> Case:
    return Case(f"blend-{name}", "blender.blend", lambda _: {"changes": changes}, known=known)


def cases() -> Iterator[Case]:
    for owner, name in (
        ("hand", "side"), ("hand", "corrections"), ("hand", "own_colors"), ("capture", "take"), ("capture", "digest"),
        ("scene", "source"), ("scene", "model_path"),
    ):  # fmt: skip
        for text, value in TEXTS.items():
            more = (("hand", "show_confidence", True),) if name == "own_colors" else ()
            yield _blend(f"{owner}-{name}-{text}", *more, (owner, name, value))
    for owner, name in (("hand", "track"), ("capture", "frame_offset"), ("capture", "frame_scale")):
        for number, value in NUMBERS.items():
            yield _blend(f"{owner}-{name}-{number}", (owner, name, value))
    yield _blend("betas-huge", ("hand", "betas", [1e30] * 10))
    yield _blend("betas-nan", ("hand", "betas", [float("nan")] * 10), known=True)
    yield _blend("no-capture", ("hand", "capture", None))
    yield _blend("mesh-is-itself", ("hand", "mesh", "hand"))
    yield _blend("camera-is-a-hand", ("capture", "camera", "hand"))
    for owner, names in (("hand", HAND), ("capture", CAPTURE), ("scene", ("source", "spread", "hands"))):
        for raw, value in RAW.items():
            yield _blend(f"{owner}-group-{raw}", (owner, "[manient]", value))
            for name in names:
                yield _blend(f"{owner}-{name}-raw-{raw}", (owner, f"[manient][{name}]", value))
    for raw, value in RAW.items():
        yield _blend(f"marks-{raw}", ("action", "[manient_corrections]", value))
        for name in ("manient_all_keys", "manient_simplified", "manient_below"):
            yield _blend(f"{name}-{raw}", ("action", f"[{name}]", value))
        yield _blend(f"pose-{raw}", ("pose", "[manient_pose]", value))
        for name in ("side", "hand_pose"):
            yield _blend(f"pose-{name}-{raw}", ("pose", f"[manient_pose][{name}]", value))
    of_frame = ("pins", "touches", "spread", "rotation", "location", "start_rotation", "start_location")
    for path in (("version",), ("frames",), ("frames", "3"), *(("frames", "3", name) for name in of_frame)):
        for lie, text in VALUES.items():
            changes = [("hand", "corrections", told(CORRECTION, path, text))]
            yield _blend(f"correction-{path[-1]}-{lie}", *changes)
    taken = [
        *lies("x", "x", takes.one_hand, "take.npz"),
        *header_lies("x", "x", takes.one_hand, "take.npz", takes.HEADER),
    ]
    for case in taken:
        if case.known or sum(case.name.encode()) % 6 == 0:

            def kept(place: Place, made=case.make) -> dict[str, Any]:
                return {"changes": [], "take": made(place)["path"]}

            yield Case(f"blend-take{case.name[1:]}", "blender.blend", kept, known=case.known)
    for mutation in MUTATIONS:

        def damaged(place: Place, mutation=mutation) -> dict[str, Any]:
            data = mutated(takes.good_bytes(), mutation, place.rng)
            return {"changes": [], "take": str(place.write("take.npz", data))}

        yield Case(f"blend-take-{mutation.__name__}", "blender.blend", damaged)
