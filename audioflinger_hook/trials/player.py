"""Plays trials: the daemon plays sound and vibration, so that one audio clock has both."""

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol


@dataclass(frozen=True)
class Played:
    """What the daemon played. All times are in seconds of the audio clock (CLOCK_MONOTONIC).

    sound_began_s, vibration_began_s: when the first frame is heard and felt; None without this
    file. vibration_began_s - sound_began_s is the asynchrony that the daemon expects, after its
    offset: 0 if both files begin together.
    seconds: duration that was played. stopped: whether `stop` ended it early, with a fade.
    peak_dbfs, level_dbfs: peak and r.m.s. of the vibration as sent to the device, that is after
    gain, damping and protection, over the duration; -inf for silence.
    protection_db: largest attenuation by protection, 0 or more. limited: number of samples cut at
    full scale.
    exposure_m_s175: vibration dose that the trial added, m/s^1.75 of the rig; None without a rig.
    """

    sound_began_s: float | None
    vibration_began_s: float | None
    seconds: float
    stopped: bool
    peak_dbfs: float
    level_dbfs: float
    protection_db: float
    limited: int
    exposure_m_s175: float | None


class Player(Protocol):
    """Plays one trial at a time. The tapped sound is not felt while the player is open.

    `DaemonPlayer` asks the running daemon. A test or a simulation may give its own.
    """

    def play(self, sound: Path | None, vibration: Path | None) -> Played:
        """Play both files from their first frames on; return after the end.

        sound: WAV of 1 to 8 channels for the default output, or None. vibration: WAV of one channel
        at any rate, or a .npy file of mono float32 at 48 kHz, in shares of full scale before the
        config's gain; or None. The first and last 50 ms of both are faded. Files of a trial begin
        together; an asynchrony is silence at the beginning of one of them.

        NotPlayedError: the device or the server was lost, or is not there; the trial counts as not
        played. Call `wait`, then offer it again. UsageError: a file is missing, too long or not
        readable. NotFoundError: no daemon runs.
        """
        ...

    def stop(self) -> None:
        """End the trial that plays with a fade of 50 ms. Any thread; without a trial, nothing."""
        ...

    def wait(self, timeout_s: float) -> bool:
        """Wait until the daemon can play; return whether it can."""
        ...

    def close(self) -> None:
        """End the trial that plays; the tapped sound is felt again. May be repeated."""
        ...
