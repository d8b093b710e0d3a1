"""Find Hands: all hands of one picture over it, of which the artist chooses those that are built."""
