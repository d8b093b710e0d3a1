"""Running methods on tracks, in several processes if asked, with every result kept for a later run."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np

from handfit_core import fit, geometry, paper, skeleton, solvers
from handfit_core.detect import correction
from handfit_core.detect.correction import network
from handfit_core.detect.keypoints import DetectedTrack
from handfit_core.evaluate import methods
from handfit_core.evaluate.kept import code_digest, load_kept, save_kept
from handfit_core.evaluate.methods import TrackResult, get_method
from handfit_core.evaluate.scores import ProtocolName
from handfit_core.fit import doubt
from handfit_core.geometry.camera import Intrinsics
from handfit_core.hand_model import HandModel, anatomy, chain, data, landmarks, load_model, surface
from handfit_core.skeleton import Side
from handfit_core.worker.pool import Pool
from handfit_core.worker.runner import Answer, InProcess, OnProgress, Runner


@dataclass(frozen=True, eq=False)
class FitTask:
    """One method on one track."""

    method: str
    track: DetectedTrack
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
        with self._runner(jobs if len(missing) > 1 else 1) as runner:
            running = {runner.submit("fit", task=task, path=self._path(task)): task for task in missing}
            for done in runner.results(*running):
                yield running[done["id"]]

    def _runner(self, jobs: int) -> Runner:
        if jobs <= 1:
            return InProcess(_fitting(self._protocol, self.models))

        return Pool(jobs, partial(_fitting_anew, self._protocol, self._model, tuple(self.models)))

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
            f"{self._made_with}|{task.method}|{side}|{task.track.fps!r}|{self._of_model[side]}|{task.intrinsics}".encode()
        )
        for detection in task.track.detections:
            if detection is None:
                sha.update(b"none")
            else:
                sha.update(np.ascontiguousarray(detection.keypoints).tobytes())
                sha.update(np.ascontiguousarray(detection.world).tobytes())
                sha.update(f"{detection.score!r}|{detection.side}".encode())
                if detection.overlapped is not None:
                    sha.update(detection.overlapped.tobytes())
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

    layer = Path(skeleton.__file__).parent / "layer" / "__init__.py"  # which needs torch to be imported
    of_models = (anatomy, chain, data, landmarks, surface, layer)
    learnt = [
        hashlib.sha256(f.read_bytes()).hexdigest() for f in (anatomy.LANDMARKS_FILE, network.FILE, doubt.FILE)
    ]
    of_solvers = (fit, paper, solvers, correction, geometry, skeleton)
    code = code_digest(*of_solvers, methods, *of_models)
    return "|".join([code, *learnt])


def _fitting(protocol: ProtocolName, models: Mapping[Side, HandModel]) -> Answer:
    """Does the request `fit`: its `task`, whose result is kept at its `path`."""

    def fit(
        message: Mapping[str, Any], _should_stop: Callable[[], bool], _on_progress: OnProgress
    ) -> dict[str, Any]:
        task: FitTask = message["task"]
        method = get_method(task.method, protocol)
        save_kept(message["path"], vars(method(models, task.track, task.intrinsics)))
        return {}

    return fit


def _fitting_anew(protocol: ProtocolName, model: str | None, sides: tuple[Side, ...]) -> Answer:
    """`_fitting` in a process of its own, which reads the models once."""
    return _fitting(protocol, {side: load_model(model, side) for side in sides})
