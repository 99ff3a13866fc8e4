"""Generated parts of the pages in docs/: `python -m tools.docs --write`."""
