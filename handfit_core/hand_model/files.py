"""Reading and writing hand models: our `.npz` (no pickles), and MANO's `.pkl` through `mano_pickle`."""

from __future__ import annotations

import contextlib
import json
import os
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from handfit_core.common.arrays import arrays_of, declared
from handfit_core.common.errors import HandModelError
from handfit_core.common.files import path_of, read_file, shown, why, written_whole
from handfit_core.common.npz import NotNpz, NpzArchive
from handfit_core.common.skeleton import SIDES, Side, other_side
from handfit_core.common.values import text, whole
from handfit_core.hand_model.checks import checked_model
from handfit_core.hand_model.data import LIMITS, HandModel

OPEN_HAND = "open-hand"
"""Name of the bundled model; anything else given as a model is a path."""


FORMAT_NAME = "handfit-model"
FORMAT_VERSION = 1

ARRAY_NAMES = tuple(declared(HandModel))
"""All arrays of a model, named as in `HandModel` and in the file."""

_SUFFIXES: Final = (".npz", ".pkl")


def load_model(model: str | os.PathLike[str] | None, side: Side) -> HandModel:
    """Load the hand model of one side.

    `model` is None or "open-hand" for the bundled hand; a `.npz` or MANO `.pkl` file of that side; or a
    folder that holds MANO_RIGHT and MANO_LEFT (`.npz` or `.pkl`). Given one side's file for the other side,
    its neighbour `MANO_LEFT`/`MANO_RIGHT` is used if it exists.

    Raises HandModelError.
    """
    if side not in SIDES:
        raise HandModelError(f"a hand's side must be left or right, not {side!r}")
    if model is None or str(model) == OPEN_HAND:
        return _open_hand(side)
    path = path_of(model)
    try:
        if not path.exists():
            raise HandModelError(
                f"{shown(path)}: there is no such hand model; give a MANO .pkl or .npz, a folder with both "
                f"sides, or '{OPEN_HAND}'"
            )
        path = file_of_side(path, side)
    except (OSError, ValueError) as error:
        raise HandModelError(f"{shown(path)}: this hand model cannot be read ({why(error)})") from error
    found = read_model(path)
    if found.side != side:
        raise HandModelError(
            f"{path}: this is a {found.side} hand, but the {side} hand was asked for; give the folder "
            "that holds both MANO_LEFT and MANO_RIGHT"
        )
    return found


def kept_model(model: str, side: Side) -> HandModel:
    """Load a model as `load_model` does, but cached: the same object every time, until its file changes; a
    slider's step or an edit while the artist drags must not read a file.

    Raises HandModelError.
    """
    try:
        found = file_of_side(path_of(model), side).stat()
    except (OSError, ValueError, HandModelError):
        return load_model(model, side)  # the open hand, or it says what is wrong
    return _kept(model, side, (found.st_mtime_ns, found.st_size, found.st_ino))


@lru_cache(maxsize=4)
def _kept(model: str, side: Side, _stamp: tuple[int, int, int]) -> HandModel:
    return load_model(model, side)


def file_of_side(path: Path, side: Side) -> Path:
    """Return the file of one side in a folder, or beside a file of the other side."""
    if path.is_dir():
        if found := _mano_files(path, side, _SUFFIXES):
            return found[0]
        raise HandModelError(
            f"{path}: this folder has no MANO_{side.upper()}.pkl or .npz for the {side} hand"
        )
    if f"mano_{other_side(side)}" in path.stem.lower():
        return next(iter(_mano_files(path.parent, side, (path.suffix.lower(),))), path)
    return path


def files_of_model(path: Path) -> list[Path]:
    """Return the files that `load_model` may read for a path: those of both sides, as far as they are
    there."""
    found: dict[Path, None] = {}
    for side in SIDES:
        with contextlib.suppress(HandModelError, OSError, ValueError):
            found[file_of_side(path, side)] = None
    return [file for file in found if file.is_file()]


def _mano_files(folder: Path, side: Side, suffixes: tuple[str, ...]) -> list[Path]:
    names = (stem + suffix for suffix in suffixes for stem in (f"MANO_{side.upper()}", f"mano_{side}"))
    return [folder / name for name in names if (folder / name).is_file()]


def read_model(path: Path) -> HandModel:
    """Read one model file of either format, whichever side it is of. Raises HandModelError."""
    if path.suffix.lower() == ".pkl":
        # Imported late, as the open hand does not need it.
        from handfit_core.hand_model.mano_pickle import load_mano_pickle

        return load_mano_pickle(path)
    return load_model_npz(path)


@lru_cache(maxsize=2)
def _open_hand(side: Side) -> HandModel:
    return load_model_npz(Path(__file__).parent / "data" / f"open_hand_{side}.npz", bundled=True)


def load_model_npz(path: str | os.PathLike[str], *, bundled: bool = False) -> HandModel:
    """Read a model that `save_model_npz` wrote. Raises HandModelError."""
    path = Path(path)
    try:
        archive = NpzArchive(read_file(path, LIMITS.file_bytes), LIMITS.memory_bytes)
        header = archive.header()
        if header.get("format") != FORMAT_NAME:
            raise NotNpz("is of another format")
        version = whole("version", header.get("version"), 1)
        name, side = (text(key, header.get(key), LIMITS.name_length) for key in ("name", "side"))
        arrays = {key: archive.array(key, "fiu") for key in ARRAY_NAMES if key in archive}
    except OSError as error:
        raise HandModelError(f"{shown(path)}: this hand model cannot be read ({why(error)})") from error
    except (NotNpz, KeyError, ValueError) as error:
        reason = f"it {error}" if isinstance(error, NotNpz) else error
        raise HandModelError(
            f"{path}: not a hand model of ours, or a damaged one ({reason}); make it again with "
            "'python -m handfit_core model convert'"
        ) from error
    if version > FORMAT_VERSION:
        raise HandModelError(
            f"{path}: this hand model has format version {version}, this program reads up to "
            f"{FORMAT_VERSION}; update the add-on"
        )
    return checked_model(arrays, where=str(path), name=name, side=side, source="" if bundled else str(path))


def save_model_npz(
    model: HandModel, path: str | os.PathLike[str], notes: dict[str, str] | None = None
) -> Path:
    """Write a model as `.npz` without pickles; `notes` (provenance, licence) go into its header.

    The same model gives the same bytes. Raises OutputError.
    """
    path = Path(path)
    header = {
        "format": FORMAT_NAME,
        "version": FORMAT_VERSION,
        "name": model.name,
        "side": model.side,
        "notes": notes or {},
    }
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header, ensure_ascii=False))}
    for key, array in arrays_of(model).items():
        integer = np.issubdtype(array.dtype, np.integer)
        arrays[key] = np.asarray(array, dtype=np.int32 if integer else np.float32)
    with written_whole(path, load_model_npz) as beside:
        _save_npz_reproducibly(beside, arrays)
    return path


def _save_npz_reproducibly(path: Path, arrays: dict[str, Any]) -> None:
    """Write arrays as `np.savez_compressed` does, but without stamping the time into the zip, so that the
    same arrays give the same bytes."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, array in arrays.items():
            info = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            info.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(info, "w") as stream:
                np.lib.format.write_array(stream, np.asanyarray(array), allow_pickle=False)
