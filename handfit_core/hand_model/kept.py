"""Where the cache of hand models is imported from until all do it from `files`."""

from handfit_core.hand_model.files import kept_model

__all__ = ["kept_model"]
