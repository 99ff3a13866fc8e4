"""Fits the strength of the vibration to one person and device, by comparing vibrations."""
