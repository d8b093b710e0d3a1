"""What is found in broken installations, each made of a small zip and unpacked as Blender does."""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
import sys
import zipfile
from dataclasses import replace

import pytest

from blender_manient import installation
from blender_manient.installation import Place, Problem
from tests.blender.small_zip import (
    FOREIGN,
    PLATFORM,
    PYTHON,
    ROOT,
    cut_short,
    gone,
    small_zip,
)

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
def test_a_wheel_that_is_missing(install, package, stops):
    problem = only(installation.examine(install(damage={package: gone})))
    assert (problem.kind, problem.wheel, problem.stops) == ("wheel-missing", package, stops)
    assert f"the wheel of {package}" in problem.sentence
    assert ZIP in problem.sentence


@pytest.mark.parametrize(("package", "stops"), [("handfit-core", "add-on"), ("mediapipe", "capture")])
def test_a_wheel_of_the_wrong_size(install, package, stops):
    problem = only(installation.examine(install(damage={package: cut_short})))
    assert (problem.kind, problem.wheel, problem.stops) == ("wheel-size", package, stops)
    assert "bytes instead of" in problem.sentence


def test_a_wheel_that_was_not_unpacked(install):
    place = install()
    for left in place.site_packages.glob("mediapipe*"):
        shutil.rmtree(left)
    (place.site_packages / "mediapipe").mkdir()  # as Blender leaves it
    problem = only(installation.examine(place))
    assert (problem.kind, problem.wheel, problem.stops) == ("not-unpacked", "mediapipe", "capture")
    assert "Blender has not unpacked mediapipe 0.10.31" in problem.sentence
    assert "enable it again" in problem.sentence


def test_a_full_disk_is_told(install, monkeypatch):
    place = install()
    shutil.rmtree(place.site_packages)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 9, 1))
    (first, *_) = installation.examine(place)
    assert (first.wheel, first.stops) == ("handfit-core", "add-on")
    assert "disk is full (0 MB free): free some space" in first.sentence


@pytest.mark.skipif(sys.platform == "win32", reason="has no such rights")
def test_a_folder_that_cannot_be_written_is_told(install):
    place = install()
    for left in place.site_packages.glob("mediapipe*"):
        shutil.rmtree(left)
    code = (
        "from pathlib import Path\n"
        "from blender_manient import installation\n"
        f"place = installation.Place({place.folder!r}, {place.site_packages!r}, {PLATFORM!r}, {PYTHON!r})\n"
        "print(*(problem.sentence for problem in installation.examine(place)))\n"
    ).replace("PosixPath", "Path")
    command = [sys.executable, "-c", code]
    if os.geteuid() == 0:  # who may write everywhere, but to what is mounted for reading
        site = shlex.quote(str(place.site_packages))
        mount = f"mount --bind {site} {site} && mount -o remount,ro,bind {site}"
        unshare = ["unshare", "--mount", "sh", "-c"]
        if subprocess.run([*unshare, mount], capture_output=True, check=False).returncode:
            pytest.skip("may not mount")
        command = [*unshare, f"{mount} && {shlex.join(command)}"]
    else:
        place.site_packages.chmod(0o500)
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "has not unpacked mediapipe 0.10.31, where you may not write: get the right" in done.stdout


def test_another_extensions_version_explains_but_stops_nothing(install):
    place = install()
    info = next(place.site_packages.glob("mediapipe-*"))
    info.rename(info.with_name("mediapipe-0.11.0.dist-info"))
    problem = only(installation.examine(place))
    assert (problem.kind, problem.wheel, problem.stops) == ("other-version", "mediapipe", "nothing")
    assert "0.11.0" in problem.sentence


def test_the_core_of_another_version_stops_the_addon(install):
    place = install()
    info = next(place.site_packages.glob("handfit_core-*"))
    info.rename(info.with_name("handfit_core-0.2.0.dist-info"))
    problem = only(installation.examine(place))
    assert (problem.kind, problem.stops) == ("core-version", "add-on")
    assert "0.1.0" in problem.sentence
    assert "0.2.0" in problem.sentence


@pytest.mark.parametrize(
    ("machine", "spoken"), [("linux-arm64", "Linux on ARM"), ("macos-x64", "macOS on Intel")]
)
def test_a_machine_for_which_there_is_no_zip(install, machine, spoken):
    first = installation.examine(replace(install(), platform=machine))[0]
    assert first.kind == "platform"
    assert f"there is none for this machine, {spoken}" in first.sentence
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
    assert kinds[0] == ("wheel-size", "mediapipe")
    assert ("not-unpacked", "handfit-core") in kinds


def test_wheels_of_another_python_are_nobodys_business_here(install):
    place = install(pythons=(PYTHON, "3.12"))
    for wheel in (place.folder / "wheels").glob("*cp312*"):
        wheel.unlink()
    assert installation.examine(place) == []
    assert "for Python 3.12 only" in installation.report(place, [])
    other = replace(place, python="3.12")
    assert installation.examine(other)[0].kind == "wheel-missing"


def test_a_report_names_what_is_wrong_with_each_wheel(install):
    place = install(damage={"mediapipe": gone})
    report = installation.report(place, installation.examine(place))
    (line,) = [line for line in report.splitlines() if line.startswith("  mediapipe")]
    assert "not unpacked" in line
    assert "is missing" in line
