"""Any amount of footage: what there is to do as a plan, tasks that are done once each, and what came of them.

A plan (`plan.py`) lists tasks. Each is done by a child process (`slot.py`), on this machine (`pool.py`) or
on others, and its results are sealed in its folder (`folder.py`), so that doing one twice is harmless and
whoever comes later goes on. Everything here works without Blender; what a task does is the child's business.
"""
