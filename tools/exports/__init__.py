"""Renders exported files, compares the result with the original vibration, and draws both."""
