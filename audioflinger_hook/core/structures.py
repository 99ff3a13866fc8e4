"""The structures in core.h, for ctypes."""

import ctypes
from ctypes import c_double, c_int, c_ssize_t, c_uint32, c_uint64

CHANNELS, ACTUATORS, PARTIALS = 8, 64, 16
LIMITED_BY = ("", "excursion, current or level", "temperature", "outside")

GLIDE_COLUMNS = (
    *("frame", "frames", "channel", "slot", "start_hz", "end_hz"),
    *("start_amplitude", "end_amplitude", "start_phase"),
)
"""Columns of a glide: the course of one partial for `frames` frames from `frame` on.

Amplitudes are relative to full scale. Phases are in cycles."""

_address = ctypes.c_void_p


class Info(ctypes.Structure):
    """Format, latencies and memory size of a design."""

    _fields_ = (
        *((name, c_uint32) for name in ("samplerate", "inputs", "vibrations", "actuators")),
        *((f"{name}latency_frames", c_uint32) for name in ("", "tonal_", "drive_")),
        ("delay_frames_max", c_uint32),
        ("memory_bytes", c_uint64),
    )


class Sound(ctypes.Structure):
    """Samples in memory. The distances between frames and between channels are in bytes."""

    _fields_ = (
        ("at", _address),
        ("frame_bytes", c_ssize_t),
        ("channel_bytes", c_ssize_t),
        ("is_double", c_int),
    )


_SAFETY = ("coil_c", "magnet_c", "time_s", "squares", "fourths", "above")


class ActuatorSafety(ctypes.Structure):
    """State that the program's next run restores: temperatures in °C, and `DoseSums` of the day."""

    _fields_ = tuple((name, c_double) for name in _SAFETY)


class ActuatorControls(ctypes.Structure):
    """Settings of one actuator, which may change at any time."""

    _fields_ = (
        ("gain", c_double),
        ("delay_frames", c_double),
        ("source", c_uint64),
        ("audible", c_uint64),
        ("restores", c_uint64),
        ("safety", ActuatorSafety),
    )


class Controls(ctypes.Structure):
    """Settings of one core, which may change at any time."""

    _fields_ = (
        ("sound_gain", c_double),
        ("day", c_uint64),
        ("actuators", ActuatorControls * ACTUATORS),
    )


class Level(ctypes.Structure):
    """Decaying peak and running mean square of a signal; 1 is full scale."""

    _fields_ = (("peak", c_double), ("mean_square", c_double))


_GAINS = ("audible", "gain", "least_gain", "exposure_gain")
_FELT = ("running_m_s2", "undamped_squares")
_COUNTS = ("blocks", "limited_blocks", "infeasible_blocks", "replaced", "limited_by")


class ActuatorReadings(ctypes.Structure):
    """Levels, state and counts of one actuator."""

    _fields_ = (
        ("level", Level),
        *((name, c_double) for name in (*_GAINS, "excursion_m", *_SAFETY, *_FELT)),
        *((name, c_uint64) for name in _COUNTS),
    )


class Readings(ctypes.Structure):
    """All values that the core reports."""

    _fields_ = (
        ("frames", c_uint64),
        ("replaced", c_uint64),
        ("limited", c_uint64),
        ("sound", Level * CHANNELS),
        ("vibration", Level * CHANNELS),
        ("sequence", c_uint64),
        ("partials_count", c_uint64),
        ("partials", c_double * 3 * PARTIALS),
        ("actuators", ActuatorReadings * ACTUATORS),
    )


STRUCTURES = (Info, Sound, Controls, ActuatorControls, Readings, ActuatorReadings)
