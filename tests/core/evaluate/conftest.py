"""What several tests of the evaluation share."""

from __future__ import annotations

from pathlib import Path

import pytest

from handfit_core.evaluate import cache as module


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of detections and fits, instead of the user's cache."""
    monkeypatch.setattr(module, "cache_dir", lambda: tmp_path / "cache")
    return tmp_path / "cache"
