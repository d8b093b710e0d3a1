"""A long take becomes hands while the window stays free."""

from __future__ import annotations

import time

import bpy

from scenarios.capturing import begin, done, finish, hands, keys_of, part


def built_in_slices(stage, take, source):
    """What a capture does once the worker has written its take, with a take that somebody else wrote.

    The modal operator of a second capture, which waits behind, ticks it.
    """
    from pathlib import Path

    from handfit_core.options import CaptureOptions

    jobs, scene_of = part("session.jobs"), part("common.block_reference").BlockReference.of

    yield from stage.open_sidebar()
    scene = bpy.context.scene
    job = jobs.Job("long.mp4", (source,), CaptureOptions(), jobs.Building(scene_of("scenes", scene)))
    job.state = "building"
    job._take_path = Path(take)
    jobs.submit(job)
    stage.meter.reset()
    began = time.perf_counter()
    other = yield from begin(stage, source)
    fractions = set()
    while not job.finished:
        fractions.add(round(job.fraction, 3))
        yield 0.0
    took = time.perf_counter() - began
    measured = stage.meter.report()
    done(job)
    yield from finish(stage, other)
    return {
        "seconds": took,
        "fractions": len(fractions),
        "keys": [keys_of(armature) for armature in hands()],
        "measured": measured,
        "idle": (yield from _idle(stage)),
    }


def imported(stage, take):
    """File > Import of the same, at once."""
    assert bpy.ops.manient.import_take(filepath=take) == {"FINISHED"}
    yield 0.0


def _idle(stage):
    """The longest gap between turns of the main loop when nothing but redraws happen."""
    yield 0.5
    stage.meter.reset()
    for _ in range(20):
        stage.area().tag_redraw()
        yield 0.02
    return stage.meter.report()["longest_gap_ms"]
