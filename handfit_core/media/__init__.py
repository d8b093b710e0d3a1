"""Photos, image sequences and videos as numbered, upright frames; what a file claims before it is decoded."""
