"""Where a disk is full, what was there stays as it was, byte by byte, and a sentence says so."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from blender_manient.exporters import EXPORTERS
from blender_manient.exporters.export_hands import export_take
from blender_manient.scene.build import build_take
from blender_manient.scene.proof import prove_whole
from handfit_core.common.errors import OutputError
from tests.conftest import ROOT


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="limits of files' sizes are POSIX only")
def test_nothing_good_is_lost(make_take, tmp_path):
    take = make_take().take.save(tmp_path / "source.take.npz")
    folder, results = tmp_path / "files", tmp_path / "results"
    folder.mkdir()
    command = [sys.executable, "-m", "tests.blender.small_disk", str(take), str(folder), str(results)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    found = [json.loads(line) for line in results.read_text(encoding="utf-8").splitlines()]
    assert done.returncode == 0, (done.returncode, found[-1:], done.stderr[-3000:])
    tried = {name for name, *_ in found}
    formats = {name for name, e in EXPORTERS.items() if e.writes != "captured" and not e.why_not()}
    assert tried == formats | {"character", "take", "preview"}
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
