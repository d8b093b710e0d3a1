"""The result of a capture: its file format, its further views, how good it is, and its contact sheet."""

from handfit_core.take.take import (
    FORMAT_VERSION,
    TAKE_LIMITS,
    HandTrack,
    Take,
    at_rows,
    chosen,
    is_take,
)

__all__ = ["FORMAT_VERSION", "TAKE_LIMITS", "HandTrack", "Take", "at_rows", "chosen", "is_take"]
