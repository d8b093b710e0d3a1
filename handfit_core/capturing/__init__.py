"""From an input to a take: sources, detection, fitting, arms and two views, with every option declared once.
The function is `handfit_core.capture`."""
