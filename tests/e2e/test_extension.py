"""The zip as scripts/build_extension.py makes it, with the real wheels and Blender's own tool.

That it installs and captures is in tests/installed/.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from scripts.build_extension import Built, build
from scripts.extension import locks
from scripts.extension.blender_tool import run_validate, tool_command
from scripts.extension.core_wheel import LANDMARK_MODEL, LANDMARK_MODEL_SHA256
from scripts.extension.downloads import in_cache
from scripts.extension.errors import BuildError
from scripts.extension.parts import RUN_TIME
from scripts.extension.targets import PLATFORM_NAMES, PYTHONS, this_platform

ROOT = Path(__file__).resolve().parents[2]
LOCK = locks.lock_path("linux-x64", "3.11")

pytestmark = pytest.mark.skipif(
    this_platform() not in PLATFORM_NAMES, reason=f"there is no zip for {this_platform()}"
)


def built_or_skipped(output: Path, **options) -> Built:
    """Where the wheels are neither in the cache nor to be downloaded, there is nothing to test with."""
    try:
        return build(output, **options)
    except BuildError as error:
        if "could not be downloaded" in str(error):
            pytest.skip(f"wheels are neither in the cache nor to be downloaded: {error}")
        raise


@pytest.fixture(scope="module")
def built(tmp_path_factory) -> Built:
    """The usual zip of this machine's platform."""
    return built_or_skipped(tmp_path_factory.mktemp("extension"))


@pytest.fixture(scope="module")
def light(tmp_path_factory) -> Built:
    """For a Python of the user's own, which makes it quick."""
    return built_or_skipped(tmp_path_factory.mktemp("light"), torch="none")


@pytest.fixture
def zipped(built) -> Iterator[zipfile.ZipFile]:
    with zipfile.ZipFile(built.path) as archive:
        yield archive


def test_contents(built, zipped):
    names = zipped.namelist()
    assert {"__init__.py", "LICENSE", "operators/capture.py", "panels/__init__.py"} <= set(names)
    assert {"THIRD_PARTY_LICENSES", "sbom.cdx.json", "wheels.json"} <= set(names)
    assert len(names) == len(set(names))
    assert not [name for name in names if "__pycache__" in name or name.startswith("tests")]
    manifest = tomllib.loads(zipped.read("blender_manifest.toml").decode())
    source = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    assert manifest["version"] == source["version"]
    assert manifest["platforms"] == [this_platform()]
    wheels = {name for name in names if name.startswith("wheels/")}
    assert {wheel.removeprefix("./") for wheel in manifest["wheels"]} == wheels
    assert built.path.name == f"manient-{source['version']}-{this_platform().replace('-', '_')}.zip"


def test_the_inventory_matches_files_and_hashes(built, zipped):
    inventory = json.loads(zipped.read("wheels.json"))
    files = {name.removeprefix("wheels/") for name in zipped.namelist() if name.startswith("wheels/")}
    assert {wheel["file"] for wheel in inventory["wheels"]} == files
    for wheel in inventory["wheels"]:
        content = zipped.read(f"wheels/{wheel['file']}")
        assert len(content) == wheel["size"]
        assert hashlib.sha256(content).hexdigest() == wheel["sha256"]
    assert {part.file for part in built.parts} == {*files, None}
    assert [vars(missing) for missing in built.missing] == inventory["missing"]


def test_the_wheels_are_the_locked_ones_and_the_core(zipped):
    """Unmodified, since their hashes are those of the index."""
    locked = {
        pin.sha256
        for python in PYTHONS
        for pin in locks.read_lock(locks.lock_path(this_platform(), python)).pins
    }
    inventory = json.loads(zipped.read("wheels.json"))["wheels"]
    assert {wheel["sha256"] for wheel in inventory if wheel["name"] != "handfit-core"} == locked
    assert {wheel["name"] for wheel in inventory if wheel["sha256"] not in locked} == {"handfit-core"}


