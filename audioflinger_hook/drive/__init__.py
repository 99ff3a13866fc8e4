"""Vibration to actuators: `device.drive` designs the processing, and core/drive computes it."""
