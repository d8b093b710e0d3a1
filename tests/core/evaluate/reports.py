"""A small `Evaluation` with pictures on disk, for tests of the report."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from handfit_core.evaluate import ProtocolName
from handfit_core.evaluate.scores import Evaluation
from handfit_core.evaluate.summary import compare, summarise
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
    detected = ~np.isin(np.arange(COUNT), list(missed))
    shared = {
        "min_points": 1 if protocol == "paper" else 2,
        "picture": (write_picture(folder / "picture.png"),) * COUNT,
        "sample": tuple(names or (f"Desk/{i:05}" for i in range(COUNT))),
        "view": ("palm", "palm", "back", "back", "edge", "unknown"),
        "tags": tuple({"pose": "fist" if i % 2 else "open", "frame": str(i)} for i in range(COUNT)),
    }
    truth = {"method": "null-truth", "title": "the truth", "is_baseline": True}
    scores = (
        make_scores(COUNT, points_3d=make_hands(COUNT), **truth, **shared),
        *(
            make_scores(COUNT, noise=noise, method=name, title=name, detected=detected, **shared)
            for name, noise in (("good", 0.001), ("poor", 0.008))
        ),
    )
    return Evaluation(
        dataset=dataset,
        kind=kind,
        root=folder,
        protocol=protocol,
        scores=scores,
        summaries=pd.DataFrame({s.method: summarise(s, protocol) for s in scores}).T,
        comparisons=(compare(scores[2], scores[1], "epe"),),
        pictures=COUNT,
        labelled_hands=COUNT,
        extra_hands=1,
        problems=problems,
        notes=("A note.",),
        setup={"machine": "a test's"},
    )
