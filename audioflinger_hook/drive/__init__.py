"""Processing for actuators: `device.drive` makes designs, and C code in core/drive runs them."""
