"""Identification of real hardware; nothing here opens a device or reads a clock."""
