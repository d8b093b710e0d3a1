"""What is found in broken installations, each made of a small zip and unpacked as Blender does."""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from dataclasses import replace

import pytest

from blender_manient import installation
from blender_manient.installation import Place, Problem
from tests.blender.small_zip import FOREIGN, PLATFORM, PYTHON, cut_short, gone, small_zip

ZIP = f"manient-0.1.0-{PLATFORM.replace('-', '_')}.zip"


@pytest.fixture
def install(tmp_path):
    """install(**options of small_zip) -> Place; wheels that Blender could not unpack are not unpacked."""

    def make(**options) -> Place:
        folder, site = tmp_path / "manient", tmp_path / "site-packages"
        with zipfile.ZipFile(small_zip(tmp_path / "a.zip", **options)) as archive:
            archive.extractall(folder)
        site.mkdir()
        for wheel in (folder / "wheels").iterdir():
            try:
                with zipfile.ZipFile(wheel) as archive:
                    archive.extractall(site)
            except zipfile.BadZipFile:
                name = wheel.name.partition("-")[0]
                for left in site.glob(f"{name}*"):
                    shutil.rmtree(left)
        return Place(folder, site, PLATFORM, PYTHON)

    return make


def only(problems: list[Problem]) -> Problem:
    assert len(problems) == 1, problems
    assert "\n" not in problems[0].sentence
    assert not problems[0].sentence.endswith(".")
    return problems[0]


def test_this_machine():
    system = {"linux": "linux", "win32": "windows", "darwin": "macos"}[sys.platform]
    assert installation.this_platform().startswith(f"{system}-")
    assert installation.this_python() == f"3.{sys.version_info.minor}"


def test_a_checkout_has_nothing_to_check(tmp_path):
    place = Place(tmp_path, tmp_path, PLATFORM, PYTHON)
    assert not installation.is_installed()
    assert installation.examine(place) == []
    assert "Not installed from a zip" in installation.report(place, [])


def test_a_good_installation_has_no_problems(install):
    place = install()
    assert installation.examine(place) == []
    report = installation.report(place, [])
    assert report.count(": ok") == 3
    assert f"version 0.1.0 for {PLATFORM}, Python {PYTHON}, torch: none" in report
    assert str(place.site_packages) in report
    contents = installation.read_contents(place.folder)
    assert installation.zip_name(contents) == ZIP
    assert installation.zip_name(replace(contents, torch="cpu")) == ZIP.replace(".zip", "-torch.zip")


def test_the_zip_of_another_platform(install):
    place = install(platform=FOREIGN)
    first = installation.examine(place)[0]
    assert first.kind == "platform"
    assert first.stops == "capture"
    assert ZIP in first.sentence
    assert {"windows-x64": "Windows", "linux-x64": "Linux"}[FOREIGN] in first.sentence


def test_a_zip_without_wheels_for_this_python(install):
    first = installation.examine(install(pythons=("3.12",)))[0]
    assert first.kind == "python"
    assert "for Python 3.12, and this Blender has" in first.sentence
    assert f"Python {PYTHON}" in first.sentence
    assert ZIP in first.sentence


@pytest.mark.parametrize(("package", "stops"), [("handfit-core", "add-on"), ("mediapipe", "capture")])
@pytest.mark.parametrize(("damage", "said"), [(gone, "is missing"), (cut_short, "bytes instead of")])
def test_a_wheel_that_is_missing_or_of_the_wrong_size(install, package, stops, damage, said):
    problem = only(installation.examine(install(damage={package: damage})))
    assert (problem.kind, problem.wheel, problem.stops) == ("wheel", package, stops)
    assert f"the wheel of {package}" in problem.sentence
    assert said in problem.sentence
    assert ZIP in problem.sentence


def test_a_wheel_that_was_not_unpacked(install):
    place = install()
    for left in place.site_packages.glob("mediapipe*"):
        shutil.rmtree(left)
    (place.site_packages / "mediapipe").mkdir()  # as Blender leaves it
    problem = only(installation.examine(place))
    assert (problem.kind, problem.wheel, problem.stops) == ("not-unpacked", "mediapipe", "capture")
    assert "Blender has not unpacked mediapipe 0.10.31" in problem.sentence
    for remedy in ("room", "may write", str(place.site_packages), "enable it again"):
        assert remedy in problem.sentence


