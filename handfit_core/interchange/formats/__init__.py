"""Formats of other programs, one a file: what is read as `READER`, what is written as `WRITER`. A line here
says where a format has its numbers, and fits nothing."""
