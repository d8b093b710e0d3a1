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
from pathlib import Path

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
    one_byte_changed,
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


def deep(place: Place) -> list[Problem]:
    return [found for found in installation.examine_deeply(place) if found is not None]


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
    assert deep(place) == []
    assert "Not installed from a zip" in installation.report(place, [])


def test_a_good_installation_has_no_problems(install):
    place = install()
    assert installation.examine(place) == []
    assert deep(place) == []
    report = installation.report(place, [])
    assert report.count(": ok") == 3
    assert f"version 0.1.0 for {PLATFORM}, Python {PYTHON}, torch: cpu" in report
    assert str(place.site_packages) in report


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


@pytest.mark.parametrize(("package", "stops"), [("handfit-core", "add-on"), ("torch", "capture")])
def test_a_wheel_that_is_missing(install, package, stops):
    problem = only(installation.examine(install(damage={package: gone})))
    assert (problem.kind, problem.wheel, problem.stops) == ("wheel-missing", package, stops)
    assert f"the wheel of {package}" in problem.sentence
    assert ZIP in problem.sentence


@pytest.mark.parametrize(("package", "stops"), [("handfit-core", "add-on"), ("torch", "capture")])
def test_a_wheel_of_the_wrong_size(install, package, stops):
    problem = only(installation.examine(install(damage={package: cut_short})))
    assert (problem.kind, problem.wheel, problem.stops) == ("wheel-size", package, stops)
    assert "bytes instead of" in problem.sentence


@pytest.mark.parametrize(("package", "stops"), [("handfit-core", "add-on"), ("torch", "capture")])
def test_a_small_wheel_with_another_byte_is_found_where_it_was_not_unpacked(install, package, stops):
    problem = only(installation.examine(install(damage={package: one_byte_changed})))
    assert (problem.kind, problem.wheel, problem.stops) == ("wheel-content", package, stops)
    assert "damaged (its content has changed)" in problem.sentence


def test_a_byte_that_changed_later_is_found_by_the_deep_look(install):
    place = install()
    wheel = next((place.folder / "wheels").glob("torch*"))
    wheel.write_bytes(one_byte_changed(wheel.read_bytes()))
    assert installation.examine(place) == []
    problem = only(deep(place))
    assert (problem.kind, problem.wheel) == ("wheel-content", "torch")


def test_the_deep_look_comes_in_steps(install):
    steps = list(installation.examine_deeply(install()))
    assert len(steps) > 5
    assert set(steps) == {None}


def test_a_wheel_that_was_not_unpacked(install):
    place = install()
    for left in place.site_packages.glob("torch*"):
        shutil.rmtree(left)
    (place.site_packages / "torch").mkdir()  # as Blender leaves it
    problem = only(installation.examine(place))
    assert (problem.kind, problem.wheel, problem.stops) == ("not-unpacked", "torch", "capture")
    assert "Blender has not unpacked torch 2.13.0" in problem.sentence
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
    for left in place.site_packages.glob("torch*"):
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
    assert "has not unpacked torch 2.13.0, where you may not write: get the right" in done.stdout


def test_another_extensions_version_explains_but_stops_nothing(install):
    place = install()
    info = next(place.site_packages.glob("torch-*"))
    info.rename(info.with_name("torch-2.14.0.dist-info"))
    problem = only(installation.examine(place))
    assert (problem.kind, problem.wheel, problem.stops) == ("other-version", "torch", "nothing")
    assert "2.14.0" in problem.sentence


def test_the_core_of_another_version_stops_the_addon(install):
    place = install()
    info = next(place.site_packages.glob("handfit_core-*"))
    info.rename(info.with_name("handfit_core-0.2.0.dist-info"))
    problem = only(installation.examine(place))
    assert (problem.kind, problem.stops) == ("core-version", "add-on")
    assert "0.1.0" in problem.sentence
    assert "0.2.0" in problem.sentence


