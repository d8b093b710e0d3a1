"""Small zips, good and broken, installed by Blender into an empty profile: what an artist gets to see."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from textwrap import indent
from typing import Any

import pytest

from tests.blender.small_zip import cut_short, gone, one_byte_changed, small_zip

PRELUDE = """
import json, os, sys, traceback
import bpy, addon_utils
from pathlib import Path

if not addon_utils.check("bl_pkg")[1]:
    addon_utils.enable("bl_pkg", default_set=True)
NAME = "bl_ext.user_default.manient"

def install(path, repo="user_default"):
    try:
        bpy.ops.extensions.package_install_files(filepath=path, repo=repo, enable_on_install=True)
    except RuntimeError as error:
        print("Blender says:", error)

def enable(name=NAME):
    bpy.ops.preferences.addon_enable(module=name)

def disable(name=NAME):
    bpy.ops.preferences.addon_disable(module=name)

def uninstall():
    bpy.ops.extensions.package_uninstall(repo_index=1, pkg_id="manient")

def state(name=NAME):
    module = sys.modules[name]
    return {
        "enabled": name in bpy.context.preferences.addons,
        "runs": module.runs(),
        "problems": [found.sentence for found in [module.common.installation.fault()] if found],
        "sections": [n for n in dir(bpy.types) if n.startswith("MANIENT_PT_")],
        "scene": hasattr(bpy.types.Scene, "manient"),
    }

def files():
    root = Path(bpy.utils.user_resource("EXTENSIONS"))
    return sorted(p.relative_to(root).as_posix() for p in root.rglob("*") if p.is_file())

def commands():
    command = sys.modules[NAME + ".command"]
    return [command.main(a) for a in (["check"], ["capture", "a.jpg", "--output", "out"])]

def found(value):
    print("FOUND " + json.dumps(value), flush=True)
    os._exit(0)
"""

EPILOGUE = """
except BaseException:
    traceback.print_exc()
    sys.stderr.flush()
    os._exit(1)  # the bpy wheel of 4.5 hangs at exit on classes left behind
"""


@dataclass(frozen=True)
class Done:
    """What a script in Blender found, and what came on the console."""

    value: Any
    console: str


@pytest.fixture
def blender(tmp_path):
    """blender(code) -> Done; the same profile each time, empty at first."""

    def run(code: str) -> Done:
        script = tmp_path / "script.py"
        script.write_text(f"{PRELUDE}\ntry:\n{indent(code, '    ')}\n{EPILOGUE}", encoding="utf-8")
        env = {k: v for k, v in os.environ.items() if not k.startswith(("HANDFIT", "PYTHON", "BLENDER"))}
        env["BLENDER_USER_RESOURCES"] = str(tmp_path / "profile")
        (tmp_path / "profile").mkdir(exist_ok=True)
        done = subprocess.run(
            [sys.executable, "-I", str(script)],
            cwd=tmp_path,
            env=env,
            capture_output=True,
            text=True,
            check=False,
            timeout=120,
        )
        lines = [line for line in done.stdout.splitlines() if line.startswith("FOUND ")]
        assert lines, done.stdout + done.stderr
        return Done(json.loads(lines[0].removeprefix("FOUND ")), done.stdout + done.stderr)

    return run


def test_a_good_zip_runs_and_leaves_nothing_of_ours(blender, tmp_path):
    path = small_zip(tmp_path / "good.zip")
    done = blender(f"""
