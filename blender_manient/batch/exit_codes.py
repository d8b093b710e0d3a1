"""What a run ends with; docs/batch.md lists them."""

EXIT_OK, EXIT_SOME_FAILED, EXIT_USAGE, EXIT_LATER, EXIT_INTERRUPTED = 0, 1, 2, 75, 130
