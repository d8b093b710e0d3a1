"""What runs in a 3D viewport until the artist ends it, and draws over it: Find Hands and Edit Keypoints."""
