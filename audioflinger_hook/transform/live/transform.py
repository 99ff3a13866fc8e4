"""The live form: the same principal frequencies, overlapped, phase-continuous and early."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from audioflinger_hook.transform.arrays import FloatArray, IntArray, strided_windows
from audioflinger_hook.transform.design import LiveDesign
from audioflinger_hook.transform.input_stage import BandPass
from audioflinger_hook.transform.live.analysis import LiveAnalysis
from audioflinger_hook.transform.live.levels import Levels
from audioflinger_hook.transform.live.loudness import LoudnessFollower
from audioflinger_hook.transform.live.onset_partials import OnsetPartials
from audioflinger_hook.transform.live.onsets import OnsetDetector, Ticks
from audioflinger_hook.transform.live.partials import PartialTracker
from audioflinger_hook.transform.live.synthesis import Glides, Synthesizer
from audioflinger_hook.transform.principal import Principals
from audioflinger_hook.transform.spectrum import ComplexArray, Spectrum

TICKS_AT_ONCE = 256
"""Ticks computed in one batch: bounds the memory of a block of any length."""

BoolArray = np.ndarray[tuple[int], np.dtype[np.bool_]]


@dataclass(frozen=True)
class _Window:
    """What one window holds: its principal frequencies, their vibration frequencies in Hz, the gain
    that undoes the low-pass there, its spectrum and its loudness."""

    principal: Principals
    hz: FloatArray
    gain: FloatArray
    spectrum: ComplexArray
    loudness_db: float


class LiveTransform:
    """The live form of one channel, continued from block to block.

    Any split of the stream into blocks gives the same bytes: everything happens on a fixed grid
    of hops, and a block only decides how many are due. Use from one thread at a time.

    Parameters
    ----------
    design : LiveDesign
        All numbers and tables.

    Attributes
    ----------
    levels : Levels
        How strongly partials vibrate.
    told : tuple
        (Hz of the sound, Hz of vibration, amplitude) of what the latest hop vibrates.
    """

    def __init__(self, design: LiveDesign) -> None:
        synthesis, grid = design.synthesis, design.grid
        self.design = design
        self.samplerate = design.samplerate
        self.latency_frames = design.latency_frames
        self.tonal_latency_frames = design.tonal_latency_frames
        self.limited_frames = 0
        self.onset_after_frames = grid.window_frames
        self.told: tuple[tuple[float, float, float], ...] = ()
        self._heard_frames = 0
        self._glides: list[tuple[float, ...]] | None = None
        self._grid = grid
        self._mapping = design.mapping
        self._spectrum = Spectrum(
            design.samplerate, design.analysis.window, design.analysis.fft_length
        )
        self._analysis = LiveAnalysis(design.analysis)
        self._silence = design.input.silence
        self._ceiling = synthesis.ceiling
        self.levels = Levels(design)
        self._bandpass = BandPass(
            design.input.band_b, design.input.band_a, design.input.denormal_guard
        )
        self._tracker = PartialTracker(design)
        self._synthesizer = Synthesizer(synthesis, grid)
        self._ring_hops = synthesis.ring_hops
        self._find_onsets = bool(design.onsets.find_onsets)
        self._onset_frames = design.onsets.short_frames
        self._detector = OnsetDetector(
            design.onsets, bool(design.mapping.by_energy), self.follower is not None
        )
        self._onset_partials = OnsetPartials(
            design, self._detector, self._synthesizer.smoother, self._onset_amplitude
        )
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
        grid = self._grid
        self._pending = np.zeros(grid.tick_frames)
        self._pending_frames = 0
        self._ready = np.zeros(grid.tick_frames)
        self._past = np.zeros(max(grid.window_frames, self._onset_frames) - 1)
        self._past_peaks = np.zeros(grid.hops_in_window - 1)
        self._hop_peak = 0.0
        self._tick = 0
        self._ringing = 0
        self.told = ()
        self._bandpass.reset()
        self._detector.reset()
        self._tracker.reset()
        self._onset_partials.reset()
        self._synthesizer.reset()
        self.levels.reset()

    @property
    def follower(self) -> LoudnessFollower | None:
        """The follower of the loudness, None if none is followed."""
        return self.levels.follower

    @property
    def asleep(self) -> bool:
        """Whether nothing is played, and what was heard has no effect any more."""
        return self._tracker.idle and not self._ringing and self.levels.at_rest

    @property
    def frames_to_hop(self) -> int:
        """Frames that the hop under way still lacks."""
        done = self._tick * self._grid.tick_frames + self._pending_frames
        return self._grid.hop_frames - done

    def begin_hop(self) -> None:
        """Let the next frame be the first of a hop; while it is asleep only."""
        if self._pending_frames:
            # What came of the tick under way is silence, but the band-pass may still ring.
            filtered = self._bandpass.process(self._pending[: self._pending_frames])
            joined = np.concatenate((self._past, filtered))
            self._past = joined[joined.size - self._past.size :]
            self._hop_peak = max(self._hop_peak, float(np.abs(filtered).max()))
            self._heard_frames += self._pending_frames
            self._pending_frames = 0
            self._ready = np.zeros(self._grid.tick_frames)
        self._tick = 0
        self._detector.reset()

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the next (frames,) of vibration, `latency_frames` behind the sound."""
        filled = self._pending_frames + mono.size
        if filled < self._grid.tick_frames:
            self._pending[self._pending_frames : filled] = mono
            self._pending_frames = filled
        else:
            self._ready = np.concatenate((self._ready, *self._ticks_due(mono)))
        ready = self._ready
        self._ready = ready[mono.size :]
        return ready[: mono.size]

    def _ticks_due(self, mono: FloatArray) -> list[FloatArray]:
        """Return the vibration of the ticks that these frames complete, and keep what is over."""
        tick = self._grid.tick_frames
        pending = np.concatenate((self._pending[: self._pending_frames], mono))
        whole = pending.size - pending.size % tick
        self._pending_frames = pending.size - whole
        self._pending[: self._pending_frames] = pending[whole:]
        most = TICKS_AT_ONCE * tick
        return [
            self._advance(pending[first : min(whole, first + most)])
            for first in range(0, whole, most)
        ]

    def finish(self) -> FloatArray:
        """Return the `latency_frames` still owed, as if silence followed."""
        owed = self.process(np.zeros(self.latency_frames))
        self.reset()
        return owed

    def analyse(self, windows: FloatArray) -> Principals:
        """Return everything principal in band-passed windows (rows, N), not cut to n."""
        return self._analysis.all_principal(self._spectrum.transform(windows))

    def _advance(self, sound: FloatArray) -> FloatArray:
        """Return the vibration of whole ticks: (ticks x tick_frames,) in and out."""
        grid = self._grid
        ticks = sound.size // grid.tick_frames
        filtered = self._bandpass.process(sound)
        joined = np.concatenate((self._past, filtered))
        self._past = joined[joined.size - self._past.size :]
        peaks = np.abs(filtered).reshape(ticks, -1).max(axis=1)
        # Ticks with which a hop is full.
        full = np.arange(grid.ticks - 1 - self._tick, ticks, grid.ticks)
        heard = self._audible(peaks, full)
        seen = self._measure(joined, filtered, ticks) if self._find_onsets else Ticks.silent(ticks)
        if not heard.any() and not seen.bands.any() and self.asleep:
            if self._find_onsets:
                self._detector.rest(ticks)
            if full.size:
                self.levels.rest()
            self._tick = (self._tick + ticks) % grid.ticks
            self._heard_frames += sound.size
            return np.zeros(sound.size)
        found = self._analyse(joined, full[heard])
        glides = self._glide(found, seen, full, heard, ticks)
        if self._glides is not None:
            hops, fresh, _ = glides
            self._record(hops, (full + 1) * grid.tick_frames, grid.hop_frames, 0)
            ends = (np.arange(ticks) + 1) * grid.tick_frames
            self._record(fresh, ends, grid.tick_frames, self._tracker.slots)
        self._heard_frames += sound.size
        vibration, limited = self._synthesizer.play(*glides, self._tick)
        self._tick = (self._tick + ticks) % grid.ticks
        self.limited_frames += limited
        return vibration

    def take_glides(self, voice: int) -> list[tuple[float, ...]]:
        """Return rows of `GLIDE_COLUMNS` since the last call; the first call starts recording."""
        if self._glides is None:
            self._heard_frames = -self._pending_frames
        rows, self._glides = self._glides or [], []
        return [(frame, frames, voice, *rest) for frame, frames, *rest in rows]

    def _record(self, glides: Glides, starts: IntArray, frames: int, first_slot: int) -> None:
        """Add the slots that sound. starts: of each hop, in frames from this batch's first."""
        assert self._glides is not None
        sounding = (glides.start_amplitude != 0.0) | (glides.end_amplitude != 0.0)
        for hop, slot in zip(*(places.tolist() for places in sounding.nonzero()), strict=True):
            start = self._heard_frames + int(starts[hop])
            row = glides.row(hop, slot)
            self._glides.append((start, frames, first_slot + slot, *row))

    def _audible(self, peaks: FloatArray, full: IntArray) -> BoolArray:
        """Return of each full hop whether its window may hold anything principal."""
        heard = np.zeros(full.size, dtype=bool)
        first = 0
        for hop, last in enumerate(full.tolist()):
            loudest = max(self._hop_peak, float(peaks[first : last + 1].max()))
            self._past_peaks = np.concatenate((self._past_peaks, [loudest]))
            heard[hop] = self._past_peaks.max() >= self._silence
            self._past_peaks = self._past_peaks[1:]
            self._hop_peak = 0.0
            first = last + 1
        self._hop_peak = max(self._hop_peak, float(peaks[first:].max(initial=0.0)))
        return heard

    def _analyse(self, joined: FloatArray, full: IntArray) -> list[_Window]:
        """Return what is principal in the windows that end with these ticks."""
        if not full.size:
            return []
        grid = self._grid
        window, past = grid.window_frames, self._past.size
        windows = np.stack(
            [
                joined[past + (tick + 1) * grid.tick_frames - window :][:window]
                for tick in full.tolist()
            ]
        )
        spectra = self._spectrum.transform(windows)
        loudness = self.levels.loudness_db(spectra)
        found = self._analysis.strongest(spectra)
        edges = found.boundaries(full.size).tolist()
        hz = self._mapping.vibration_hz(found.audio_hz)
        gain = self._synthesizer.smoother.compensation(hz)
        return [
            _Window(found.take(mine), hz[mine], gain[mine], spectrum, loud)
            for mine, spectrum, loud in zip(
                map(slice, edges[:-1], edges[1:]), spectra, loudness, strict=True
            )
        ]

    def _measure(self, joined: FloatArray, filtered: FloatArray, ticks: int) -> Ticks:
        """Return what the detector sees in each tick."""
        grid = self._grid
        length = self._onset_frames
        first = self._past.size + grid.tick_frames - length
        windows = strided_windows(joined[first:], length, grid.tick_frames)
        return self._detector.measure(windows, filtered.reshape(ticks, -1))

    def _glide(
        self, found: list[_Window], seen: Ticks, full: IntArray, heard: BoolArray, ticks: int
    ) -> tuple[Glides, Glides, list[bool]]:
        """Return what the oscillators do in each hop and the fresh ones in each tick.

        And of each tick, whether anything still sounds.
        """
        hops = Glides.silent(full.size, self._tracker.slots)
        fresh = Glides.silent(ticks, self._onset_partials.slots)
        awake = []
        hop, row = 0, 0
        for tick in range(ticks):
            onset = self._find_onsets and self._detector.detect(seen, tick)
            if hop < full.size and tick == full[hop]:
                mine = None
                if heard[hop]:
                    mine = found[row]
                    row += 1
                self._end_hop(hops, hop, mine)
                hop += 1
            if onset:
                # Of the hop that plays now, in ticks.
                left = self._grid.ticks - 1 - (self._tick + tick) % self._grid.ticks
                self._onset_partials.start(self._tracker, left or self._grid.ticks)
            if not self._onset_partials.idle:
                self._ringing = self._ring_hops
                self._onset_partials.play(fresh, tick, self._tracker)
            awake.append(self._ringing > 0)
        return hops, fresh, awake

    def _end_hop(self, hops: Glides, hop: int, found: _Window | None) -> None:
        """Write the hop that follows what was found; None: of a window in which nothing can be."""
        self._onset_partials.hand_over(self._tracker)
        strength = 1.0
        if found:
            strength = self.levels.hear(found.spectrum, found.loudness_db)
        else:
            self.levels.hear_silence()
        count = found.hz.size if found and strength > 0.0 else 0
        left = 1.0
        self.told = ()
        if found and count:
            left = self._mapping.level_ratio(found.principal.amplitude, found.principal.r)
            amplitude, limited = self.levels.amplitudes(found.principal, found.hz, strength)
            if limited:
                self.limited_frames += self._grid.hop_frames
            audio_hz, hz, gain = found.principal.audio_hz, found.hz, found.gain
            columns = audio_hz.tolist(), hz.tolist(), amplitude.tolist()
            self.told = tuple(zip(*columns, strict=True))
        else:
            audio_hz, hz, gain, amplitude = np.zeros((4, 0))
        if count or self._tracker.holds:
            room = max(0.0, self._ceiling - float(amplitude.sum()))
            self._tracker.follow(
                hops,
                hop,
                audio_hz,
                hz,
                amplitude * gain,
                room,
                self._onset_partials.held_amplitude,
                left,
            )
            self._ringing = self._ring_hops
        elif not self._tracker.idle:
            self._tracker.fade(hops, hop)
        elif self._ringing:
            self._ringing -= 1

    def _onset_amplitude(self, hz: float, weight: float, level: float) -> float:
        """Return the amplitude of what begins now; see `Levels.onset_amplitude`."""
        return self.levels.onset_amplitude(hz, weight, level, self._detector.power)
