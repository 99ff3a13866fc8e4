"""Identification of a rig: sweep in, parameters with 95 % intervals out.

| module | holds |
| --- | --- |
| sweep, recording, transfer | the played signal, its recording, and whether it can be used |
| responses, output_error | models of a response, and their fit |
| acceleration, mechanics | f0, Q and sensitivity; Bl, mass, Qms |
| impedance | R and L; volts of full scale, the amplifier's high-pass and source impedance |
| calibration | all of these in turn, from low levels up; the rig with its new values |
| simulated_laboratory | plays sweeps to the simulated rig |
| live/ | plays sweeps to real devices |

`IdentificationError` says why a value cannot be identified, with numbers and what to do.
"""

from device.identification.recording import IdentificationError

__all__ = ["IdentificationError"]