install({str(path)!r})
before = state()
bpy.ops.manient.check_installation()
report = bpy.data.texts["Hand Capture Check"].as_string()
disable()
off = [n for n in dir(bpy.types) if "MANIENT" in n]
enable()
cache = str(sys.modules[NAME + ".session.cache"].folder_path())
uninstall()
found([before, report, off, cache, files()])
""")
    before, report, off, cache, left = done.value
    assert before["runs"]
    assert before["problems"] == []
    assert "MANIENT_PT_capture" in before["sections"]
    assert report.splitlines()[4].startswith("Installed: version 0.1.0")
    # The packages of this zip are empty.
    assert "self-test of the detector: FAILED" in report
    assert "install the add-on's zip again" in report
    assert off == []
    assert "/.user/user_default/manient/cache" in cache.replace(os.sep, "/")
    assert left == [".cache/compat.dat"]  # Blender's


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (one_byte_changed, "handfit-core 0.1.0 is not unpacked"),
        (gone, "handfit-core 0.1.0 is not unpacked"),
    ],
    ids=["byte", "gone"],
)
def test_without_handfit_core_there_is_a_sentence_and_nothing_else(blender, tmp_path, damage, said):
    path = small_zip(tmp_path / "broken.zip", damage={"handfit-core": damage})
    done = blender(f"install({str(path)!r})\nfound([state(), commands()])")
    state, codes = done.value
    assert state["enabled"]
    assert not state["runs"]
    assert state["sections"] == ["MANIENT_PT_unusable_user_default"]
    assert not state["scene"]
    assert codes == [1, 1]
    assert "Traceback" not in done.console
    (sentence,) = state["problems"]
    assert said in sentence
    assert "install" in sentence
    assert f"Manient Hand Capture: {sentence}" in done.console


def test_a_wheel_that_is_no_zip_keeps_blender_from_unpacking_any(blender, tmp_path):
    """Blender fails to install it with an error of its own; enabling it all the same brings the sentence."""
    path = small_zip(tmp_path / "broken.zip", damage={"mediapipe": cut_short})
    done = blender(f"install({str(path)!r})\nenable()\nfound(state())")
    assert not done.value["runs"]
    assert "handfit-core 0.1.0 is not unpacked" in done.value["problems"][0]


def test_without_mediapipe_only_capturing_is_impossible(blender, tmp_path):
    path = small_zip(tmp_path / "broken.zip", damage={"mediapipe": gone})
    done = blender(f"""
install({str(path)!r})
module = sys.modules[NAME]
shared_worker = sys.modules[NAME + ".session.shared_worker"]
section = bpy.types.MANIENT_PT_installation
said = [section.poll(bpy.context), shared_worker.capture_sentence()]
try:
    bpy.ops.manient.capture()
except RuntimeError as error:
    said.append(str(error))
worker = shared_worker.new_worker()
try:
    worker.submit("capture", input=["a.jpg"], output="b.npz")
except Exception as error:
    said.append(str(error))
said.append(commands())
os.environ["HANDFIT_PYTHON"] = "/some/python"
said += [section.poll(bpy.context), shared_worker.capture_sentence()]
found([state(), said])
""")
    state, (shown, sentence, is_refused, raised, codes, shown_later, later) = done.value
    assert state["runs"]
    assert shown
    assert "mediapipe 0.10.31 is not unpacked" in sentence
    assert sentence in is_refused
    assert raised.lower() == sentence.lower()
    assert codes == [1, 2]
    assert f"Manient Hand Capture: {sentence}" in done.console
    assert (shown_later, later) == (False, "")  # a Python of one's own has its own MediaPipe


def test_without_the_list_of_wheels_it_is_no_checkout(blender, tmp_path):
    path = small_zip(tmp_path / "good.zip")
    done = blender(f"""
install({str(path)!r})
disable()
(Path(sys.modules[NAME].__file__).parent / "wheels.json").unlink()
enable()
found([state(), sys.modules[NAME + ".command"].main(["check"])])
""")
    state, code = done.value
    assert not state["runs"]
    assert "its list of parts cannot be read" in state["problems"][0]
    assert code == 1


MARKS = """
def marks():
    import handfit_core
    names = ("", ".common.installation", ".session.details", ".common.wording")
    return [getattr(sys.modules.get(NAME + n), "MARK", None) for n in names] + [handfit_core.MARK]
