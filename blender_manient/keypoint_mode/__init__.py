"""Edit Keypoints: the 21 points over the picture, and what dragging one does."""
