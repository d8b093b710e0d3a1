"""Two cameras that film the same hands, from unknown places and started at different times."""
