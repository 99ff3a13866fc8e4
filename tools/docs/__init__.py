"""Generates parts of docs/, and numbers in README.md and docs/: `python -m tools.docs --write`."""
