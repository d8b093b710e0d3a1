"""Folders of a batch's results: plans, seals and signs of life that are damaged, that lie, or that are no files."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from handfit_core.options import CaptureOptions
from handfit_core.version import __version__
from tests.hostile.engine import RESULTS, Case, Place
from tests.hostile.mutations import MUTATIONS, mutated, told
from tests.hostile.npz import VALUES

PLAN = f"{RESULTS}/plans/0123456789ab.json"
DONE, FAILED, OPEN, PART, WHOLE = "done", "failed", "open", "clip.part1", "clip"
"""Tasks of the good plan: one that is sealed, one that failed, and others that nobody has begun"""
RESULT = b"what came of it"
SECRET = "kept.npz"
"""The artist's file beside the folder of results"""


def id_of(name: str) -> str:
    return hashlib.sha256(name.encode()).hexdigest()[:16]


def task(name: str, **more: Any) -> dict[str, Any]:
    common = {"shown": f"{name}.mp4", "source": [f"/nowhere/{name}.mp4"], "made_of": "0" * 32, "cost": 2.5}
    return {"id": id_of(name), "name": name, **common, **more}


def good_plan() -> dict[str, Any]:
    make = {"format": "glb", "hands": "auto", "wrist": None, "reference": None, "into": None, "bones": None}
    make |= dict.fromkeys(("preview", "no_sheet", "no_picture", "no_correctives", "no_contacts"), False)
    parts = task(PART, part="1-96", of=id_of(WHOLE)), task(WHOLE, needs=[id_of(PART)])
    return {
        "format": "manient-plan",
        "version": 1,
        "tasks": [task(DONE), task(FAILED), task(OPEN), *parts],
        "options": {"capture": CaptureOptions().to_message(), "make": {**make, "apply_to": None}},
        "flat": False,
        "overwrite": False,
        "files": [["/nowhere/MANO_RIGHT.pkl", "0" * 32]],
        "command": ["blender", "--command", "manient"],
        "made_by": __version__,
        "created": "2026-01-01T00:00:00+00:00",
    }


def seal(name: str, status: str, **more: Any) -> dict[str, Any]:
    """`done.json` or `failed.json` of a task."""
    hand = {"side": "left", "detected": 3, "doubtful": 1, "mean_reprojection_error_px": 2.5}
    hand |= {"mean_error_of_hand": 0.02, "mean_expected_error": 0.01}
    attempt = {"error": "no hand", "kind": "InputError", "host": "a", "seconds": 1.5, "at": "2026-01-01"}
    result = {"input": f"{name}.mp4", "name": name, "status": status, "seconds": 2.5, "frames": 3}
    result |= {"hands": [hand], "character": None, "files": [f"{name}/a.txt"], "warnings": ["a"], "error": ""}
    result |= {"id": id_of(name), "host": "a", "attempts": [attempt]}
    files = {"a.txt": {"size": len(RESULT), "sha256": hashlib.sha256(RESULT).hexdigest()}}
    return {
        "format": "manient-task",
        "version": 1,
        "id": id_of(name),
        "result": result,
        "files": files,
        **more,
    }


GOOD: dict[str, Callable[[], dict[str, Any]]] = {
    PLAN: good_plan,
    f"{RESULTS}/{DONE}/done.json": lambda: seal(DONE, "ok", versions={"manient": "1"}, host="a", seconds=2.5),
    f"{RESULTS}/{FAILED}/failed.json": lambda: seal(FAILED, "failed"),
    f"{RESULTS}/{OPEN}/running.json": lambda: {
        "format": "manient-task", "version": 1, "id": id_of(OPEN), "token": "0" * 32, "host": "a", "pid": 1,
        "boot": "a", "started": "1",
    },
}  # fmt: skip
"""What a folder of results holds, by the place of each file"""
_SEAL = (
    "format version id result result.name result.status result.hands result.hands.0 result.hands.0.side "
    "result.hands.0.detected result.frames result.files result.warnings result.attempts result.attempts.0.kind "
    "result.error result.character files files.a&txt files.a&txt.size files.a&txt.sha256"
)
FIELDS: dict[str, str] = {
    PLAN: "format version tasks tasks.0 tasks.0.id tasks.0.name tasks.0.shown tasks.0.source tasks.0.take "
    "tasks.0.error tasks.0.made_of tasks.0.cost tasks.3.of tasks.3.part tasks.4.needs options options.capture "
    "options.make options.make.format options.make.apply_to options.capture.solver options.capture.frames "
    "options.capture.model flat overwrite files files.0 command made_by created",
    f"{RESULTS}/{DONE}/done.json": f"{_SEAL} versions host seconds",
    f"{RESULTS}/{FAILED}/failed.json": _SEAL,
    f"{RESULTS}/{OPEN}/running.json": "format version id token host pid boot started",
}
"""Fields of each, of which every one is to hold each of VALUES; & stands for a dot in a name"""