def test_the_core_is_its_source_with_the_models_and_nothing_else(light, tmp_path):
    with zipfile.ZipFile(light.path) as archive:
        (name,) = [n for n in archive.namelist() if n.startswith("wheels/handfit_core-")]
        archive.extract(name, tmp_path)
    with zipfile.ZipFile(tmp_path / name) as wheel:
        content = wheel.read(f"handfit_core/{LANDMARK_MODEL}")
        names = {name for name in wheel.namelist() if ".dist-info/" not in name}
        assert {entry.compress_type for entry in wheel.infolist()} == {zipfile.ZIP_STORED}
    assert hashlib.sha256(content).hexdigest() == LANDMARK_MODEL_SHA256
    assert {name for name in names if not name.endswith(".py")} == {
        "handfit_core/detect/data/LICENSE-landmark-model.txt",
        "handfit_core/detect/data/hand_landmarker.task",
        "handfit_core/evaluate/report/page.html.j2",
        "handfit_core/hand_model/data/LICENSE-open-hand.md",
        "handfit_core/hand_model/data/landmarks.npz",
        "handfit_core/hand_model/data/open_hand_left.npz",
        "handfit_core/hand_model/data/open_hand_right.npz",
        "handfit_core/detect/correction/data/landmark_network.npz",
    }
    modules = {path.relative_to(ROOT).as_posix() for path in (ROOT / "handfit_core").rglob("*.py")}
    assert {name for name in names if name.endswith(".py")} == modules


def test_every_licence_file_of_the_wheels_stands_in_the_list(built, zipped, tmp_path):
    """SciPy and OpenCV have some outside of their metadata."""
    text = zipped.read("THIRD_PARTY_LICENSES").decode()
    names = {"license", "licence", "copying", "notice"}
    beside_code = 0
    for part in built.parts:
        if part.file is None or part.name == "handfit-core":
            continue
        zipped.extract(f"wheels/{part.file}", tmp_path)
        with zipfile.ZipFile(tmp_path / "wheels" / part.file) as wheel:
            for name in wheel.namelist():
                first = re.split(r"[^a-z]", name.rpartition("/")[2].lower())[0]
                if first in names and not name.endswith((".py", "/")):
                    assert f"--- {name} ---" in text, part.file
                    assert wheel.read(name).decode(errors="replace").strip() in text, name
                    beside_code += part.name == "scipy" and ".dist-info/" not in name
    assert beside_code == 4 * sum(part.name == "scipy" for part in built.parts)


def test_licences_of_the_parts_are_expressions(built, zipped):
    """Also of those whose metadata has none, with what libraries inside them ask for."""
    components = {c["bom-ref"]: c for c in json.loads(zipped.read("sbom.cdx.json"))["components"]}
    for part in built.parts:
        if part.file is not None:
            assert components[part.file]["licenses"] == [{"expression": part.licence}]
    licences = {part.name: part.licence for part in built.parts}
    assert "LGPL-2.1-or-later" in licences["opencv-python-headless"]
    assert "GPL-3.0-or-later WITH GCC-exception-3.1" in licences["scipy"]


def test_same_input_same_bytes(light, tmp_path):
    """At another time, in another folder, with another umask and time zone."""
    script = ROOT / "scripts" / "build_extension.py"
    subprocess.run(
        [sys.executable, str(script), "--torch", "none", "-o", str(tmp_path)],
        check=True,
        capture_output=True,
        env={**os.environ, "TZ": "Asia/Tokyo"},
        umask=0o077,
    )
    assert (tmp_path / light.path.name).read_bytes() == light.path.read_bytes()


