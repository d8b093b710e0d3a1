"""The check of a Dask cluster's workers."""

from __future__ import annotations

import platform
from typing import Any

from distributed import WorkerPlugin

from handfit_core.common.errors import OptionError
from handfit_core.common.version import __version__


class SameVersions(WorkerPlugin):
    """Keeps workers out of a batch that have another version of handfit_core or of Python than its client.

    Those that are there raise it to the client; who joins later says it in his log, and leaves.
    """

    def __init__(self, version: str, python: str) -> None:
        self.version, self.python = version, python.rpartition(".")[0]

    def setup(self, worker: Any) -> None:
        """Check a worker's versions as it starts. Raises OptionError where they are not the client's."""
        python, said = platform.python_version().rpartition(".")[0], ""
        if python != self.python:
            said = f"runs Python {python}, and the batch {self.python}; use one everywhere"
        elif __version__ != self.version:
            said = f"has version {__version__} of handfit_core, and the batch {self.version}; " + (
                "use the same version on all machines"
            )
        if said:
            worker.loop.add_callback(worker.close, reason=said)
            raise OptionError(f"{worker.address} {said}")
