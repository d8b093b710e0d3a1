"""The command `lens`: measure a camera's lens once, for all captures with it."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from handfit_core.common.errors import OptionError
from handfit_core.common.files import output_path, path_of, printable, written_whole
from handfit_core.media.chessboard import board_png, measure_lens
from handfit_core.media.lenses import checked_name, save_lens, saved_lenses

_ADVICE = (
    "open it on the whole screen, and film it for half a minute: the whole board, in all "
    "corners of the picture, near and far, and up to 45 degrees from each side"
)


def add_lens_command(subparsers: argparse._SubParsersAction, progress: Callable) -> None:
    """Add `lens`, which sets `handler`, called as handler(args) -> exit code. `progress` is called with its
    arguments and the counts of frames that are read and of all."""
    lens = subparsers.add_parser(
        "lens", help="measure a camera's lens from a film of a chessboard on a screen; --lens NAME uses it"
    )
    what = lens.add_mutually_exclusive_group(required=True)
    what.add_argument("clip", nargs="?", metavar="CLIP", help="a film, or a folder of photos, of the board")
    what.add_argument("--board", metavar="FILE.png", type=path_of, help="write the board's picture")
    what.add_argument("--list", action="store_true", help="tell which lenses are saved")
    what.add_argument("--remove", metavar="NAME", help="forget a saved lens")
    lens.add_argument("--name", metavar="NAME", help="what the measured lens is called from now on")
    lens.set_defaults(handler=partial(_lens, progress))


def _lens(progress: Callable, args: argparse.Namespace) -> int:
    if args.board is not None:
        path = output_path(args.board)
        with written_whole(path) as beside:
            beside.write_bytes(board_png())
        print(f"{printable(str(path))}: {_ADVICE}")
    elif args.list:
        for name, measured in saved_lenses().items():
            print(f"{printable(name)}: {measured.said}")
    elif args.remove is not None:
        save_lens(args.remove, None)
    elif args.name is None:
        raise OptionError("give the lens a name, with --name: captures call it by that")
    else:
        name = checked_name(args.name)
        measured = measure_lens(args.clip, partial(progress, args))
        save_lens(name, measured)
        print(f"{printable(name)}: {measured.said}")
    return 0
