"""Arrays, pickles and single values from anywhere, checked before they are read."""
