"""The design of the live form: its constants and tables for given parameters and samplerate."""

from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Any, get_type_hints

import numpy as np

from audioflinger_hook.core import blob
from audioflinger_hook.core.rounding import round_section
from audioflinger_hook.transform.design.analysis import AnalysisDesign, InputDesign, OnsetDesign
from audioflinger_hook.transform.design.loudness import LoudnessDesign
from audioflinger_hook.transform.design.speech import SpeechDesign
from audioflinger_hook.transform.design.strength import StrengthDesign, felt_weight
from audioflinger_hook.transform.design.synthesis import (
    ATTACK_HOPS,
    LiveGrid,
    SynthesisDesign,
    TrackingDesign,
)
from audioflinger_hook.transform.mapping import VibrationMapping
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.principal import Spectrum
from device.errors import UsageError
from device.units import FloatArray, Records

__all__ = ["LiveDesign"]

BAND_MARGIN_HZ = 1_000.0
"""Range analysed above the band, to measure the half-power widths of peaks at the band's end."""

STRAIGHT_LINES = 10 ** (-0.17 / 20)
"""Factor on r that gives a tone the same level in live form and reference form, within 0.1 dB. The
reference form interpolates linearly between bins. This makes bandwidths 0.07 to 0.27 dB smaller
than in the live form."""

LATENCY_AT_HZ = 60.0  # reported latencies are for this vibration frequency


@dataclass(frozen=True, eq=False)
class LiveDesign:
    """Constants and tables of the live form, which are read-only.

    samplerate: Hz. grid: time grid. mapping: mapping of frequencies and amplitudes.
    input, analysis, onsets, tracking, synthesis, loudness, strength, speech: design of each step.
    latency_frames: delay in frames from an onset of the sound to the vibration.
    tonal_latency_frames: the same delay for a change or end of a steady sound.
    """

    samplerate: int
    latency_frames: int
    tonal_latency_frames: int
    grid: LiveGrid
    input: InputDesign
    analysis: AnalysisDesign
    mapping: VibrationMapping
    onsets: OnsetDesign
    tracking: TrackingDesign
    synthesis: SynthesisDesign
    loudness: LoudnessDesign
    strength: StrengthDesign
    speech: SpeechDesign

    def __post_init__(self) -> None:
        for value in self.settings().values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @classmethod
    def of(
        cls, parameters: TransformParameters, samplerate: int, *, find_onsets: bool = True
    ) -> "LiveDesign":
        """Return the design for parameters and a samplerate in Hz. The last 8 designs are cached.

        find_onsets: whether onsets are detected; if not, both latencies are equal.
        UsageError: `band_low_hz` is too high for the samplerate.
        """
        return _designed(parameters, samplerate, find_onsets)

    def settings(self) -> Records:
        """Return all constants and tables by name, except `samplerate` and the latencies."""
        found: Records = {}
        for section in (getattr(self, name) for name in SECTIONS):
            for item in fields(section):
                value = getattr(section, item.name)
                # The value of a float parameter may be an integer.
                found[item.name] = float(value) if item.type is float else value
        return found

    def to_bytes(self) -> bytes:
        """Return `records()` as bytes in the format of `core/blob.py`."""
        return blob.pack(self.records())

    def records(self) -> Records:
        """Return `samplerate`, both latencies and `settings()` by name."""
        return {**{name: getattr(self, name) for name in TOP}, **self.settings()}

    @classmethod
    def from_bytes(cls, data: bytes) -> "LiveDesign":
        """Return the design from the bytes of `to_bytes`. UsageError: the bytes are invalid."""
        values = blob.unpack(bytes(data))
        sections = {name: _section(kind, values) for name, kind in SECTIONS.items()}
        top = {name: _taken(values, name, int) for name in TOP}
        if values:
            raise UsageError(f"the design holds unknown values: {', '.join(sorted(values))}")
        return cls(**top, **sections)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, LiveDesign) and self.to_bytes() == other.to_bytes()

    def __hash__(self) -> int:
        return hash(self.to_bytes())

    def __reduce__(self) -> tuple[Any, ...]:
        return LiveDesign.from_bytes, (self.to_bytes(),)


