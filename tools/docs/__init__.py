"""Generated parts and figures of README.md and docs/: `python -m tools.docs --write`."""
