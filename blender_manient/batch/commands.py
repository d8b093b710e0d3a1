"""The commands of a batch, and what they end with; nothing of the core is needed to know them."""

EXPORT = "export"
COMMANDS = {
    "capture": "fit hands to photos, sequences, videos and folders of them",
    "apply": "put the motion of takes, or of photos and videos, onto a character",
    EXPORT: "make files of takes, for the commands above",
}
"""The names of the commands, with what the help says of each"""

EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE, EXIT_INTERRUPTED = 0, 1, 2, 130
"""The exit codes of a batch, which docs/batch.md lists"""
