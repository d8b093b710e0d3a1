"""Photos, image sequences and videos as numbered, upright frames; what a file claims before it is decoded. A
line here may open files and decode them with OpenCV, and knows nothing of hands."""
