"""Whole files: rendering, batches of files, and principal frequencies."""
