"""The worker by the names that batches know."""

from handfit_core.worker.client import Worker as Runner
from handfit_core.worker.events import THREAD_VARIABLES, Event

__all__ = ["THREAD_VARIABLES", "Event", "Runner"]
