"""Identification of a rig: sweep in, parameters with 95 % intervals out.

| module | holds |
| --- | --- |
| recording, transfer | the played sweep, its recording, and whether it can be used |
| responses, output_error | models of a response, and their fit |
| acceleration, impedance, mechanics | what a recording shows: mode; coil and amplifier; Bl, mass |
| calibration | all of these in turn, from low levels up; the rig with its new values |
| simulated_laboratory, live/ | play sweeps to the simulated rig; to real devices |
"""

from device.identification.recording import IdentificationError

__all__ = ["IdentificationError"]
