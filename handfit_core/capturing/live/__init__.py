"""Hands that are followed as they move, shown, sent and recorded."""
