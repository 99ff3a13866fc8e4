"""USB devices that answer like real ones, in front of a real libusb: for tests without hardware."""
