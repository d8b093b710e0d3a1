"""A captured hand's motion on the bones of any character. A line here computes with NumPy from bones that are
given as arrays, and knows no Blender.

`bones.py` says how an armature's bones lie at rest, `hand_map.py` which of them are a hand, `recognition.py`
finds that out, `transfer.py` turns a captured pose into theirs and back, and `contacts.py` keeps fingertips
that touch touching.
"""
