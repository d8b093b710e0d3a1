"""What several tests of the evaluation share."""

from __future__ import annotations

from pathlib import Path

import pytest

from handfit_core.evaluate import kept


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where detections and fits are kept, instead of the user's cache."""
    monkeypatch.setattr(kept, "cache_dir", lambda: tmp_path / "cache")
    return tmp_path / "cache"
