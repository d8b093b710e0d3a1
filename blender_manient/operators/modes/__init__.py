"""What runs in a 3D viewport until the artist ends it: Find Hands and Edit Keypoints. A line here may draw
over the viewport and ask the worker; which events come, and what is reported, its operator says."""
