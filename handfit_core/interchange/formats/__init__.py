"""Formats of other programs, one a file: what is read as `READER`, what is written as `WRITER`."""
