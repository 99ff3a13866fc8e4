"""The live form compiled: `_kernel` does in one call a block what `live.py` does in NumPy.

    native/live.c: intake.c -> fft.c -> peaks.c, analysis.c -> tracking.c -> synthesis.c

`live.py` says what is to come out, the kernel makes it for a fifteenth of the cost. Where it could
not be built or does not load, `live.py` itself is what plays.
"""

from __future__ import annotations

from types import ModuleType
from typing import Any

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, Frames
from audioflinger_hook.transform.input_stage import MAGNITUDE_MAX, fitting
from audioflinger_hook.transform.live import loudness, onset_partials, onsets, partials, synthesis
from audioflinger_hook.transform.live.speech import speech_settings
from audioflinger_hook.transform.live.synthesis import TABLE_STEP_HZ
from audioflinger_hook.transform.live.transform import LiveTransform
from audioflinger_hook.transform.mapping import slope
from device.extension import load

_MadeOf = tuple[dict[str, Any], int, bool, tuple[int, int]]

_kernel: ModuleType | None
try:
    _kernel = load("audioflinger_hook.transform._kernel", "LiveKernel")
except ImportError as error:
    _kernel = None
    _why_missing = str(error)


def kernel_warning() -> str | None:
    """Return what is missing where the live form is not compiled, and what it costs; else None."""
    if _kernel is not None:
        return None
    return (
        f"the transform runs uncompiled, the same vibration for about fifteen times the processor "
        f"time ({_why_missing}); to build it: `rm -rf .venv`, then `make run`, with a C compiler"
    )


class KernelStream:
    """One stream of the live form, (frames, channels) to (frames, channels or 1), compiled.

    form: the same for one channel in NumPy, whose settings it takes over. each: every channel is
    transformed by itself instead of their mean. The vibration is that of `ChannelBank` within
    1e-6 of full scale, the counters and what any split changes (nothing) are the same. Memory is
    taken when it is made and not after. Held by one thread at a time.

    Raises
    ------
    RuntimeError
        The kernel is not there: see `kernel_warning`.
    """

    def __init__(self, form: LiveTransform, channels: int, each: bool) -> None:
        latencies = form.latency_frames, form.tonal_latency_frames
        self._begin(settings_of(form), channels, each, latencies)

    def _begin(
        self, settings: dict[str, Any], channels: int, each: bool, latencies: tuple[int, int]
    ) -> None:
        if _kernel is None:
            raise RuntimeError(kernel_warning())
        self._kernel = _kernel.LiveKernel(settings, channels, each)
        self._made_of = (settings, channels, each, latencies)
        self._channels = channels
        self._channels_out = channels if each else 1
        self.latency_frames, self.tonal_latency_frames = latencies

    def __getstate__(self) -> tuple[_MadeOf, bytes]:
        return self._made_of, self._kernel.state

    def __setstate__(self, state: tuple[_MadeOf, bytes]) -> None:
        made_of, numbers = state
        self._begin(*made_of)
        self._kernel.state = numbers

    @property
    def delivered_frames(self) -> int:
        """Frames of vibration given so far."""
        delivered: int = self._kernel.delivered
        return delivered

    @property
    def replaced_samples(self) -> int:
        """Unusable samples that were taken for 0 so far."""
        replaced: int = self._kernel.replaced
        return replaced

    @property
    def limited_samples(self) -> int:
        """Samples of vibration that the limiter has changed, some not delivered yet."""
        limited: int = self._kernel.limited
        return limited

    def process(self, frames: Frames) -> FloatArray:
        """Return (frames, channels out) of vibration for sound that `fitting` takes.

        Raises as `fitting` does. Called on the audio thread: what Python does here costs more than
        the kernel, where other programs have had the caches since the last block.
        """
        try:
            vibration = np.empty((len(frames), self._channels_out))
            self._kernel.process(frames, vibration)
        except (TypeError, ValueError, BufferError):
            # One of the rare ways of holding sound, or none at all.
            frames = fitting(frames, self._channels)
            vibration = np.empty((len(frames), self._channels_out))
            self._kernel.process(frames, vibration)
        return vibration

    def finish(self) -> FloatArray:
        """Return the last `latency_frames` of vibration, as if silence followed; begin anew."""
        owed = self.process(np.zeros((self.latency_frames, self._channels)))
        self._kernel.reset()
        return owed

    def reset(self) -> None:
        """Begin a new stream; the counters go on."""
        self._kernel.reset()