NAMES = {
    "up": "../../" + SECRET, "root": "/etc/passwd", "nul": "a\0b", "surrogate": "\ud800", "drive": "C:\\x", "empty": "",
    "dot": ".", "long": "x" * 5000, "slashes": "a/" * 3000 + "b", "seal": "done.json", "link": "link/" + SECRET,
}  # fmt: skip
"""What a result may be called, and an input's folder"""
TASK_NAMES = {
    **NAMES, "plans": "plans", "report": "report.json", "part": ".part-x", "device": "con", "turned": "\u202e",
    "quotes": "'\"`$(touch canary)`\n#", "tag": "<script>canary</script>", "option": "--again", "case": "DONE",
}  # fmt: skip


def with_plan(**changes: Any) -> bytes:
    return json.dumps({**good_plan(), **changes}).encode()


PLANS: dict[str, Callable[[], bytes]] = {
    "nothing": lambda: b"",
    "words": lambda: b"words",
    "no-object": lambda: b"[]",
    "not-utf-8": lambda: b"\xff\xfe{}",
    "deep": lambda: b"[" * 200_000 + b"]" * 200_000,
    "lists": lambda: b"[" + b"[]," * 15_000_000 + b"[]]",
    "objects": lambda: b"[" + b'{"":0},' * 6_000_000 + b"{}]",
    "numbers": lambda: b"[" + b"0.5," * 30_000_000 + b"1]",
    "text": lambda: b'"' + b"x" * 60_000_000 + b'"',
    "whole": lambda: b'{"version": ' + b"9" * 5_000_000 + b"}",
    "keys": lambda: ("{" + ",".join(f'"{n}": 0' for n in range(500_000)) + "}").encode(),
    "unknown": lambda: with_plan(surprise={"a": 1}),
    "many": lambda: with_plan(tasks=[task(f"t{n}") for n in range(20_000)]),
    "same": lambda: with_plan(tasks=[task("same")] * 20_000),
    "equal-names": lambda: with_plan(tasks=[{**task(f"t{n}"), "name": "same"} for n in range(300)]),
    "itself": lambda: with_plan(tasks=[task("a", needs=[id_of("a")])]),
    "circle": lambda: with_plan(tasks=[task("a", needs=[id_of("b")]), task("b", needs=[id_of("a")])]),
    "parts-circle": lambda: with_plan(
        tasks=[
            task("a", of=id_of("b"), needs=[id_of("b")]),
            task("b", of=id_of("a"), needs=[id_of("a")]),
        ]
    ),
    "long-chain": lambda: with_plan(
        tasks=[task(f"t{n}", needs=[id_of(f"t{n + 1}")]) for n in range(3000)] + [task("t3000")]
    ),
    "no-such-part": lambda: with_plan(tasks=[task("a", needs=["0" * 16])]),
    "part-of-nothing": lambda: with_plan(tasks=[task("a", of="0" * 16, part="1-2")]),
    "odd-task": lambda: with_plan(tasks=[task("a", surprise="x")]),
    "files-long": lambda: with_plan(files=[["/nowhere/" + "x" * 40_000, "0"]]),
    "files-odd": lambda: with_plan(files=[["a"], ["a", "b", "c"]]),
    "files-device": lambda: with_plan(files=[["/dev/zero", "0" * 32]]),
    "command-device": lambda: with_plan(command=["/dev/zero"]),
    "command-empty": lambda: with_plan(command=[]),
    "command-code": lambda: with_plan(command=["$(touch canary)", "`touch canary`", "'; touch canary; '"]),
}
REFUSED = {"nothing", "words", "no-object", "not-utf-8", "deep", "lists", "objects", "numbers", "text", "whole",
           "keys", "itself", "circle", "parts-circle", "long-chain", "no-such-part", "part-of-nothing", "odd-task",
           "files-long", "files-odd"}  # fmt: skip


def _pipe(path: Path) -> None:
    os.mkfifo(path)


def _sparse(path: Path) -> None:
    with path.open("wb") as stream:
        stream.truncate(1 << 36)


