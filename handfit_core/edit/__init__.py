"""Changing a captured hand afterwards."""