def settings_of(form: LiveTransform) -> dict[str, Any]:
    """Return all numbers and tables by which a live form works, as the kernel names them."""
    grid, spectrum, analysis = form._grid, form._spectrum, form._analysis
    parameters, bank, smoother = form._parameters, form._bank, form._smoother
    detector, tick_bank = form._detector, form._tick_bank
    scale_hz, scale_ratio = slope(parameters)
    return {
        "ticks": grid.ticks,
        "tick_steps": grid.tick_steps,
        "tick_frames": grid.tick_frames,
        "find_onsets": int(form._onsets),
        "short_frames": detector.window_frames,
        "short_length": detector.fft_length,
        "short_bins": detector.bins,
        "short_ticks": detector.window_ticks,
        "newest_frames": detector._half,
        "back_ticks": onsets.BACK_TICKS,
        "rearmed_ticks": onsets.REARMED_TICKS,
        "rearmed": onsets.REARMED,
        "rest_ticks": onsets.REST_TICKS,
        "heard_ticks": onsets.HEARD_TICKS,
        "groups_max": onsets.GROUPS,
        "fresh_max": onsets.ONSET_PARTIALS_MAX,
        "hold_hops": form._tracker._hold_hops,
        "tick_s": form._fresh._tick_s,
        "short_scale": detector._scale,
        "quietest": detector.quietest,
        "weakest": detector.weakest,
        "fading": detector._fading,
        "forgotten": onsets.FORGOTTEN,
        "rise": onsets.RISE,
        "minor": onsets.MINOR,
        "risen_share": onsets.RISEN_SHARE,
        "apart_from": onsets.APART_FROM,
        "worth": onset_partials.WORTH,
        "birth_phase": onset_partials.BIRTH_PHASE,
        "fresh_reach": partials.FRESH_REACH,
        "worth_holding": partials.WORTH_HOLDING,
        "tick_glide": tick_bank._glide,
        "tick_glide_s": tick_bank._turn_glide / (2.0 * np.pi),
        "short_window": detector._window,
        "short_hz": detector.bin_hz,
        "band_edges": np.array(detector.edges, dtype=np.float64),
        "one_tone": np.array(onsets.ONE_TONE),
        "rise_shares": np.array(onset_partials.RISE),
        "window_frames": grid.window_frames,
        "hop_frames": grid.hop_frames,
        "decimation": grid.decimation,
        "steps": grid.steps,
        "hops_in_window": grid.hops_in_window,
        "fft_length": spectrum.fft_length,
        "bins": analysis._bins,
        "first_bin": analysis._first,
        "last_bin": analysis._last,
        "partials_max": parameters.partials_max,
        "ring_hops": form._ring_hops,
        "by_energy": int(parameters.level_law == "energy"),
        "magnitude_max": MAGNITUDE_MAX,
        "denormal_guard": form._bandpass._guard,
        "silence": form._silence,
        "bin_hz": analysis._bin_hz,
        "threshold_hz": analysis._threshold_hz,
        **_following(form),
        "peak_span_min": analysis._peak_span_min,
        "weakest_image": analysis._weakest_image,
        "image_first": analysis._first_sample,
        "weakest_share": analysis._weakest_share,
        "side_lobe": analysis._side_lobe,
        "full_scale_r": form._full_scale_r,
        "scale_hz": scale_hz,
        "scale_ratio": scale_ratio,
        "band_low_hz": parameters.band_low_hz,
        "bottom_hz": parameters.vibration_bottom_hz,
        "ceiling": synthesis.CEILING,
        "knee": synthesis.KNEE,
        "hop_s": grid.hop_s,
        "match_audio_hz": partials.MATCH_HZ_A_WINDOW / parameters.window_s,
        "match_ratio": partials.MATCH_RATIO,
        "first_hz": partials.FIRST_HZ,
        "split_hz": partials.SPLIT_HZ,
        "steady_hz": partials.STEADY_HZ,
        "steady_ratio": partials.STEADY_RATIO,
        "steady_gain": partials.STEADY_GAIN,
        "gain_step_hz": TABLE_STEP_HZ,
        "still": synthesis.STILL,
        "window": spectrum._window,
        "band_b": form._bandpass._b,
        "band_a": form._bandpass._a,
        "image_table": analysis._table,
        "image_turn": analysis._turn,
        "attack": bank._attack,
        "glide": bank._glide,
        "seconds": bank._turn / (2.0 * np.pi),
        "glide_s": bank._turn_glide / (2.0 * np.pi),
        "low_b": smoother._b,
        "low_a": smoother._a,
        "phases": smoother._phases,
        "gain_table": smoother._table_gain,
        **speech_settings(form._speech, analysis._bin_hz, analysis._bins),
    }


def _following(form: LiveTransform) -> dict[str, Any]:
    """Return what the loudness follower adds, without a weight where there is none."""
    one = loudness.LoudnessFollower(form._parameters, form._grid.hop_s)
    return {
        "nothing": loudness.NOTHING,
        "programme_start": one.start_db,
        "programme_min": one.programme_min_db,
        "programme_top": loudness.PROGRAMME_TOP_DB,
        "programme_step": one.programme_step_db,
        "programme_rise": one.rise,
        "programme_fall": one.fall,
        "far": loudness.FAR_DB,
        "release": one.release_db,
        "floor_min": one.floor_min_db,
        "floor_rise": one.floor_rise_db,
        "floor_under": loudness.FLOOR_UNDER_PROGRAMME_DB,
        "gate": one.gate_db,
        "gate_margin": loudness.GATE_MARGIN,
        "target": one.target_db,
        "slope": one.slope,
        "gain_max": one.gain_max,
        "loudness_weights": form._loudness_weights,
    }
