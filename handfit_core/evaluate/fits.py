"""Running methods on tracks, in several processes if asked, with all results cached."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import joblib

from handfit_core import fit, geometry, hand_model, paper
from handfit_core.common import skeleton
from handfit_core.common.arrays import arrays_of
from handfit_core.detect import correction
from handfit_core.detect.correction import network
from handfit_core.evaluate import ProtocolName, methods
from handfit_core.evaluate.cache import cached, code_digest, versions
from handfit_core.evaluate.methods import TrackResult, get_method
from handfit_core.evaluate.rows import TrackInView
from handfit_core.fit import doubt
from handfit_core.hand_model import HandModel, anatomy, load_model

Task = tuple[str, TrackInView]
"""A method's name and the track that it is run on"""


def fit_all(
    tasks: Sequence[Task], protocol: ProtocolName, model: str | None = None, jobs: int = 1
) -> Iterator[TrackResult]:
    """Yield each task's result in turn, from the cache if possible.

    A hand model is the bundled one or a file of someone's, as `load_model` takes it.
    """
    learnt = (anatomy.LANDMARKS_FILE, network.FILE, doubt.FILE)
    code = code_digest(fit, paper, correction, geometry, skeleton, methods, hand_model, *learnt)
    made_with = (protocol, versions("numpy", "scipy", "torch"), code)
    run = joblib.delayed(cached(_fit, "fits", ignore=("task", "protocol", "model")))
    calls = (run((made_with, _key(task, model)), task, protocol, model) for task in tasks)
    # More threads than cores mostly wait for each other, and processes whose parent was killed shall end.
    with joblib.parallel_config("loky", inner_max_num_threads=1, idle_worker_timeout=20):
        results: Any = joblib.Parallel(jobs, return_as="generator")(calls)
        yield from results


def _fit(key: object, task: Task, protocol: ProtocolName, model: str | None) -> TrackResult:  # noqa: ARG001
    name, view = task
    return get_method(name, protocol)(_model(model, view.track.side), view.track, view.intrinsics)


_model = cache(load_model)


def _key(task: Task, model: str | None) -> object:
    """Return a hash of everything but the code that decides a task's result. Models count by their content,
    their relaxed pose, which a prior uses, and their name, which decides about joint limits."""
    name, (track, intrinsics) = task
    hand: HandModel = _model(model, track.side)
    arrays = {key: array.tobytes() for key, array in arrays_of(track.detections).items()}
    of_model = (hand.name, hand.digest, hand.hands_mean.tobytes())
    return joblib.hash((name, track.side, track.fps, track.frame_count, intrinsics, of_model, arrays))