ODD: dict[str, Callable[[Path], None]] = {
    "pipe": _pipe,
    "folder": lambda path: path.mkdir(),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "link": lambda path: path.symlink_to(Path("../..") / SECRET),
    "circle": lambda path: path.symlink_to(path.name),
    "gone": lambda path: path.symlink_to("nowhere"),
    "sparse": _sparse,
}
"""What may lie in the place of a file"""


def laid_out(place: Place, changed: dict[str, bytes] | None = None) -> dict[str, Any]:
    """A folder of results with some of its files' bytes changed; the arguments of the door `farm`."""
    data = {name: json.dumps(content(), indent=1).encode() for name, content in GOOD.items()}
    for name, content in (data | (changed or {})).items():
        place.write(name, content)
    for name in (DONE, FAILED):
        place.write(f"{RESULTS}/{name}/a.txt", RESULT)
        (place.folder / RESULTS / name / "link").symlink_to("../..")
    return {"path": str(place.folder / PLAN)}


def cases() -> Iterator[Case]:
    for file, content in GOOD.items():
        stem = f"farm-{Path(file).stem if file != PLAN else 'plan'}"
        good = partial(lambda content: json.dumps(content()).encode(), content)
        for mutation in MUTATIONS:
            for number in range(6):

                def mutant(place: Place, file=file, good=good, mutation=mutation) -> dict[str, Any]:
                    return laid_out(place, {file: mutated(good(), mutation, place.rng)})

                yield Case(f"{stem}-{mutation.__name__}-{number}", "core.farm", mutant)
        for field in FIELDS[file].split():
            path = tuple(int(key) if key.isdigit() else key.replace("&", ".") for key in field.split("."))
            for value, text in VALUES.items():

                def lie(place: Place, file=file, content=content, path=path, text=text) -> dict[str, Any]:
                    return laid_out(place, {file: told(content(), path, text).encode()})

                name = f"{stem}-{field.replace('.', '-').replace('&', '-')}-{value}"
                yield Case(name, "core.farm", lie, known=(field, value) == ("tasks.0.cost", "huge"))
                if field.startswith("options"):
                    yield Case(f"order-{name}", "blender.order", lie)
        for kind, put in ODD.items():

            def odd(place: Place, file=file, put=put) -> dict[str, Any]:
                arguments = laid_out(place)
                (place.folder / file).unlink()
                put(place.folder / file)
                return arguments

            refused = file == PLAN
            yield Case(f"{stem}-is-a-{kind}", "core.farm", odd, refused, known=kind == "pipe")
    for kind, data in PLANS.items():
        made = partial(lambda data, place: laid_out(place, {PLAN: data()}), data)
        yield Case(f"farm-plan-{kind}", "core.farm", made, kind in REFUSED, known="circle" in kind)
    for kind, name in TASK_NAMES.items():
        for flat in (False, True):
            plan = with_plan(tasks=[{**task("a"), "name": name}], flat=flat)
            made = partial(lambda plan, place: laid_out(place, {PLAN: plan}), plan)
            yield Case(f"farm-plan-called-{kind}{'-flat' * flat}", "core.farm", made)
    for which, name in ((DONE, "done"), (FAILED, "failed")):
        file = f"{RESULTS}/{which}/{name}.json"
        for kind, called in NAMES.items():
            for size in (len(RESULT), 0, 27):  # 27: of the artist's file

                def named(place: Place, file=file, called=called, size=size) -> dict[str, Any]:
                    known = {"size": size, "sha256": hashlib.sha256(RESULT).hexdigest()}
                    return laid_out(
                        place, {file: json.dumps({**GOOD[file](), "files": {called: known}}).encode()}
                    )

                yield Case(f"farm-{name}-names-{kind}-{size}", "core.farm", named)
        for kind, put in ODD.items():
            for size in (0, 1 << 36):

                def result_is(place: Place, file=file, put=put, size=size) -> dict[str, Any]:
                    known = {"size": size, "sha256": hashlib.sha256(b"").hexdigest()}
                    arguments = laid_out(
                        place, {file: json.dumps({**GOOD[file](), "files": {"odd": known}}).encode()}
                    )
                    put((place.folder / file).parent / "odd")
                    return arguments

                known = kind == "pipe"
                yield Case(f"farm-{name}-result-is-a-{kind}-{size}", "core.farm", result_is, known=known)
        for kind, data in PLANS.items():
            if kind in ("nothing", "words", "deep", "whole", "keys"):
                made = partial(lambda file, data, place: laid_out(place, {file: data()}), file, data)
                yield Case(f"farm-{name}-holds-{kind}", "core.farm", made)