def test_what_the_zip_lacks_on_purpose_names_the_way_out(install):
    missing = ({"name": "torch", "python": PYTHON, "why": "there is no torch for it."},)
    place = install(missing=missing, pythons=(PYTHON, "3.12"))
    problem = only(installation.examine(place))
    assert (problem.kind, problem.stops) == ("left-out", "capture")
    expected = (
        f"cannot capture by itself, since it has Python {PYTHON}, for which the zip has no torch: choose"
    )
    assert expected in problem.sentence
    assert installation.left_out(place) == ("torch",)
    assert "there is no torch for it" in installation.report(place, [problem])
    other = ({"name": "torch", "python": "3.99", "why": "there is none"},)
    assert installation._left_out_problems(Place(Path(), Path(), PLATFORM, PYTHON), _contents(other)) == []


def _contents(missing) -> installation.Contents:
    parts = tuple(installation.LeftOut(**part) for part in missing)
    return installation.Contents("0.1.0", PLATFORM, (PYTHON,), "cpu", (), parts)


def test_a_zip_that_was_built_without_the_packages(install):
    names = ("torch", "mediapipe")
    missing = tuple({"name": name, "python": PYTHON, "why": "it was built so"} for name in names)
    problem = only(installation.examine(install(missing=missing)))
    assert "since the zip was built without torch and MediaPipe: choose" in problem.sentence


def test_the_core_of_another_zip_with_the_same_version(install):
    """Blender unpacks no wheel of which it has the name and version already."""
    place = install()
    record = next(place.site_packages.glob("handfit_core-*")) / "RECORD"
    record.write_text(record.read_text().replace("handfit_core/take.py", "handfit_core/took.py"))
    problem = only(installation.examine(place))
    assert (problem.kind, problem.wheel, problem.stops) == ("core-version", "handfit-core", "add-on")
    assert "of another zip with the same version" in problem.sentence


@pytest.mark.parametrize(
    ("machine", "spoken"), [("linux-arm64", "Linux on ARM"), ("macos-x64", "macOS on Intel")]
)
def test_a_machine_for_which_there_is_no_zip(install, machine, spoken):
    first = installation.examine(replace(install(), platform=machine))[0]
    assert first.kind == "platform"
    assert f"there is none for this machine, {spoken}" in first.sentence
    assert ".zip" not in first.sentence


def test_unpacked_files_that_vanished(install):
    place = install()
    (place.site_packages / "torch" / "__init__.py").unlink()
    assert installation.examine(place) == []
    problem = only(deep(place))
    assert (problem.kind, problem.wheel) == ("unpacked-damaged", "torch")
    assert "torch/__init__.py" in problem.sentence
    assert "another extension" in problem.sentence
    assert "enable it again" in problem.sentence


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


def test_a_list_that_cannot_be_read_ends_the_deep_look(install):
    place = install()
    (place.folder / "wheels.json").write_text("{")
    assert deep(place) == []


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
    place = install(damage={"torch": cut_short})
    shutil.rmtree(place.site_packages)
    kinds = [(problem.kind, problem.wheel) for problem in installation.examine(place)]
    assert kinds[0] == ("wheel-size", "torch")
    assert ("not-unpacked", "handfit-core") in kinds


def test_what_was_verified_is_remembered_until_something_changes(install, tmp_path):
    place, memory = install(), tmp_path / "user" / "verified.json"
    assert not installation.is_verified(place, memory)
    installation.remember_verified(place, memory)
    assert installation.is_verified(place, memory)
    wheel = next((place.folder / "wheels").glob("torch*"))
    os.utime(wheel, (1, 1))
    assert not installation.is_verified(place, memory)
    installation.remember_verified(place, memory)
    assert installation.is_verified(place, memory)
    wheel.unlink()
    assert not installation.is_verified(place, memory)
    memory.write_text("garbage")
    assert not installation.is_verified(place, memory)


def test_wheels_of_another_python_are_nobodys_business_here(install):
    place = install(pythons=(PYTHON, "3.12"))
    for wheel in (place.folder / "wheels").glob("*cp312*"):
        wheel.unlink()
    assert installation.examine(place) == []
    assert "for Python 3.12 only" in installation.report(place, [])
    other = replace(place, python="3.12")
    assert installation.examine(other)[0].kind == "wheel-missing"


def test_a_report_names_what_is_wrong_with_each_wheel(install):
    place = install(damage={"torch": gone})
    report = installation.report(place, installation.examine(place))
    (line,) = [line for line in report.splitlines() if line.startswith("  torch")]
    assert "not unpacked" in line
    assert "is missing" in line
