from __future__ import annotations

from pathlib import Path

import pytest

from scripts.extension.locks import lock_path, read_lock
from scripts.extension.table import HEADINGS, Part, table
from scripts.extension.targets import PLATFORM_NAMES, PYTHONS

DOCUMENTATION = Path(__file__).resolve().parents[3] / "docs" / "packaging.md"

PARTS = (
    Part("manient", "0.1.0", None, 300_000, 1_200_000, "GPL-3.0-or-later", ("3.11", "3.13")),
    Part("torch", "2.13.0+cpu", "torch.whl", 191_794_682, 699_300_000, "MIT", ("3.11",)),
)


def test_plain_text_is_aligned_and_adds_up():
    lines = table(PARTS, 192_100_000).splitlines()
    assert len({line.rindex("MB") for line in lines[1:]}) == 1
    assert "191.8 MB" in lines[2]
    assert lines[-1].split() == ["total", "192.1", "MB", "700.5", "MB"]


def test_markdown():
    lines = table(PARTS, 192_100_000, markdown=True).splitlines()
    assert lines[0] == "| part | version | licence | Python | in the zip | unpacked |"
    assert lines[1] == "| --- | --- | --- | --- | ---: | ---: |"
    assert lines[3] == "| torch | 2.13.0+cpu | MIT | 3.11 | 191.8 MB | 699.3 MB |"
    assert {line.count("|") for line in lines} == {7}


@pytest.mark.parametrize("platform", PLATFORM_NAMES)
def test_the_documentation_has_the_table_of_what_is_locked(platform):
    """Where this fails, paste what `nox -s build -- --platform ... --markdown` prints."""
    heading = {"linux-x64": "Linux", "windows-x64": "Windows", "macos-arm64": "macOS"}[platform]
    text = DOCUMENTATION.read_text(encoding="utf-8")
    section = text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]
    assert f"| {' | '.join(HEADINGS)} |" in section
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in section.splitlines()]
    found = {(row[0], row[1], python) for row in rows if len(row) == 6 for python in row[3].split()}
    locked = {
        (pin.name, pin.version, python)
        for python in PYTHONS
        for pin in read_lock(lock_path(platform, python)).pins
    }
    ours = {"manient", "handfit-core"}
    assert {row for row in found if row[0] not in ours and row[2] in PYTHONS} == locked
