"""Running methods on tracks, in several processes if asked, with every result kept for a later run."""

from __future__ import annotations

import contextlib
import hashlib
import os
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from multiprocessing import get_context, parent_process
from pathlib import Path

import numpy as np

from handfit_core import fit, geometry, paper, skeleton, solvers
from handfit_core.detect import correction
from handfit_core.detect.correction import network
from handfit_core.detect.keypoints import Track
from handfit_core.evaluate import methods
from handfit_core.evaluate.kept import code_digest, load_kept, save_kept
from handfit_core.evaluate.methods import TrackResult, get_method
from handfit_core.evaluate.scores import ProtocolName
from handfit_core.fit import doubt
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel, anatomy, chain, data, landmarks, load_model, surface
from handfit_core.skeleton import Side
from handfit_core.worker.events import THREAD_VARIABLES


@dataclass(frozen=True, eq=False)
class FitTask:
    """One method on one track."""

    method: str
    track: Track
    intrinsics: Intrinsics


class Fits:
    """The results of methods on tracks, kept in a folder."""

    def __init__(
        self, folder: Path, protocol: ProtocolName, model: str | None, sides: Iterable[Side]
    ) -> None:
        self._folder = folder
        self._protocol: ProtocolName = protocol
        self._model = model
        self.models: Mapping[Side, HandModel] = {side: load_model(model, side) for side in sides}
        libraries = "|".join(_version(name) for name in ("numpy", "scipy", "torch"))
        self._made_with = f"{protocol}|{libraries}|{_code()}"
        self._of_model = {side: _content(model) for side, model in self.models.items()}

    def run(self, tasks: Sequence[FitTask], jobs: int) -> Iterator[FitTask]:
        """Run what is not kept yet; yields each task when its result is there."""
        missing: list[FitTask] = []
        for task in tasks:
            if self._path(task).is_file():
                yield task
            else:
                missing.append(task)
        if jobs <= 1 or len(missing) <= 1:
            for task in missing:
                _fit(self._protocol, self.models, task, self._path(task))
                yield task
            return
        executor = ProcessPoolExecutor(jobs, get_context("spawn"), _set_up, (self._model, tuple(self.models)))
        try:
            with _one_thread_per_child():
                running = {
                    executor.submit(_fit_in_child, self._protocol, task, self._path(task)): task
                    for task in missing
                }
            for future in as_completed(running):
                future.result()
                yield running[future]
        finally:
            executor.shutdown(cancel_futures=True)

    def result(self, task: FitTask) -> TrackResult:
        """A task's result; made again where the kept file was damaged."""
        arrays = load_kept(self._path(task))
        if arrays is None:
            self._path(task).unlink(missing_ok=True)
            list(self.run([task], jobs=1))
            arrays = load_kept(self._path(task))
            assert arrays is not None
        return TrackResult(**arrays)

    def _path(self, task: FitTask) -> Path:
        side = task.track.side
        sha = hashlib.sha256(
            f"{self._made_with}|{task.method}|{side}|{task.track.fps!r}|{task.track.frame_count}|{self._of_model[side]}|{task.intrinsics}".encode()
        )
        hands = task.track.detections
        for column in (hands.frame, hands.side, hands.score, hands.keypoints, hands.world, hands.overlapped):
            sha.update(b"none" if column is None else column.tobytes())
        return self._folder / task.method / f"{sha.hexdigest()[:32]}.npz"


def _content(model: HandModel) -> str:
    """Its digest, and what fits use besides: a prior's relaxed pose, and the name, which limits go by."""
    relaxed = hashlib.sha256(np.ascontiguousarray(model.hands_mean).tobytes()).hexdigest()
    return f"{model.name}|{model.digest}|{relaxed}"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _code() -> str:
    """Of all that turns a track into a result. How models are read is not in it: their content counts."""
    layer = Path(skeleton.__file__).parent / "layer.py"  # which needs torch to be imported
    of_models = (anatomy, chain, data, landmarks, surface, layer)
    learnt = [
        hashlib.sha256(f.read_bytes()).hexdigest() for f in (anatomy.LANDMARKS_FILE, network.FILE, doubt.FILE)
    ]
    of_solvers = (fit, paper, solvers, correction, geometry, skeleton)
    code = code_digest(*of_solvers, methods, *of_models)
    return "|".join([code, *learnt])


def _fit(protocol: ProtocolName, models: Mapping[Side, HandModel], task: FitTask, path: Path) -> None:
    """Do a task, and keep its result at `path`."""
    method = get_method(task.method, protocol)
    save_kept(path, vars(method(models, task.track, task.intrinsics)))


_models: dict[Side, HandModel] = {}
"""The hand models of this process, where it is one of several"""


def _set_up(model: str | None, sides: tuple[Side, ...]) -> None:
    """Make a new process ready for tasks."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _models.update({side: load_model(model, side) for side in sides})


def _end_with_parent() -> None:
    """A killed parent tells its children nothing: they would wait for work for ever."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _fit_in_child(protocol: ProtocolName, task: FitTask, path: Path) -> None:
    _fit(protocol, _models, task, path)


@contextlib.contextmanager
def _one_thread_per_child() -> Iterator[None]:
    """Processes started within get one thread each: more threads than cores mostly wait for each other.
    Libraries read these variables when they load."""
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