@pytest.mark.parametrize(
    ("package", "kind", "stops", "wanted"),
    [
        ("mediapipe", "other-version", "nothing", "0.10.31"),
        ("handfit-core", "core-version", "add-on", "0.1.0"),
    ],
)
def test_another_version_of_a_package(install, package, kind, stops, wanted):
    place = install()
    name = package.replace("-", "_")
    info = next(place.site_packages.glob(f"{name}-*"))
    info.rename(info.with_name(f"{name}-0.12.0.dist-info"))
    problem = only(installation.examine(place))
    assert (problem.kind, problem.wheel, problem.stops) == (kind, package, stops)
    assert "0.12.0" in problem.sentence
    assert wanted in problem.sentence


def test_a_machine_for_which_there_is_no_zip(install):
    first = installation.examine(replace(install(), platform="linux-arm64"))[0]
    assert first.kind == "platform"
    assert "there is none for this machine, linux-arm64" in first.sentence
    assert ".zip" not in first.sentence


@pytest.mark.parametrize("name", ["wheels.json", "blender_manifest.toml"])
@pytest.mark.parametrize(
    "content",
    ['{"schema": 1', "[" * 100_000, "[]", "7", "\udcff", '{"schema": 1, "wheels": [3], "version": "1"}'],
    ids=["half", "deep", "list", "number", "bytes", "entries"],
)
def test_a_list_that_is_damaged(install, name, content):
    place = install()
    (place.folder / name).write_text(content, encoding="utf-8", errors="surrogateescape")
    problem = only(installation.examine(place))
    assert (problem.kind, problem.stops) == ("unreadable", "add-on")
    assert f"the add-on's files are damaged ({name} is damaged): remove the add-on" in problem.sentence


@pytest.mark.parametrize("name", ["wheels.json", "blender_manifest.toml"])
def test_a_list_that_is_gone(install, name):
    """An installation stays one, and is no checkout in which nothing is checked."""
    place = install()
    (place.folder / name).unlink()
    problem = only(installation.examine(place))
    assert (problem.kind, problem.stops) == ("unreadable", "add-on")
    assert f"({name} cannot be read: No such file" in problem.sentence


def test_a_list_of_another_schema(install):
    place = install()
    (place.folder / "wheels.json").write_text('{"schema": 7}')
    assert "schema 7" in only(installation.examine(place)).sentence


def test_files_of_two_versions_in_one_folder(install):
    place = install()
    data = json.loads((place.folder / "wheels.json").read_text())
    (place.folder / "wheels.json").write_text(json.dumps({**data, "version": "0.0.9"}))
    problem = only(installation.examine(place))
    assert problem.kind == "mixed"
    assert "0.0.9" in problem.sentence


def test_causes_come_first(install):
    """One wheel that Blender cannot open keeps it from unpacking all of them."""
    place = install(damage={"mediapipe": cut_short})
    shutil.rmtree(place.site_packages)
    kinds = [(problem.kind, problem.wheel) for problem in installation.examine(place)]
    assert kinds[0] == ("wheel", "mediapipe")
    assert ("not-unpacked", "handfit-core") in kinds


def test_wheels_of_another_python_are_nobodys_business_here(install):
    place = install(pythons=(PYTHON, "3.12"))
    for wheel in (place.folder / "wheels").glob("*cp312*"):
        wheel.unlink()
    assert installation.examine(place) == []
    other = replace(place, python="3.12")
    assert installation.examine(other)[0].kind == "wheel"


def test_a_report_names_what_is_wrong_with_each_wheel(install):
    place = install(damage={"mediapipe": gone})
    report = installation.report(place, installation.examine(place))
    (line,) = [line for line in report.splitlines() if line.startswith("  mediapipe")]
    assert "not unpacked" in line
    assert "is missing" in line
