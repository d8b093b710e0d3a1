"""Where a disk is full, what was there stays as it was, byte by byte, and a sentence says so."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys

import pytest

from blender_manient.exporters import EXPORTERS
from blender_manient.exporters.export_hands import export_take
from blender_manient.scene.build import build_take
from blender_manient.scene.proof import prove_whole
from handfit_core.errors import OutputError
from tests.conftest import ROOT

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="mounts and limits are POSIX only")


def mounting() -> list[str]:
    """The command that lets another one mount what only it sees."""
    for command in (["unshare", "--mount"], ["unshare", "--map-root-user", "--mount"]):
        works = ["sh", "-c", "mount -t tmpfs tmpfs /tmp"]
        if shutil.which("unshare") and subprocess.run([*command, *works], check=False).returncode == 0:
            return command
    pytest.skip("no small disk can be made here: unshare --mount needs root, or user namespaces")


@posix_only
@pytest.mark.parametrize("kind", ["disk", "limit"])
def test_nothing_good_is_lost(make_take, tmp_path, kind):
    take = make_take().take.save(tmp_path / "source.take.npz")
    disk, results = tmp_path / "disk", tmp_path / "results"
    (disk / "files").mkdir(parents=True)
    command = [sys.executable, "-m", "tests.blender.small_disk", take, disk / "files", results, kind]
    if kind == "disk":
        script = 'mount -t tmpfs -o size=8m tmpfs "$0" && mkdir "$0/files" && exec "$@"'
        command = [*mounting(), "sh", "-c", script, disk, *command]
    done = subprocess.run(
        list(map(str, command)), cwd=ROOT, capture_output=True, text=True, timeout=600, check=False
    )
    found = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    assert done.returncode == 0, (done.returncode, found[-1:], done.stderr[-3000:])
    tried = {name for name, *_ in found}
    assert tried == {name for name, e in EXPORTERS.items() if e.writes != "captured" and not e.why_not()} | {
        "character",
        "take",
        "preview",
    }
    assert len(found) == 3 * len(tried)
    for name, room, message, as_it_should_be in found:
        assert as_it_should_be, (name, room, message)
        if room is not None:
            assert "hand" in message, (name, room, message)
            assert "Traceback" not in message
            assert "\n" not in message
            assert "free some space or choose another folder" in message


@pytest.mark.parametrize("fmt", ["blend", "usd", "abc"])
def test_no_beginning_of_a_file_is_taken_for_the_whole(make_take, tmp_path, fmt):
    if EXPORTERS[fmt].why_not():
        pytest.skip(f"this Blender cannot write {fmt}")
    made = make_take(sides=("right",))
    (path,) = export_take(build_take(made.take), made.take, tmp_path, "hand", fmt)
    content = path.read_bytes()
    prove_whole(path, path, EXPORTERS[fmt].is_whole)
    part = path.with_name("part" + path.suffix)
    step = max(1, len(content) // 200)
    for length in (*range(0, len(content), step), *(len(content) - less for less in (1, 2, 4, 8, 16))):
        part.write_bytes(content[:length])
        with pytest.raises(OutputError, match=r"hand.*(wrote nothing|only a part)"):
            prove_whole(path, part, EXPORTERS[fmt].is_whole)
    part.write_bytes(content + b"\0")  # and nothing may follow: it was no part of it
    with pytest.raises(OutputError):
        prove_whole(path, part, EXPORTERS[fmt].is_whole)


@pytest.mark.parametrize("shading", ["smooth", "flat", "subdivided"])
def test_what_alembic_needs_is_not_underestimated(make_take, imitation_mano, tmp_path, shading, monkeypatch):
    if EXPORTERS["abc"].why_not():
        pytest.skip("this Blender cannot write abc")
    from blender_manient.exporters import blender_formats

    made = make_take(model="open-hand" if shading == "subdivided" else str(imitation_mano))
    built = build_take(made.take)
    for hand in built.hands:
        hand.mesh.data.polygons.foreach_set("use_smooth", [shading != "flat"] * len(hand.mesh.data.polygons))
        if shading == "subdivided":
            finer = hand.mesh.modifiers.new("Finer", "SUBSURF")
            finer.levels, finer.render_levels = 0, 1
            hand.mesh.modifiers.new("Last", "SIMPLE_DEFORM")  # what is last is not subdivided by Alembic
    asked = []
    check_room = blender_formats.check_room
    monkeypatch.setattr(
        blender_formats, "check_room", lambda path, size: (asked.append(size), check_room(path, size))
    )
    (path,) = export_take(built, made.take, tmp_path, "hand", "abc")
    assert path.stat().st_size <= asked[0] <= 3 * path.stat().st_size
