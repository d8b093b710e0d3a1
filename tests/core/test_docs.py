"""What the documentation says of commands, versions and places is true."""

import re
from pathlib import Path

import pytest

from tests.conftest import ROOT

PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").glob("*.md"))]
COMMANDS = [*PAGES, *sorted((ROOT / ".github" / "workflows").glob("*.yml")), ROOT / ".ci" / "run"]


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def anchors(page: Path) -> set[str]:
    """Of the headings, as public hosts make them."""
    headings = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    plain = (re.sub(r"[^\w\- ]", "", heading.lower()) for heading in headings)
    return {heading.replace(" ", "-") for heading in plain}


def sessions() -> set[str]:
    """Names of noxfile.py's sessions: a function's, or the one given; `{version}` is any of the Blenders."""
    text = text_of(ROOT / "noxfile.py")
    plain = re.findall(r"^@nox\.session\((?!.*name=).*\n(?:@.*\n)*def (\w+)", text, re.MULTILINE)
    given = re.findall(r'^ *@?nox\.session\(.*name=f?"([^"]+)"', text, re.MULTILINE)
    blenders = re.findall(r'"([\d.]+)": "bpy==', text)
    return {*plain, *(name.replace("{version}", version) for name in given for version in blenders)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    assert not re.search(r"\b(TODO|TBD|FIXME|XXX)\b", text_of(page))
    without_code = re.sub(r"^```.*?^```", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
    for target in re.findall(r"\]\(([^)\s]+)\)", without_code):
        if re.match(r"\w+:", target):
            continue
        path, _, anchor = target.partition("#")
        there = page.parent / path if path else page
        assert there.exists(), target
        assert not anchor or anchor in anchors(there), target


@pytest.mark.parametrize("page", COMMANDS, ids=lambda page: page.name)
def test_nox_sessions_exist(page):
    known = sessions()
    for line in re.findall(r"nox -s ([^`#\n]+)", text_of(page)):
        for word in line.split(" -- ")[0].replace('"', " ").split():
            named = re.match(r"[a-z][\w.-]*", word)
            if not named:
                break
            assert named[0] in known, f"{line}: no session {named[0]}"


def test_versions_to_install_are_the_pinned_ones():
    text = text_of(ROOT / "docs" / "installing.md")
    constraints = text_of(ROOT / "constraints.txt")
    named = set(re.findall(r"([\w-]+)==([\d.]+\d)", text))
    wanted = {"torch", "scipy", "opencv-python-headless", "mediapipe", "av", "loky", "tqdm", "threadpoolctl"}
    assert {package for package, _ in named} == wanted
    for package, version in named:
        assert re.search(rf"^{package}=={re.escape(version)}(;.*)?\s", constraints, re.MULTILINE), package
