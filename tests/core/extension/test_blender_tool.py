from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from scripts.extension.blender_tool import run_build, tool_command
from scripts.extension.errors import BuildError


@pytest.mark.skipif(shutil.which("false") is None, reason="there is no program `false` here")
def test_a_program_that_only_fails(tmp_path):
    tool = tool_command(Path(shutil.which("false")))
    with pytest.raises(BuildError, match=r"refused .*--command extension build .*\n.*ended with 1 and said"):
        run_build(tool, tmp_path, tmp_path / "made.zip")


@pytest.mark.skipif(shutil.which("true") is None, reason="there is no program `true` here")
def test_a_program_that_is_no_blender(tmp_path):
    tool = tool_command(Path(shutil.which("true")))
    with pytest.raises(BuildError, match="made no zip; give the executable of a Blender"):
        run_build(tool, tmp_path, tmp_path / "made.zip")


def test_a_file_that_is_no_program(tmp_path):
    nothing = tmp_path / "blender.exe"
    nothing.write_bytes(b"not a program")
    nothing.chmod(0o755)
    with pytest.raises(BuildError, match=r"blender\.exe: this cannot be run .*--blender"):
        run_build(tool_command(nothing), tmp_path, tmp_path / "made.zip")


def test_no_such_file(tmp_path):
    with pytest.raises(BuildError, match="there is no such Blender"):
        tool_command(tmp_path / "gone")
