"""Finding hands in pictures. One detector per module."""
