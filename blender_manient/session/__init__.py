"""What lasts while Blender runs: the worker and its queue, what is known of the source, links that follow
changes, and the properties that files keep. A line here may call scene/ and the worker. It presses no button.
"""
