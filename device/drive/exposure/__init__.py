"""Exposure: how much vibration a sitter has had today, after ISO 2631-1 and 2002/44/EC.

    drive -> decimation -> actuator, or seat -> Wk -> r.m.s., A(8), VDV
             6 kHz         acceleration               dose.py

The core measures (audioflinger_hook/core/drive/exposure.c), by the numbers of design.py; it also
finds the gain that keeps a day's dose under a limit.

The result informs the user of a cushion. It is no measurement on the seat: the acceleration comes
from the linear model, and above 80 Hz, where the standard ends, the weighting is extrapolated.
"""

from device.drive.exposure.dose import CAPS, DoseSums, Exposure

__all__ = ["CAPS", "DoseSums", "Exposure"]
