"""Measurement and identification of a rig: sweep in, parameters with intervals out.

    sweep.py -> bench.py (the twin's laboratory) -> recording.py -> transfer.py
                                                        |             distortion.py
                                                        `-> acceleration.py, impedance.py
                                                              `- responses.py, output_error.py
                                      mechanical.py, moving_mass.py -> rig_values.py

calibration.py does all of it in turn, from low levels on.

Whoever measures a real rig fills a `Recording` with what the DAQ read; the rest is the same.
"""

from device.identification.recording import IdentificationError

__all__ = ["IdentificationError"]
