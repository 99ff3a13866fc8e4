"""Trials with a person: the daemon plays them, and a page asks the questions."""
