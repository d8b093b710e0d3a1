"""Small zips, good and broken, installed by Blender into an empty profile: what an artist gets to see."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from textwrap import indent

import pytest

from tests.blender.small_zip import cut_short, one_byte_changed, small_zip

NOT_WHOLE = "The add-on is not whole: remove it and install the zip again"

PRELUDE = """
import json, os, sys, traceback
import bpy, addon_utils
from pathlib import Path

if not addon_utils.check("bl_pkg")[1]:
    addon_utils.enable("bl_pkg", default_set=True)
NAME = "bl_ext.user_default.manient"

def attempt(operator, **fields):
    try:
        operator(**fields)
    except RuntimeError as error:
        print("Blender says:", error)

def install(path, repo="user_default", enabled=True):
    install_files = bpy.ops.extensions.package_install_files
    attempt(install_files, filepath=path, repo=repo, enable_on_install=enabled)

def enable(name=NAME):
    attempt(bpy.ops.preferences.addon_enable, module=name)

def disable(name=NAME):
    attempt(bpy.ops.preferences.addon_disable, module=name)

def uninstall():
    bpy.ops.extensions.package_uninstall(repo_index=1, pkg_id="manient")

def state(name=NAME):
    module = sys.modules[name]
    return {
        "enabled": name in bpy.context.preferences.addons,
        "runs": len(module.registration._registered) > 2,
        "why_not": module.common.installation.why_not,
        "sections": [n for n in dir(bpy.types) if n.startswith("MANIENT_PT_")],
        "scene": hasattr(bpy.types.Scene, "manient"),
    }

def classes():
    return [n for n in dir(bpy.types) if "MANIENT" in n]

def folder():
    return Path(sys.modules[NAME].__file__).parent

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


@pytest.fixture
def blender(tmp_path):
    """blender(code, **options of small_zip) -> (what it found, the console), in a profile of its own.

    The code knows the path of such a zip as ZIP, and of one of another version as NEW."""

    def run(code: str, **options):
        zips = {"ZIP": options, "NEW": {"version": "0.2.0", "mark": "new"}}
        paths = [
            (name, str(small_zip(tmp_path / f"{name}.zip", **zips[name]))) for name in zips if name in code
        ]
        names = "".join(f"{name} = {path!r}\n" for name, path in paths)
        script = tmp_path / "script.py"
        script.write_text(f"{PRELUDE}\n{names}\ntry:\n{indent(code, '    ')}\n{EPILOGUE}", encoding="utf-8")
        env = {k: v for k, v in os.environ.items() if not k.startswith(("HANDFIT", "PYTHON", "BLENDER"))}
        env["BLENDER_USER_RESOURCES"] = str(tmp_path / "profile")
        (tmp_path / "profile").mkdir(exist_ok=True)
        command = [sys.executable, "-I", str(script)]
        fixed: dict = {"cwd": tmp_path, "env": env, "capture_output": True, "text": True}
        done = subprocess.run(command, check=False, timeout=120, **fixed)
        lines = [line for line in done.stdout.splitlines() if line.startswith("FOUND ")]
        assert lines, done.stdout + done.stderr
        return json.loads(lines[0].removeprefix("FOUND ")), done.stdout + done.stderr

    return run


def test_a_good_zip_runs_is_reloaded_and_leaves_nothing_of_ours(blender):
    """Reload Scripts, known as F8, disables and enables each add-on."""
    (before, report, off, reloaded, same, cache, left), console = blender("""
install(ZIP)
before = state()
bpy.ops.manient.check_installation()
report = bpy.data.texts["Hand Capture Check"].as_string().partition("Traceback")[0]
disable()
off = classes()
enable()
module = sys.modules[NAME + ".session.details"]
bpy.utils.load_scripts(reload_scripts=True)
cache = str(sys.modules[NAME + ".session.cache"].folder_path())
seen = [state(), sys.modules[NAME + ".session.details"] is module, cache]
uninstall()
found([before, report, off, *seen, files()])
""")
    for seen in (before, reloaded):
        assert (seen["runs"], seen["why_not"]) == (True, "")
    assert "MANIENT_PT_capture" in before["sections"]
    assert report.startswith(f"{NOT_WHOLE}\n"), "the packages of this zip are empty"
    assert "Manient Hand Capture 0.1.0, handfit_core 0.1.0" in report
    assert "mediapipe" in report
    assert (off, same) == ([], False)
    assert "/.user/user_default/manient/cache" in cache.replace(os.sep, "/")
    assert left == [".cache/compat.dat"]  # Blender's
    assert "Traceback" not in console


