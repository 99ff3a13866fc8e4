"""Identification of real hardware: a sweep through an output, its response from an input.

    sweep.py -> exchange.py (callbacks) -> two_clocks.py -> laboratory.py -> calibration.py
                  |        `- channels.py: what each input is, in physical units
                  `- a Transport: device/server/measuring.py, or a simulated one

Nothing here opens a device or reads a clock.
"""
