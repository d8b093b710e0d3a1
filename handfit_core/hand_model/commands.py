"""The command line's `model` subcommand: convert MANO's files, and look into hand models.

Handlers import what needs NumPy, so that the parser is built without it.
"""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from handfit_core.common.errors import OptionError
from handfit_core.common.files import check_writable, path_of
from handfit_core.common.skeleton import FINGERS, KEYPOINT_PARENTS, SIDES, keypoints_from_joints
from handfit_core.hand_model.files import OPEN_HAND, load_model, read_model, save_model_npz

if TYPE_CHECKING:
    from handfit_core.hand_model.data import HandModel


def add_model_commands(subparsers: argparse._SubParsersAction) -> None:
    """Add `model convert` and `model info`; each sets `handler`, called as handler(args) -> exit code.

    Handlers raise HandfitError for what the user can mend.
    """
    model = subparsers.add_parser("model", help="convert MANO files, or describe a hand model")
    actions = model.add_subparsers(dest="model_command", metavar="COMMAND", required=True)

    convert = actions.add_parser(
        "convert", help="read a MANO .pkl safely, check it, and write it as .npz without pickles"
    )
    convert.add_argument("source", metavar="SRC.pkl", help="MANO_RIGHT.pkl or MANO_LEFT.pkl")
    convert.add_argument("target", metavar="DST.npz", help="file to write; its folder is made if need be")
    convert.set_defaults(handler=_convert)

    info = actions.add_parser("info", help="side, size, fingerprint and bone lengths of a hand model")
    info.add_argument("model", metavar="FILE", help="a .npz or MANO .pkl file, or open-hand")
    info.set_defaults(handler=_info)


def _convert(args: argparse.Namespace) -> int:
    source, target = path_of(args.source), path_of(args.target)
    if target.suffix.lower() != ".npz":
        raise OptionError(f"{target}: the converted model is a .npz file; give a name that ends in .npz")
    check_writable(target, [source])
    model = read_model(source)
    save_model_npz(model, target)
    print(f"{target}: {model.side} hand, {len(model.v_template)} vertices")
    return 0


def _info(args: argparse.Namespace) -> int:
    if args.model == OPEN_HAND:
        for side in SIDES:
            _describe(load_model(OPEN_HAND, side))
    else:
        _describe(read_model(path_of(args.model)))
    return 0


def _describe(model: HandModel) -> None:
    import numpy as np

    shaped = model.shaped()
    points = keypoints_from_joints(shaped.joints, shaped.tips)
    lengths = 1000 * np.linalg.norm(points[1:] - points[list(KEYPOINT_PARENTS[1:])], axis=1).reshape(5, 4)
    print(f"name      {model.name}")
    print(f"side      {model.side}")
    print(f"vertices  {len(model.v_template)}")
    print(f"faces     {len(model.polygons)}")
    print(f"digest    {model.digest}")
    print("bones mm  from wrist to first joint, then joint to joint, then to the tip (betas 0)")
    for finger, row in zip(FINGERS, lengths, strict=True):
        print(f"  {finger:<8}" + "".join(f"{length:7.1f}" for length in row))
