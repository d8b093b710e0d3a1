"""What the artist presses. A line here may ask Blender for a result, report, and call scene/, modes and the
session's worker; it draws nothing but an operator's own dialog."""
