"""Exported files played back, measured against the vibration, and drawn."""