EXACT = ("band_b", "band_a", "low_b", "low_a", "low_sections", "low_smooth", "mix_weights")
"""`round_section` does not round these tables, which are identical on all machines."""

TOP = ("samplerate", "latency_frames", "tonal_latency_frames")
SECTIONS: dict[str, Any] = {
    name: kind for name, kind in get_type_hints(LiveDesign).items() if name not in TOP
}


def _section(kind: Any, values: Records) -> Any:
    types: dict[Any, Any] = {int: int, float: float, FloatArray: np.ndarray}
    return kind(**{i.name: _taken(values, i.name, types[i.type]) for i in fields(kind)})


def _taken(values: Records, name: str, kind: type) -> Any:
    value = values.pop(name, None)
    if not isinstance(value, kind):
        raise UsageError(f"the design lacks {name}, or holds it as something else")
    return value


@lru_cache(maxsize=8)  # a new design for each of many short files would be slow
def _designed(parameters: TransformParameters, samplerate: int, find_onsets: bool) -> LiveDesign:
    grid = LiveGrid.at(parameters, samplerate)
    spectrum = Spectrum.of(parameters, samplerate)
    bins = min(spectrum.bins, int((parameters.band_high_hz + BAND_MARGIN_HZ) / spectrum.bin_hz))
    live = replace(parameters, threshold_hz=parameters.live_threshold_hz)
    full_scale_r = parameters.unit_strength_hz(samplerate) / STRAIGHT_LINES
    mapping = VibrationMapping.of(parameters, full_scale_r)
    onsets = OnsetDesign.of(parameters, grid, mapping, samplerate, find_onsets)
    synthesis = SynthesisDesign.of(parameters, grid, samplerate)
    smoothing_frames = synthesis.delay_s(LATENCY_AT_HZ, samplerate) * samplerate
    # A measured amplitude belongs to the window's centre. The glide to this amplitude adds half a
    # hop, plus half the duration of the glide, averaged over rising glides and other glides.
    glide_hops = 0.5 + (ATTACK_HOPS + 1.0) / 4.0
    tonal_frames = grid.window_frames / 2 + glide_hops * grid.hop_frames + smoothing_frames
    followed = parameters.loudness_db > 0.0
    loudness = LoudnessDesign.of(followed, grid, onsets, samplerate)
    delay_ticks = loudness.delay_ticks if followed else onsets.delay_ticks
    onset_frames = (1.0 + delay_ticks) * grid.tick_frames + smoothing_frames
    latency_frames = round(onset_frames if find_onsets else tonal_frames)
    if not followed and parameters.strength == "fit":
        # Only loudness control can keep gains above 1 under the ceiling.
        hz = synthesis.gain_step_hz * np.arange(float(synthesis.gain_table.size))
        gains = 1.0 / felt_weight(parameters, hz)
        synthesis = replace(synthesis, gain_table=synthesis.gain_table * gains / gains.max())
    suppression_db = parameters.speech_suppression_db
    design = LiveDesign(
        samplerate=samplerate,
        latency_frames=latency_frames,
        tonal_latency_frames=round(tonal_frames),
        grid=grid,
        input=InputDesign.of(parameters, samplerate),
        analysis=AnalysisDesign.of(live, spectrum, bins),
        mapping=mapping,
        onsets=onsets,
        tracking=TrackingDesign.of(parameters, grid.hop_s),
        synthesis=replace(synthesis, begin_frames=latency_frames),
        loudness=loudness,
        strength=StrengthDesign.of(parameters, grid),
        # Without suppression, these constants are not used.
        speech=SpeechDesign.of(
            suppression_db, spectrum.bin_hz, bins, grid.hop_s if suppression_db else 1.0
        ),
    )
    sections = {name: round_section(getattr(design, name), EXACT) for name in SECTIONS}
    return replace(design, **sections)