"""


WAYS = (
    "disable()\nreplace()\nenable()",
    "disable()\nuninstall()\nreplace()\nenable()",
    "uninstall()\nreplace()\nenable()",
)
RUNNING = ("install(NEW)", "0.2.0")
"""Blender keeps wheels of the same version, if the add-on stays enabled"""


@pytest.mark.parametrize(("how", "version"), [*itertools.product(WAYS, ("0.1.0", "0.2.0")), RUNNING])
def test_nothing_old_runs_after_an_update(blender, tmp_path, version, how):
    """Whether Blender takes the old modules out of memory depends on whether the add-on was enabled."""
    old = small_zip(tmp_path / "old.zip", mark="old")
    new = small_zip(tmp_path / "new.zip", mark="new", version=version)
    done = blender(f"""
{indent(MARKS, "")}
NEW = {str(new)!r}
def replace():
    bpy.ops.extensions.package_install_files(filepath=NEW, repo="user_default", enable_on_install=False)
install({str(old)!r})
before = marks()
{how}
found([before, state(), marks()])
""")
    before, state, after = done.value
    assert before == ["old"] * 5
    assert state["runs"], state
    assert after == ["new"] * 5


def test_scripts_can_be_reloaded(blender, tmp_path):
    """Reload Scripts, known as F8, disables and enables each add-on."""
    path = small_zip(tmp_path / "good.zip")
    done = blender(f"""
install({str(path)!r})
before = sys.modules[NAME + ".session.details"]
bpy.utils.load_scripts(reload_scripts=True)
found([state(), sys.modules[NAME + ".session.details"] is before])
""")
    state, same = done.value
    assert state["runs"]
    assert state["problems"] == []
    assert not same
    assert "Traceback" not in done.console


def test_what_could_not_be_imported_is_read_again_once_it_is_mended(blender, tmp_path):
    path = small_zip(tmp_path / "good.zip")
    done = blender(f"""
install({str(path)!r})
disable()
file = Path(sys.modules[NAME].__file__).parent / "operators" / "review.py"
good = file.read_text()
file.write_text(good + chr(10) + "raise OSError('half a file')" + chr(10))
for name in [n for n in sys.modules if n.startswith(NAME)]:
    del sys.modules[name]
try:
    enable()
except RuntimeError as error:
    print(error)
broken = state()
disable()
file.write_text(good)
earlier = file.parents[1] / "session" / "source_info.py"  # was imported before the other failed
earlier.write_text(earlier.read_text() + chr(10) + "MENDED = True" + chr(10))
enable()
modules = [sys.modules[NAME].session.source_info, sys.modules[NAME + ".session.source_info"]]
found([broken, state(), *(hasattr(module, "MENDED") for module in modules)])
""")
    broken, mended, *found = done.value
    assert "half a file" in broken["problems"][0]
    assert mended["runs"]
    assert found == [True, True]


def test_a_part_that_cannot_be_registered_leaves_nothing(blender, tmp_path):
    path = small_zip(tmp_path / "good.zip")
    done = blender(f"""
install({str(path)!r})
disable()
module = sys.modules[NAME + ".scene.see_through"]
register = module.register
def fail():
    register()
    raise RuntimeError("a part failed")
module.register = fail
try:
    enable()
except RuntimeError as error:
    print(error)
failed = [n for n in dir(bpy.types) if "MANIENT" in n]
runs = sys.modules[NAME].runs() if NAME in sys.modules else False
module.register = register
enable()
found([failed, runs, state()])
""")
    failed, runs, state = done.value
    assert failed == []
    assert not runs
    assert state["runs"]
    assert "a part failed" in done.console


def test_a_part_that_cannot_be_unregistered_does_not_keep_the_others(blender, tmp_path):
    path = small_zip(tmp_path / "good.zip")
    done = blender(f"""
install({str(path)!r})
module = sys.modules[NAME + ".operators.add_hand"]
unregister = module.unregister
def fail():
    raise RuntimeError("an operator failed")
module.unregister = fail
try:
    disable()
