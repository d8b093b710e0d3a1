"""The commands of a batch; nothing of the core is needed to know them."""

SLOT = "slot"
COMMANDS = {
    "capture": "fit hands to photos, sequences, videos and folders of them",
    "apply": "put the motion of takes, or of photos and videos, onto a character",
    "plan": "write down what capture would do, as tasks for many machines",
    "work": "do what is left of a plan, beside others who do the same",
    "task": "do one task of a plan, or several",
    "farm-template": "write a farm's job file for a plan",
    "collect": "report what came of a plan so far",
    SLOT: "do tasks that come on stdin, for the commands above",
}
"""What help says of each"""
