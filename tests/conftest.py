"""Shared by all tests: where the samples are, and no silent skips in CI."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from tests.golden import Golden

# Started in the background by a script, Ctrl-C is ignored here and in all children, which are tested for it.
signal.signal(signal.SIGINT, signal.default_int_handler)

ROOT = Path(__file__).resolve().parent.parent


def samples_dir() -> Path:
    """The folder of real photos and videos; not part of the repository."""
    return Path(os.environ.get("HANDFIT_SAMPLES", ROOT.parent / "shared" / "samples"))


@pytest.fixture(scope="session")
def samples() -> Path:
    folder = samples_dir()
    if not folder.is_dir():
        pytest.skip(f"the sample photos and videos are not here ({folder}); set HANDFIT_SAMPLES")
    return folder


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--write-golden", action="store_true", help="write the files of tests/golden anew")


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """Compares with the files of tests/golden."""
    return Golden(write=request.config.getoption("--write-golden"))


@pytest.fixture(scope="session")
def landmark_model() -> Path:
    from handfit_core.common.errors import LandmarkModelError
    from handfit_core.detect.landmark_model import landmark_model_path

    try:
        return landmark_model_path()
    except LandmarkModelError as error:
        pytest.skip(str(error))


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for reason in _unexpected_skips(terminalreporter):
        terminalreporter.write_line(f"UNEXPECTED SKIP: {reason}", red=True)


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session: pytest.Session) -> None:
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if session.exitstatus == pytest.ExitCode.OK and reporter and _unexpected_skips(reporter):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _unexpected_skips(reporter: pytest.TerminalReporter) -> list[str]:
    """Skips that HANDFIT_ALLOWED_SKIPS (comma-separated parts of reasons) does not cover; where that
    is not set, as on a developer's machine, every skip is fine."""
    setting = os.environ.get("HANDFIT_ALLOWED_SKIPS")
    if setting is None:
        return []
    allowed = [part.strip() for part in setting.split(",") if part.strip()]
    reasons = [str(report.longrepr) for report in reporter.stats.get("skipped", [])]
    return [reason for reason in reasons if not any(part in reason for part in allowed)]
