"""A small `Evaluation` with pictures on disk, for tests of the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from handfit_core.evaluate.compare import compare
from handfit_core.evaluate.scores import Evaluation, ProtocolName, Scores
from handfit_core.evaluate.summary import summarise
from tests.core.evaluate.factory import CENTRE, make_hands, make_scores

COUNT = 6
PROBLEMS = {"picture cannot be read": ("Desk/00007",)}


def write_picture(path: Path) -> Path:
    """A flat picture of the size that the factory's camera sees."""
    height, width = int(2 * CENTRE[1]), int(2 * CENTRE[0])
    done, data = cv2.imencode(".png", np.full((height, width, 3), 200, dtype=np.uint8))
    assert done
    path.write_bytes(data.tobytes())
    return path


def make_evaluation(
    folder: Path,
    *,
    dataset: str = "A set",
    kind: str = "folder",
    protocol: ProtocolName = "strict",
    missed: Iterable[int] = (1,),
    problems: Mapping[str, tuple[str, ...]] = PROBLEMS,
    names: Sequence[str] | None = None,
) -> Evaluation:
    """A baseline that is exactly right, `good` (1 mm of noise per axis), and `poor` (8 mm), on six stills."""
    picture = write_picture(folder / "picture.png")
    detected = np.ones(COUNT, dtype=bool)
    detected[list(missed)] = False
    min_points = 1 if protocol == "paper" else 2
    shared = {
        "pictures": (picture,) * COUNT,
        "samples": tuple(names or (f"Desk/{i:05}" for i in range(COUNT))),
        "views": ("palm", "palm", "back", "back", "edge", "unknown"),
        "tags": tuple({"pose": "fist" if i % 2 else "open", "frame": str(i)} for i in range(COUNT)),
    }
    truth = make_scores(
        points_3d=make_hands(COUNT),
        n=COUNT,
        method="null-truth",
        title="the truth",
        is_baseline=True,
        min_points=min_points,
        **shared,
    )
    methods = [
        made(name, noise, seed, detected, min_points, shared)
        for name, noise, seed in (("good", 0.001, 0), ("poor", 0.008, 0))
    ]
    scores = (truth, *methods)
    return Evaluation(
        dataset=dataset,
        kind=kind,
        root=folder,
        protocol=protocol,
        scores=scores,
        summaries={s.method: summarise(s, protocol) for s in scores},
        comparisons=(compare(methods[1], methods[0], "epe"),),
        pictures=COUNT,
        labelled_hands=COUNT,
        extra_hands=1,
        problems=problems,
        notes=("A note.",),
        setup={"machine": "a test's"},
    )


def made(
    name: str, noise: float, seed: int, detected: np.ndarray, min_points: int, shared: Mapping
) -> Scores:
    return make_scores(
        COUNT,
        noise=noise,
        seed=seed,
        method=name,
        title=name,
        detected=detected,
        min_points=min_points,
        **shared,
    )
