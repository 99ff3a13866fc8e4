"""Settings of the live form that the section "Cost against error" compares.

A `LiveDesign` configures the native core. It is computed from `TransformParameters` and from
constants in `design.synthesis`. A setting changes one of these values, the length of the FFT, or
the detection of onsets.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from scipy.fft import next_fast_len
from scipy.signal import ellipap

from audioflinger_hook.transform import FloatArray, TransformParameters
from audioflinger_hook.transform.design import LiveDesign, synthesis
from audioflinger_hook.transform.filters import Roots
from audioflinger_hook.transform.haptic import CoreStream
from tools.bench.measures.windows import WindowAnalysis
from tools.bench.sounds.signals import SAMPLERATE, Stereo
from tools.bench.workbench import Subject

DEFAULT = "as it is"


@dataclass(frozen=True)
class Setting:
    """A setting of the live form that differs from the default in one quantity.

    knob: name of the quantity.
    name: label of the row in the table.
    parameters: changed values of `TransformParameters`.
    constants: changed constants of `design.synthesis`.
    padding: length of the FFT relative to the window.
    onsets: whether the start of a sound starts vibration immediately.
    """

    knob: str
    name: str
    parameters: Mapping[str, float | int] = field(default_factory=dict)
    constants: Mapping[str, Any] = field(default_factory=dict)
    padding: float = 2.0
    onsets: bool = True


def hop(hops_a_window: float) -> Setting:
    """Return a setting with another hop size.

    hops_a_window: length of the window relative to the hop.
    """
    hop_ms = 1e3 * TransformParameters().window_s / hops_a_window
    return Setting("hop", f"hop {hop_ms:.0f} ms", constants={"HOPS_A_WINDOW": hops_a_window})


def _filter(order: int, ripple_db: float, stop_db: float) -> Setting:
    constants = {"LOW_PASS": Roots(*ellipap(order, ripple_db, stop_db))}
    name = f"low-pass of order {order}, {ripple_db:g} dB, {stop_db:g} dB"
    return Setting("low-pass", name, constants=constants)


SETTINGS: tuple[Setting, ...] = (
    Setting("", DEFAULT),
    *(hop(hops_a_window) for hops_a_window in (1.0, 1.9, 4.0, 5.5, 11.0)),
    *(Setting("NFFT", f"NFFT {times:g} windows", padding=times) for times in (3.0, 4.0)),
    *(
        Setting("window", f"window {1e3 * window_s:.0f} ms", {"window_s": window_s})
        for window_s in (0.0232, 0.0929)
    ),
    *(Setting("partials", f"{n} partials", {"partials_max": n}) for n in (4, 8, 32)),
    *(
        Setting("rate", f"oscillators at {rate_hz / 1e3:g} kHz", constants={"LOW_RATE_HZ": rate_hz})
        for rate_hz in (1_500.0, 6_000.0, 12_000.0)
    ),
    Setting("onsets", "without onsets", onsets=False),
    _filter(5, 1.0, 35.0),
    _filter(5, 2.0, 38.0),
)


class Setup:
    """The live form of the transform with one setting."""

    def __init__(self, setting: Setting) -> None:
        self.setting = setting

        class Padded(TransformParameters):
            def fft_length(self, samplerate: int) -> int:
                wanted = round(setting.padding * self.window_frames(samplerate))
                return int(next_fast_len(wanted, real=True))

        window_s = setting.parameters.get("window_s", TransformParameters().window_s)
        partials_max = setting.parameters.get("partials_max", TransformParameters().partials_max)
        self.parameters = Padded(window_s=window_s, partials_max=int(partials_max))
        with constants_changed(setting.constants):
            self.made = LiveDesign.of(self.parameters, SAMPLERATE, find_onsets=setting.onsets)
        self.tonal_latency_frames = self.made.tonal_latency_frames
        self.subject = Subject(setting.name, lambda _samplerate, channels: self._stream(channels))

    def analysis(self) -> WindowAnalysis:
        """Return a function that finds partials in single windows."""
        return WindowAnalysis(self.made, every=False)

    def _stream(self, channels: int) -> CoreStream:
        return CoreStream(self.made, channels, each=False)

    def vibration(self, sound: FloatArray | Stereo) -> FloatArray:
        """Return the vibration of a sound, (frames,)."""
        return self.subject.vibration(sound, SAMPLERATE)


@contextmanager
def constants_changed(changed: Mapping[str, Any]) -> Iterator[None]:
    """Change constants of `design.synthesis` within a `with` block."""
    kept: list[tuple[str, Any]] = []
    try:
        for name, value in changed.items():
            kept.append((name, getattr(synthesis, name)))
            setattr(synthesis, name, value)
        yield
    finally:
        for name, before in kept:
            setattr(synthesis, name, before)
