"""What stands between the vibration and its output, as the settings want it."""

from __future__ import annotations

from audioflinger_hook.config.settings import Settings
from device.drive.actuators import Actuators
from device.drive.driving import Driving, driving_for
from device.drive.twins import Twins, twins_for
from device.output import VibrationOutput
from device.rig import rig_by_name
from device.rig.twin import Twin


def driving_of(settings: Settings, samplerate: int, channels: int) -> Driving | None:
    """Return what is done for the one rig on all channels; None where nothing is, or no such rig.

    samplerate: of the mix, Hz; channels: of the vibration. UsageError: the samplerate is too low.
    """
    if settings.actuators:
        return None
    return driving_for(
        settings.rig,
        samplerate,
        channels,
        damping=settings.damping,
        protection=settings.protection,
        exposure_cap=settings.exposure_cap,
    )


def actuators_of(settings: Settings, samplerate: int) -> Actuators | None:
    """Return the actuators that the settings name, for a mix of this rate, Hz; None without any.

    UsageError: the samplerate is too low for what is to be done for one of them.
    """
    if not settings.actuators:
        return None
    return Actuators(
        settings.actuators,
        samplerate,
        rig=settings.rig,
        damping=settings.damping,
        protection=settings.protection,
        exposure_cap=settings.exposure_cap,
    )


def twin_of(
    settings: Settings,
    samplerate: int,
    channels: int,
    recorder: VibrationOutput | None = None,
) -> Twin | Twins:
    """Return the simulated rig, or those of all actuators, on as many channels as a device has."""
    if not settings.actuators:
        return Twin(rig_by_name(settings.rig), samplerate, channels, recorder=recorder)
    return twins_for(
        settings.actuators,
        settings.numbered_channels,
        samplerate,
        rig=settings.rig,
        recorder=recorder,
    )
