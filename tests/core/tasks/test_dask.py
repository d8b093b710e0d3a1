"""Batches by the workers of a Dask cluster, and schedulers that are none."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

pytest.importorskip("distributed", reason="needs distributed, of handfit-core[farm]")

from handfit_core.__main__ import main
from handfit_core.tasks import workers
from tests.conftest import ROOT
from tests.core.tasks.test_batch import PATIENCE, Shop


@contextmanager
def cluster(folder: Path, *more: str, count: int = 2) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as a user starts them: its address, and the workers."""
    address, started = folder / "scheduler.json", []

    def start(*words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "distributed.cli.dask_" + words[0], *words[1:]]
        started.append(subprocess.Popen(command, cwd=ROOT, stdout=log, stderr=log))
        return started[-1]

    with (folder / "dask.log").open("wb") as log:
        start("scheduler", "--port", "0", "--no-dashboard", "--scheduler-file", str(address), *more)
        words = ("--scheduler-file", str(address), "--nthreads", "1", "--no-dashboard", *more)
        those = [start("worker", *words) for _ in range(count)]
        try:
            until = time.monotonic() + PATIENCE
            while not (address.exists() and address.read_text().endswith("}")):  # written whole
                assert time.monotonic() < until
                time.sleep(0.1)
            yield json.loads(address.read_text())["address"], those
        finally:
            for process in reversed(started):
                process.terminate()
            for process in started:
                process.wait(PATIENCE)


@pytest.mark.slow
def test_a_cluster_started_here(tmp_path: Path) -> None:
    names = ["a", "broken", "dies", *(f"slow{number}" for number in range(3))]
    shop = Shop(tmp_path, names)
    child = shop.start("--scheduler", "local", "--jobs", "2")
    _, errors = child.communicate(timeout=PATIENCE)
    assert child.returncode == 1, errors
    assert "Dask's dashboard: http" in errors.splitlines()[0]
    assert "Traceback" not in errors
    assert shop.statuses == dict.fromkeys(names, "ok") | {"broken": "failed", "dies": "failed"}
    assert shop.calls["dies"] == 3
    assert shop.report["dies"]["attempts"][-1]["kind"] == "WorkerDied"


@pytest.mark.slow
def test_a_worker_that_is_killed_and_a_cluster_that_goes(tmp_path: Path) -> None:
    names = [f"slow{number}" for number in range(8)]
    shop = Shop(tmp_path, names)
    with cluster(tmp_path) as (address, (first, _)):
        child = shop.start("--scheduler", address)
        while not any(name.startswith("slow") for name in shop.records):
            assert child.poll() is None
            time.sleep(0.1)
        first.send_signal(signal.SIGTERM)
        time.sleep(0.5)
    _, errors = child.communicate(timeout=PATIENCE)
    assert child.returncode == 1, errors
    assert "the Dask scheduler has gone; what was finished is kept" in errors.splitlines()[-1]
    shop.run("--jobs", "1")
    assert shop.statuses == dict.fromkeys(names, "ok")


@pytest.mark.slow
def test_a_worker_of_another_version_that_joins_later_leaves(tmp_path: Path) -> None:
    shop, preload = Shop(tmp_path, ["a", "waits"]), tmp_path / "other_version.py"
    preload.write_text("from handfit_core.common import version\nversion.__version__ = '0.0.0'\n")
    with cluster(tmp_path, count=1) as (address, _):
        child = shop.start("--scheduler", address)
        while not (shop.output / "a" / "a.json").exists():
            assert child.poll() is None
            time.sleep(0.1)
        words = ["-m", "distributed.cli.dask_worker", address, "--no-dashboard", "--preload", str(preload)]
        late = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, timeout=PATIENCE)
        (shop.inputs / "go").touch()
        _, errors = child.communicate(timeout=PATIENCE)
    assert child.returncode == 0, errors
    assert b"has version 0.0.0 of handfit_core" in late.stderr
    assert shop.statuses == {"a": "ok", "waits": "ok"}


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl makes the certificate")
def test_encrypted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    key, certificate = tmp_path / "key.pem", tmp_path / "cert.pem"
    make = "openssl req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=127.0.0.1".split()
    subprocess.run([*make, "-keyout", key, "-out", certificate], check=True, capture_output=True)
    tls = "DASK_DISTRIBUTED__COMM__TLS__"
    monkeypatch.setenv(f"{tls}CA_FILE", str(certificate))
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION", "True")
    for role in ("CLIENT", "SCHEDULER", "WORKER"):
        monkeypatch.setenv(f"{tls}{role}__CERT", str(certificate))
        monkeypatch.setenv(f"{tls}{role}__KEY", str(key))
    shop = Shop(tmp_path, ["a", "b"])
    with cluster(tmp_path, "--protocol", "tls") as (address, _):
        assert address.startswith("tls://")
        shop.run("--scheduler", address)
    assert shop.statuses == {"a": "ok", "b": "ok"}


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    (tmp_path / "a.jpg").write_bytes(b"a")
    return tmp_path / "a.jpg"


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nowhere", "http://127.0.0.1:1"])
def test_no_scheduler(photo: Path, address: str, capsys: pytest.CaptureFixture[str], monkeypatch) -> None:
    monkeypatch.setattr(workers, "_CONNECT", 1.0)
    assert main(["batch", str(photo), "-o", str(photo.parent / "out"), "--scheduler", address]) == 2
    assert "no Dask scheduler answers at" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("__version__", "0.0.0", "use the same version on all machines"),
        ("_PYTHON", "2.7.1", "use one everywhere"),
    ],
)
def test_workers_of_another_version(
    photo: Path, name: str, value: str, said: str, capsys: pytest.CaptureFixture[str], monkeypatch
) -> None:
    with cluster(photo.parent, count=1) as (address, _):
        monkeypatch.setattr(workers, name, value)
        words = ["batch", str(photo), "-o", str(photo.parent / "out"), "--scheduler", address]
        assert main(words) == 2
    assert said in capsys.readouterr().err
