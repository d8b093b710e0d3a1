from __future__ import annotations

from scripts.extension.table import Part, table

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
