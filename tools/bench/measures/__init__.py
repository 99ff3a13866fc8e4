"""Measures of vibration and of rigs."""