OTHER_VERSION = """
disable()
manifest = folder() / "blender_manifest.toml"
manifest.write_text(manifest.read_text().replace("0.1.0", "0.0.9"))
enable()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("damage", "before", "after"),
    [
        ({"handfit-core": one_byte_changed}, "", ""),
        # Blender unpacks none of them and fails with an error of its own.
        ({"mediapipe": cut_short}, "", "enable()"),
        ({}, "sys.modules['numpy'] = None", ""),
        ({}, "", OTHER_VERSION),
    ],
    ids=["byte", "cut", "NumPy", "version"],
)
def test_a_broken_zip_is_a_sentence_and_nothing_else(blender, damage, before, after):
    code = f"{before}\ninstall(ZIP)\n{after}\nfound([state(), commands()])"
    (state, codes), console = blender(code, damage=damage)
    assert state["enabled"]
    assert not state["runs"]
    assert state["sections"] == ["MANIENT_PT_unusable_user_default"]
    assert not state["scene"]
    assert codes == [1, 1]
    assert state["why_not"] == NOT_WHOLE
    assert f"Manient Hand Capture: {NOT_WHOLE} (" in console
    assert console.count(f"error: {NOT_WHOLE}") == 2
    assert ", handfit_core " in console


@pytest.mark.slow
@pytest.mark.parametrize("how", ["disable()\ninstall(NEW, enabled=False)\nenable()", "install(NEW)"])
def test_nothing_old_runs_after_an_update(blender, how):
    """Whether Blender takes the old modules out of memory depends on whether the add-on was enabled."""
    (before, state, after), _ = blender(
        f"""
def marks():
    import handfit_core
    names = ("", ".common.installation", ".session.details", ".common.wording")
    return [getattr(sys.modules.get(NAME + n), "MARK", None) for n in names] + [handfit_core.MARK]
install(ZIP)
before = marks()
{how}
found([before, state(), marks()])
""",
        mark="old",
    )
    assert before == ["old"] * 5
    assert state["runs"], state
    assert after == ["new"] * 5


@pytest.mark.slow
def test_a_part_that_fails_does_not_keep_the_others(blender):
    """It leaves nothing behind, where it is registered and where a command's file is gone."""
    (failed, again, code), console = blender("""
install(ZIP)
disable()
module = sys.modules[NAME + ".session.shared_worker"]
register = module.register
def fail():
    register()
    raise RuntimeError("a part failed")
module.register = fail
enable()
failed = classes()
module.register = register
enable()
(folder() / "batch" / "run.py").unlink()
sys.modules.pop(NAME + ".batch.run", None)
found([failed, state(), sys.modules[NAME + ".command"].main(["capture", "a.jpg", "-o", "out"])])
""")
    assert failed == []
    assert again["runs"]
    assert code == 1
    before, error, after = console.partition(f"error: {NOT_WHOLE}")
    assert "a part failed" in before
    assert error
    assert "Traceback" not in after


@pytest.mark.slow
def test_of_two_copies_one_runs_and_has_the_command(blender, tmp_path):
    """Two versions from two repositories do not mix; Blender refuses a command of which it knows two."""
    (tmp_path / "other").mkdir()
    (seen, left), _ = blender("""
OTHER = "bl_ext.other.manient"
seen = []
def look(name):
    seen.append([state(name), [n.split(".")[1] for n in (NAME, OTHER) if holds(n)]])
def holds(name):
    return name in sys.modules and sys.modules[name].command._handle is not None
repo = bpy.context.preferences.extensions.repos.new(
    name="Other", module="other", custom_directory=os.path.abspath("other"))
install(ZIP)
look(NAME)
install(NEW, repo="other")
look(OTHER)
disable()
disable(OTHER)
enable(OTHER)
look(OTHER)
disable(OTHER)
found([seen, holds(NAME)])
""")
    (first, second, alone), holders = zip(*seen, strict=True)
    assert holders == (["user_default"], ["user_default"], ["other"])
    assert not left
    assert [s["runs"] for s in (first, second, alone)] == [True, False, True]
    assert second["why_not"].startswith("Another copy of this add-on is enabled already: disable")