def test_blender_validates_it_and_refuses_a_spoiled_one(light, tmp_path):
    tool = tool_command()
    run_validate(tool, light.path)
    with zipfile.ZipFile(tmp_path / "spoiled.zip", "w") as archive:
        archive.writestr("__init__.py", "")
        archive.writestr("blender_manifest.toml", 'schema_version = "1.0.0"\nid = "manient"\n')
    with pytest.raises(BuildError, match="Blender's extension tool refused"):
        run_validate(tool, tmp_path / "spoiled.zip")


def test_without_torch_nothing_that_captures_is_in_it(light):
    with zipfile.ZipFile(light.path) as archive:
        inventory = json.loads(archive.read("wheels.json"))
    assert light.path.name.endswith("-no_torch.zip")
    assert inventory["torch"] == "none"
    assert [wheel["name"] for wheel in inventory["wheels"]] == ["handfit-core"]
    assert {(m["name"], m["python"]) for m in inventory["missing"]} == {
        (name, python) for name in RUN_TIME for python in PYTHONS
    }


def test_a_torch_of_the_users_own_for_one_python(tmp_path):
    """A stand-in with torch's name: what is tested is how it is carried."""
    own = tmp_path / "torch-2.13.0+cu126-py3-none-any.whl"
    with zipfile.ZipFile(own, "w") as wheel:
        wheel.writestr(
            "torch-2.13.0+cu126.dist-info/METADATA", "Metadata-Version: 2.4\nName: torch\nVersion: 1\n"
        )
    built = built_or_skipped(tmp_path, pythons=["3.11"], torch=str(own))
    with zipfile.ZipFile(built.path) as archive:
        inventory = json.loads(archive.read("wheels.json"))
        assert archive.read(f"wheels/{own.name}") == own.read_bytes()
    (torch,) = [wheel for wheel in inventory["wheels"] if wheel["name"] == "torch"]
    assert torch["sha256"] == hashlib.sha256(own.read_bytes()).hexdigest()
    assert inventory["torch"] == "2.13.0+cu126"
    assert inventory["missing"] == []
    assert built.path.name.endswith("-py311-torch_2.13.0_cu126.zip")


def test_a_wrong_hash_in_a_lock_is_refused(light, tmp_path):
    """Although the right wheel is in the cache."""
    pin = next(pin for pin in locks.read_lock(LOCK).pins if pin.name == "mediapipe")
    assert in_cache(pin)
    spoiled = LOCK.read_text(encoding="utf-8").replace(pin.sha256, "0" * 64)
    (tmp_path / LOCK.name).write_text(spoiled, encoding="utf-8")
    with pytest.raises(
        BuildError, match=r"mediapipe 0\.10\.31 for linux-x64, Python 3\.11 could not be downloaded"
    ):
        build(tmp_path, "linux-x64", ["3.11"], lock_folder=tmp_path)
    assert not list(tmp_path.glob("*.zip"))


def test_a_missing_lock_is_refused(tmp_path):
    with pytest.raises(BuildError, match=r"linux-x64-py311\.txt: this lock cannot be read"):
        build(tmp_path, "linux-x64", ["3.11"], lock_folder=tmp_path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--platform", "amiga"], "amiga: there is no zip for this platform; choose from linux-x64"),
        (["--python", "3.9"], "3.9: no supported Blender has this Python; choose from 3.11, 3.13"),
        (["--platform", "linux-x64, amiga"], "amiga: there is no zip for this platform; choose"),
        (["--platform", ""], "no platform was named; choose from linux-x64"),
        (["--python", ""], "no Python was named; choose from 3.11, 3.13"),
        (["--torch", ""], "--torch: expected cpu, none, or the path of a wheel"),
        (["--torch", "gpu"], "gpu: expected cpu, none, or the path of a wheel"),
        (["--blender", "no/blender"], "no/blender: there is no such Blender"),
    ],
)
def test_a_wrong_option_is_one_sentence(tmp_path, options, said):
    script = ROOT / "scripts" / "build_extension.py"
    done = subprocess.run(
        [sys.executable, str(script), *options, "-o", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.startswith(f"error: {said}")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
