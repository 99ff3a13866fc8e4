"""Identification of a rig: sweep in, parameters with 95 % intervals out.

| module | holds |
| --- | --- |
| sweep, recording, transfer | what is played, what was recorded, and whether it can be used |
| responses, output_error | models of a response, and their fit |
| acceleration, impedance, mechanics | f0, Q and sensitivity; R and L; Bl, mass, Qms |
| calibration | all of it in turn, from low levels up; the rig with its new values |
| simulated_laboratory | plays sweeps to the simulated rig |
| live/ | plays sweeps to real devices |

What cannot be identified raises `IdentificationError`, whose message gives the reason, the values
and what to do.
"""

from device.identification.recording import IdentificationError

__all__ = ["IdentificationError"]
