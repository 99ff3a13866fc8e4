"""Identification of a rig from sweeps: parameters with 95 % intervals.

| module | contents |
| --- | --- |
| recording, transfer | the played sweep, its recording, and checks of the recording |
| responses, output_error | models of a response, and their fit |
| acceleration, impedance, mechanics | resonance; coil and amplifier; Bl and mass |
| calibration | all these measurements, from low levels up; the rig with the identified values |
| simulated_laboratory, live/ | sweeps on the simulated rig; sweeps on real devices |
"""

from device.identification.recording import IdentificationError

__all__ = ["IdentificationError"]
