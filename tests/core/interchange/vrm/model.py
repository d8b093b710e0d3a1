"""A VRM 1.0 model without a skin: hands of another size than ours, and bones that are turned at rest."""

from __future__ import annotations

import numpy as np

from handfit_core.common.skeleton import FINGER_JOINTS, PARENTS, SIDES
from handfit_core.geometry.rotations import rotmat_to_quat, rotvec_to_rotmat
from handfit_core.hand_model import load_model
from handfit_core.interchange.formats.vrma import GlbContent
from handfit_core.interchange.humanoid import BODY, bone_names, t_pose
from handfit_core.retarget.transfer import SourceHand

_META = {
    "name": "Nobody",
    "version": "1",
    "authors": ["tests"],
    "licenseUrl": "https://vrm.dev/licenses/1.0/",
}


def vrm_model(seed: int = 0) -> bytes:
    """The .vrm file: each finger's segments are 0.8 to 1.2 times as long as the open hand's; fingertips are
    nodes called `leftIndexTip` and so on."""
    rng = np.random.default_rng(seed)
    places = {name: np.array(place) for name, (_, place) in BODY.items()}
    parents = {name: parent for name, (parent, _) in BODY.items()}
    for side in SIDES:
        _, heads = t_pose(SourceHand.of(load_model("open-hand", side).shaped(), side))
        names = bone_names(side)
        for joint in range(1, 16):
            above, stretch = PARENTS[joint], rng.uniform(0.8, 1.2)
            parents[names[joint]] = names[above]
            places[names[joint]] = places[names[above]] + stretch * (heads[joint] - heads[above])
        for finger, (_, second, third) in FINGER_JOINTS.items():
            tip = f"{side}{finger.title()}Tip"
            parents[tip] = names[third]
            places[tip] = 2.0 * places[names[third]] - places[names[second]]
    numbers = {name: number for number, name in enumerate(places)}
    turned = {name: rotvec_to_rotmat(rng.normal(size=3)) for name in places} | {"": np.eye(3)}
    nodes = []
    for name, place in places.items():
        above = parents[name]
        x, y, z = turned[above].T @ (place - places.get(above, np.zeros(3)))
        w, *vector = rotmat_to_quat(turned[above].T @ turned[name]).tolist()
        node = {"name": name, "translation": [x, y, z], "rotation": [*vector, w]}
        children = [numbers[other] for other, parent in parents.items() if parent == name]
        nodes.append(node | ({"children": children} if children else {}))
    bones = {name: {"node": number} for name, number in numbers.items() if not name.endswith("Tip")}
    content = GlbContent()
    content.accessor(np.zeros(1))  # a file without any bytes would need no buffer
    content.json |= {
        "extensionsUsed": ["VRMC_vrm"],
        "scene": 0,
        "scenes": [{"nodes": [numbers["hips"]]}],
        "nodes": nodes,
        "extensions": {"VRMC_vrm": {"specVersion": "1.0", "meta": _META, "humanoid": {"humanBones": bones}}},
    }
    return content.to_bytes()
