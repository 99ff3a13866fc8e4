"""The drive path as the settings ask for it."""

from __future__ import annotations

from audioflinger_hook.config.settings import Settings
from device.drive.channel_map import ChannelMap
from device.drive.drive import Drive
from device.output import VibrationOutput
from device.rig import rig_by_name
from device.rig.simulated_rig import SimulatedRig


def drive_of(settings: Settings, samplerate: int, haptic_channels: int) -> Drive:
    """Return the drive for a mix of this rate in Hz and as many channels of vibration.

    UsageError: there is no such rig, or the sample rate is too low for its processing.
    """
    return Drive(
        settings.actuators,
        samplerate,
        haptic_channels,
        rig=settings.rig,
        damping=settings.damping,
        protection=settings.protection,
        exposure_cap=settings.exposure_cap,
    )


def channel_map_of(settings: Settings, haptic_channels: int) -> ChannelMap:
    """Return which actuator each channel of a file or simulated rig plays.

    Where no actuators are named, each channel of the vibration has its own. UsageError: an
    actuator's channel goes by a position, which files do not have.
    """
    if not settings.actuators:
        return ChannelMap.repeated(haptic_channels, haptic_channels)
    return settings.numbered_channels


def simulated_rig_of(
    settings: Settings,
    samplerate: int,
    channel_map: ChannelMap,
    recorder: VibrationOutput | None = None,
) -> SimulatedRig:
    """Return the simulated rig that each channel of the map plays to."""
    names = [actuator.rig or settings.rig for actuator in settings.actuators]
    rigs = [rig_by_name(name) for name in names or [settings.rig] * channel_map.actuators]
    connected = [None if source is None else rigs[source] for source in channel_map.sources]
    return SimulatedRig(connected, samplerate, recorder=recorder)
