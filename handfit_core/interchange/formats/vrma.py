"""VRM animation 1.0 (.vrma): binary glTF with a humanoid in VRM's T-pose and an animation of its hands."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.interchange.glb import GlbContent
from handfit_core.interchange.humanoid import BODY, HumanoidHand, bone_names, hands_of
from handfit_core.interchange.writers import Writer
from handfit_core.skeleton import PARENTS
from handfit_core.take import Take

_EXTENSION: Final = "VRMC_vrm_animation"


def vrm_animation(hands: Sequence[HumanoidHand]) -> bytes:
    """The file of hands of different sides. All bones that are animated are there as nodes, and the body's;
    the times are the hands' own, and between them bones turn evenly."""
    places = {name: np.array(place) for name, (_, place) in BODY.items()}
    parents = {name: parent for name, (parent, _) in BODY.items()}
    for hand in hands:
        names = bone_names(hand.side)
        places |= dict(zip(names, hand.heads, strict=True))
        parents |= {name: names[parent] for name, parent in zip(names[1:], PARENTS[1:], strict=True)}
    numbers = {name: number for number, name in enumerate(places)}
    nodes: list[dict[str, Any]] = []
    for name, place in places.items():
        offset = place - places.get(parents[name], np.zeros(3))
        nodes.append({"name": name, "translation": offset.tolist()})
        children = [numbers[other] for other, parent in parents.items() if parent == name]
        if children:  # an empty list is no glTF
            nodes[-1]["children"] = children
    content = GlbContent()
    samplers, tracks = [], []
    for hand in hands:
        times = content.accessor(hand.times)
        for name, quats in hand.quats.items():
            turned = content.accessor(np.roll(quats, -1, axis=1))  # glTF has (x, y, z, w)
            tracks.append({"sampler": len(samplers), "target": {"node": numbers[name], "path": "rotation"}})
            samplers.append({"input": times, "output": turned, "interpolation": "LINEAR"})
    humanoid = {"humanBones": {name: {"node": number} for name, number in numbers.items()}}
    content.json |= {
        "extensionsUsed": [_EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [numbers["hips"]]}],
        "nodes": nodes,
        "animations": [{"name": "hands", "channels": tracks, "samplers": samplers}],
        "extensions": {_EXTENSION: {"specVersion": "1.0", "humanoid": humanoid}},
    }
    return content.to_bytes()


def _write(take: Take, path: Path) -> None:
    path.write_bytes(vrm_animation(hands_of(take)))


def _write_wrist(take: Take, path: Path) -> None:
    path.write_bytes(vrm_animation(hands_of(take, wrist=True)))


WRITER = Writer("VRM animation", (".vrma",), _write, _write_wrist)
