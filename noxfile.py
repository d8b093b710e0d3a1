"""Set-up and checks. `nox -s demo` shows the main job, `nox -s tests` proves that it works."""

from __future__ import annotations

import os
from pathlib import Path

import nox

nox.options.sessions = ["lint", "tests"]
nox.options.reuse_existing_virtualenvs = True

ROOT = Path(__file__).resolve().parent
PYTHON = "3.11"

RUN_TIME = ["torch", "scipy", "opencv-python-headless", "mediapipe"]
EVALUATION = ["matplotlib", "jinja2"]
"""What the reports of `evaluate` need on top."""
CORE_NUMPY = "numpy==2.4.6"
"""NumPy where no bpy wheel decides it."""

BPY = {
    "4.2": "bpy==4.2.23",
    "4.5": "bpy==4.5.15",
    "5.0": "bpy==5.0.1",
    "5.2": "bpy==5.2.3",
}
DEMO_BPY = BPY["4.5"]


def install(session: nox.Session, *packages: str) -> None:
    session.install("--quiet", "--constraint", str(ROOT / "constraints.txt"), *packages)


def fetch_landmark_model(session: nox.Session) -> None:
    """Into the user's cache, once per machine."""
    session.run("python", "scripts/fetch_landmark_model.py")


@nox.session(python=PYTHON)
def demo(session: nox.Session) -> None:
    """Capture the bundled sample, or the files given after `--`, into out/demo/."""
    install(session, *RUN_TIME, DEMO_BPY)
    fetch_landmark_model(session)
    session.run("python", "scripts/demo.py", *session.posargs)


@nox.session(python=PYTHON)
def benchmark(session: nox.Session) -> None:
    """Render labelled pictures, evaluate solvers on them, and write a report: a handful, or `-- full`.

    Into out/benchmark/. The full set, 500 stills and 10 clips of 100 frames with every solver, takes
    hours on two cores; both halves go on where they were stopped.
    """
    full = "full" in session.posargs
    install(session, *RUN_TIME, *EVALUATION, DEMO_BPY)
    fetch_landmark_model(session)
    size = "full" if full else "small"
    pictures, report = f"out/benchmark/{size}", f"out/benchmark/{size}-report"
    counts = [] if full else ["--stills", "10", "--clips", "1", "--frames", "10"]
    solvers = "raw,fused,paper,paper-a-plus,fast" if full else "raw,fused,paper-a,fast"
    session.run("python", "scripts/render_benchmark.py", pictures, *counts)
    session.run("python", "-m", "handfit_core", "evaluate", pictures, "--solvers", solvers, "-o", report)


@nox.session(python=PYTHON)
@nox.parametrize("part", ["core", "open-hand", "bpy-4.5", "bpy-5.0"])
def tests(session: nox.Session, part: str) -> None:
    """All tests: the core without Blender, the open hand's rebuild, and Blender's side per bpy wheel."""
    if part == "core":
        install(session, *RUN_TIME, *EVALUATION, CORE_NUMPY, "pytest")
        fetch_landmark_model(session)
        run_pytest(session, "tests/core", allowed_skips="CUDA,anny,smplx")
    elif part == "open-hand":
        install(session, "anny", "scipy", "pytest", CORE_NUMPY, "torch")
        run_pytest(session, "tests/core/test_open_hand.py")
    else:
        run_blender_tests(session, part.removeprefix("bpy-"))


@nox.session(python=PYTHON, name="blender-4.2")
def blender_42(session: nox.Session) -> None:
    """Blender's side in the oldest Blender that is supported."""
    run_blender_tests(session, "4.2")


@nox.session(python="3.13", name="blender-5.2")
def blender_52(session: nox.Session) -> None:
    """Blender's side in 5.2 under Python 3.13.

    Torch has no CPU build for it here: name an interpreter of Python 3.11 that has the run-time
    packages in HANDFIT_PYTHON, or the tests that capture are skipped.
    """
    install(session, BPY["5.2"], "pytest")
    run_pytest(session, "tests/blender", "tests/e2e", allowed_skips="HANDFIT_PYTHON,chroot,cv2")


def run_blender_tests(session: nox.Session, version: str) -> None:
    install(session, *RUN_TIME, BPY[version], "pytest")
    fetch_landmark_model(session)
    if version == "4.5":  # the real Blender and its window run once, beside one of the wheels
        run_pytest(session, "tests/blender", "tests/e2e", "tests/window")
    else:
        env = {"HANDFIT_BLENDER_CHROOT": ""}
        run_pytest(session, "tests/blender", "tests/e2e", allowed_skips="chroot", env=env)


def run_pytest(
    session: nox.Session, *paths: str, allowed_skips: str = "", env: dict[str, str] | None = None
) -> None:
    """Run pytest. In CI everything is there, so that a skip whose reason names none of
    `allowed_skips` is a failure (tests/conftest.py)."""
    strict = {"HANDFIT_ALLOWED_SKIPS": allowed_skips} if os.environ.get("CI") else {}
    chosen = [a for a in session.posargs if a.startswith("tests")]
    options = [a for a in session.posargs if a not in chosen]
    # More BLAS threads than one only wait for each other, as handfit_core/__main__.py explains.
    threads = {"OPENBLAS_NUM_THREADS": "1"}
    session.run(
        "python", "-m", "pytest", *(chosen or paths), *options, env={**threads, **strict, **(env or {})}
    )


@nox.session(python=PYTHON)
def lint(session: nox.Session) -> None:
    """ruff (lint and format) and pyright."""
    install(session, "ruff", "pyright[nodejs]", "nox", "pytest", CORE_NUMPY, *RUN_TIME, *EVALUATION)
    session.run("ruff", "check", ".")
    session.run("ruff", "format", "--check", ".")
    session.run("pyright")
