"""Every file that Blender writes, where files may not grow; test_full_disk.py runs it in a process.

    python -m tests.blender.small_disk TAKE FOLDER RESULTS

RESULTS gets a JSON list per line.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np

from blender_manient.exporters import EXPORTERS
from blender_manient.exporters.export_hands import Stage, export_hands, export_take
from blender_manient.scene.build import build_take
from blender_manient.scene.characters import CharacterObjects
from blender_manient.scene.preview import write_png
from handfit_core.common.errors import HandfitError
from handfit_core.take import Take

PAGE = 4096


def main(source: Path, folder: Path, results: Path) -> None:
    """Write each kind of file with no room, with half of what it needs, and with enough."""
    take = Take.load(source)
    built = build_take(take, picture=False)
    noise = np.random.default_rng(1).uniform(size=(100, 100, 3))
    writers: dict[str, Callable[[], object]] = {
        name: lambda name=name: export_take(built, take, folder, "hand", name)
        for name, exporter in EXPORTERS.items()
        if exporter.writes != "captured" and not exporter.why_not()
    }
    whole = CharacterObjects(built.hands[0].armature, (built.hands[0].mesh,))
    stage = Stage.of_scene(bpy.context.scene)
    writers["character"] = lambda: export_hands([whole], stage, folder, "hand", "blend")
    writers["take"] = lambda: take.save(folder / "hand.take.npz")
    writers["preview"] = lambda: write_png(noise, folder / "hand.preview.png")
    with results.open("w", encoding="utf-8") as lines:
        for name, write in writers.items():
            write()
            files = sorted(folder.iterdir())
            size = min(path.stat().st_size for path in files)
            for path in files:
                path.write_bytes(path.name.encode() * 50)  # the good file, which must stay
            good = {path.name: path.read_bytes() for path in files}
            for room in (0, size // 2 // PAGE * PAGE):
                message = ""
                with no_more_than(room):
                    try:
                        write()
                    except HandfitError as error:
                        message = str(error)
                kept = {path.name: path.read_bytes() for path in folder.iterdir()} == good
                print(json.dumps([name, room, message, kept]), file=lines, flush=True)
            write()
            changed = all(path.read_bytes() != good[path.name] for path in folder.iterdir())
            print(json.dumps([name, None, "", changed]), file=lines, flush=True)
            for path in folder.iterdir():
                path.unlink()


@contextlib.contextmanager
def no_more_than(room: int) -> Iterator[None]:
    """Meanwhile a file gets only so many bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
    os._exit(0)  # bpy 4.2 as a module crashes while Python ends, once glTF was exported
