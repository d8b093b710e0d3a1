"""Finding hands in pictures, one detector per module. A line here may read pictures and run networks, and
knows nothing of fits; OpenCV, SciPy and MediaPipe load when a detector is made."""