except RuntimeError as error:
    print(error)
left = [n for n in dir(bpy.types) if "MANIENT" in n]
module.unregister = unregister
enable()
found([left, state()])
""")
    left, state = done.value
    assert left == []
    assert state["runs"]
    assert "an operator failed" in done.console


def test_a_command_whose_files_are_gone_is_one_sentence(blender, tmp_path):
    path = small_zip(tmp_path / "good.zip")
    done = blender(f"""
install({str(path)!r})
(Path(sys.modules[NAME].__file__).parent / "batch" / "run.py").unlink()
sys.modules.pop(NAME + ".batch.run", None)
found(sys.modules[NAME + ".command"].main(["capture", "a.jpg", "-o", "out"]))
""")
    assert done.value == 1
    assert "error: the add-on is not whole" in done.console
    assert "Traceback" not in done.console


def test_of_two_copies_one_runs_and_has_the_command(blender, tmp_path):
    """Two versions from two repositories do not mix; Blender refuses a command of which it knows two."""
    old, new = small_zip(tmp_path / "old.zip"), small_zip(tmp_path / "new.zip", version="0.2.0")
    other = tmp_path / "other"
    other.mkdir()
    done = blender(f"""
OTHER = "bl_ext.other.manient"
seen = []
def look(name):
    holders = [n for n in (NAME, OTHER) if n in sys.modules and sys.modules[n].command._handle is not None]
    seen.append([state(name), *(n.split(".")[1] for n in holders)])
repo = bpy.context.preferences.extensions.repos.new(
    name="Other", module="other", custom_directory={str(other)!r})
install({str(old)!r})
look(NAME)
install({str(new)!r}, repo="other")
look(OTHER)
disable()
look(OTHER)
enable()  # refused, since the newer handfit_core is unpacked
look(NAME)
disable(OTHER)
enable(OTHER)
look(OTHER)
disable(OTHER)
disable()
found([seen, NAME in sys.modules and sys.modules[NAME].command._handle is not None])
""")
    seen, left = done.value
    (first, *has), (second, *still), (_, *nobody), (third, *again), (alone, *at_last) = seen
    assert [has, still, nobody, again, at_last] == [
        ["user_default"],
        ["user_default"],
        [],
        ["user_default"],
        ["other"],
    ]
    assert not left
    assert [s["runs"] for s in (first, second, third, alone)] == [True, False, False, True]
    copy = "another copy of this add-on is enabled already, in the repository user_default"
    assert copy in second["problems"][0]
    mixed = "it is version 0.1.0, and its other half, handfit_core, is version 0.2.0"
    assert mixed in third["problems"][0]


@pytest.mark.parametrize(("other", "kept"), [("0.2.0", "0.2.0"), ("0.0.1", "0.1.0")], ids=["newer", "older"])
def test_with_another_version_gone_the_first_works_again(blender, tmp_path, other, kept):
    first, second = small_zip(tmp_path / "1.zip"), small_zip(tmp_path / "2.zip", version=other)
    done = blender(f"""
def cores():
    return [p.split("/")[-2] for p in files() if "handfit_core" in p and p.endswith("dist-info/RECORD")]
bpy.ops.preferences.extension_repo_add(name="second", type="LOCAL")
repos = [repo.module for repo in bpy.context.preferences.extensions.repos]
install({str(first)!r})
install({str(second)!r}, repo="second")
seen = [cores(), commands()]
bpy.ops.extensions.package_uninstall(repo_index=repos.index("second"), pkg_id="manient")
disable()
enable()
found([*seen, cores(), state()])
""")
    both, codes, alone, state = done.value
    assert both == [f"handfit_core-{kept}.dist-info"]
    assert codes == [1, 1]  # the packages of these zips are empty
    assert f"handfit_core, is version {kept}" in done.console
    assert "restart Blender" in done.console
    assert alone == ["handfit_core-0.1.0.dist-info"]
    assert state["runs"]
    assert state["problems"] == []
