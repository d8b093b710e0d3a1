"""What scripts/release.py and scripts/bump_version.py share. Standard library only, so that a version can be
bumped before anything is installed."""
