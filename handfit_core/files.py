"""Writing files whole or not at all."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from handfit_core.errors import OutputError


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError if `written_whole(path)` could not work; leaves nothing behind."""
    path = Path(path)
    if path.is_dir():
        raise OutputError(f"{path}: this is a folder; give the name of a file in it")
    folder = path.absolute().parent
    while not folder.exists():
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OutputError(_cannot_write(path, error)) from error


def _cannot_write(path: Path, error: OSError) -> str:
    return f"{path}: cannot write here ({error.strerror}); choose a folder that you may write to"


@contextlib.contextmanager
def written_whole(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a path beside `path` to write to; rename it over `path` once the block succeeds.

    Makes the folder if need be. A crash, a full disk or an error leaves whatever stood at `path`
    before. Raises OutputError with the remedy when the folder cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # The suffix stays last: some exporters append it themselves when they miss it.
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}-", suffix=path.suffix)
        os.close(handle)
    except OSError as error:
        raise OutputError(_cannot_write(path, error)) from error
    beside = Path(name)
    try:
        yield beside
        # mkstemp makes files that only their owner may read; results are ordinary files.
        mask = os.umask(0)
        os.umask(mask)
        beside.chmod(0o666 & ~mask)
        beside.replace(path)
    except OSError as error:
        raise OutputError(f"{path}: could not be written ({error.strerror or error})") from error
    finally:
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
