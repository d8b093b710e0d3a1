"""Two takes of the same hands, filmed by two cameras, made one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from handfit_core.capturing.options import CaptureOptions
from handfit_core.capturing.views.pairing import PairingAttempt, attempt_pairing
from handfit_core.capturing.views.readings import ViewTake, readings
from handfit_core.capturing.views.rig_file import Rig
from handfit_core.capturing.views.two_view_fit import fitted_to_both
from handfit_core.capturing.views.verdict import Evidence, degrees_apart, verdict_of
from handfit_core.fit.settings import VIEWS
from handfit_core.take import Take
from handfit_core.take.fit_quality import mean_expected_error
from handfit_core.take.views import Verdict


def joined(
    first: ViewTake,
    second: ViewTake,
    options: CaptureOptions,
    rig: Rig | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Take:
    """The first view's take with hands fitted to both views, their cameras and the verdict; where the views
    do not belong together, the better view's take with the verdict alone. `rig`: the cameras, with whose
    lenses both were captured. `on_step` is called before each step, and may raise to stop."""
    longest = max(first.times[-1], second.times[-1])
    if options.offset is None and longest > VIEWS.longest_view:
        most = f"{VIEWS.longest_view / 60.0:.0f} minutes"
        why = (
            f"The views are longer than the {most} in which their offset is looked for: tell it, or cut them"
        )
        return _likelier_take(first, second, why)
    attempts: list[PairingAttempt] = []
    for other, mirrored in readings(first, second, options):
        attempt = attempt_pairing(first, other, options, rig, on_step, mirrored=mirrored)
        if attempt is not None:
            attempts.append(attempt)
            if attempt.found.residual <= VIEWS.good_residual:
                break
    if not attempts:
        when = "" if options.offset is None else f" with an offset of {options.offset:g} seconds"
        return _likelier_take(first, second, f"No hand is seen in both views at the same time{when}")
    best = min(attempts, key=lambda each: each.found.cost)
    if rig is None and options.baseline is not None:
        best = best.scaled(options.baseline)
    on_step()
    verdict = _verdict(best, first, options)
    if verdict.agreement == "failed":
        return _likelier_take(first, second, verdict.text)
    return fitted_to_both(best, first, options, verdict, on_step)


def _verdict(attempt: PairingAttempt, first: ViewTake, options: CaptureOptions) -> Verdict:
    found = attempt.found
    return verdict_of(
        Evidence(
            offset_frames=found.offset * first.take.fps,
            error=max(found.error),
            residual=found.residual,
            common=attempt.common,
            apart=degrees_apart(found.rotation, found.translation, found.state.wrist),
            halves=attempt.halves_apart if attempt.priors.rotation is None else np.nan,
            score=np.nan if options.offset is not None else attempt.score,
            dropped=attempt.dropped,
            cameras_known=attempt.priors.rotation is not None,
            left_open=found.left_open,
        )
    )


def _likelier_take(first: ViewTake, second: ViewTake, why: str) -> Take:
    """The take of the view whose hands are likelier right, of one that is not much shorter than the first,
    with a verdict that says why it is alone."""
    takes = first.take, second.take
    errors = [[mean_expected_error(hand) for hand in take.hands] for take in takes]
    known = [[error for error in each if error is not None] for each in errors]
    seen = [max(int(np.sum(hand.detected)) for hand in take.hands) for take in takes]
    is_second = all(known) and np.mean(known[1]) < np.mean(known[0]) and 2 * seen[1] >= seen[0]
    return alone(takes, 1 if is_second else 0, why)


def alone(views: Sequence[Take | None], number: int, why: str) -> Take:
    """The take of one of two views, counted from 0, with a verdict that says why it is alone."""
    take = views[number]
    assert take is not None
    text = f"{why}. The {('first', 'second')[number]} view, {take.source.name}, was used alone."
    return replace(take, verdict=Verdict("failed", text))
