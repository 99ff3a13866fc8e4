"""The live form: the same principal frequencies, overlapped, phase-continuous and early."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from audioflinger_hook.transform.analysis import LiveAnalysis
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.bandpass import BandPass
from audioflinger_hook.transform.follower import LoudnessFollower
from audioflinger_hook.transform.grid import LiveGrid
from audioflinger_hook.transform.levels import law_amplitudes
from audioflinger_hook.transform.limiter import below_full_scale, limited_amplitudes
from audioflinger_hook.transform.loudness import bin_weights, loudness_db
from audioflinger_hook.transform.oscillators import OscillatorBank
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.partials import Glides, PartialTracker
from audioflinger_hook.transform.principal import Principals
from audioflinger_hook.transform.scaling import slope, vibration_hz
from audioflinger_hook.transform.smoothing import Smoother
from audioflinger_hook.transform.spectrum import Spectrum
from audioflinger_hook.transform.windows import strided_windows

HOPS_AT_ONCE = 32
"""Hops analysed in one batch: bounds the memory of a block of any length."""

BAND_MARGIN_HZ = 1_000.0
"""Bins this far over the band's top are kept for the half-power walk of its last peaks."""

RING_OUT_CYCLES = 92.0
"""After the last partial the low-pass rings. After so many cycles of the top vibration frequency
(0.42 s at 220 Hz) it is under 1e-8 and is cut off."""

LATENCY_AT_HZ = 60.0
"""Vibration frequency whose delay is declared: 78 to 95 % of the energy lies at 20 to 80 Hz."""


class LiveTransform:
    """The live form of one channel, continued from block to block.

    Any split of the stream into blocks gives the same bytes: everything happens on a fixed grid
    of hops, a block only decides how many are due. `process` gives as many frames as it takes,
    late by `latency_frames`. Held by one thread at a time.
    """

    def __init__(self, parameters: TransformParameters, samplerate: int) -> None:
        self._parameters = parameters
        self._grid = LiveGrid.at(parameters, samplerate)
        self._spectrum = Spectrum(parameters, samplerate)
        bins = int((parameters.band_high_hz + BAND_MARGIN_HZ) / self._spectrum.bin_hz)
        bins = min(self._spectrum.bins, bins)
        threshold_hz = parameters.heard_threshold_hz
        heard = replace(parameters, threshold_hz=threshold_hz)
        self._analysis = LiveAnalysis(heard, self._spectrum, bins)
        self._full_scale_r = parameters.unit_strength_hz(samplerate)
        # By Parseval r <= max|x| fs sqrt(2.73/N) < max|x| fs: under this level nothing passes.
        self._silence = threshold_hz / samplerate
        self.follower: LoudnessFollower | None = None
        self._loudness_weights = np.zeros(0)
        if parameters.follower_db > 0.0:
            self.follower = LoudnessFollower(parameters, self._grid.hop_s)
            self._loudness_weights = bin_weights(self._spectrum, bins)
        self._bandpass = BandPass(parameters, samplerate)
        self._tracker = PartialTracker(
            parameters.partials_max, self._grid.hop_s, slope(parameters), parameters.window_s
        )
        self._bank = OscillatorBank(self._grid.steps, self._grid.hop_s)
        self._smoother = Smoother(self._grid, parameters.vibration_top_hz)
        self._ring_hops = int(
            np.ceil(RING_OUT_CYCLES / parameters.vibration_top_hz / self._grid.hop_s)
        )
        # An amplitude measured is that of the window's centre.
        self.latency_frames = round(
            self._grid.window_frames / 2
            + self._bank.delay_hops * self._grid.hop_frames
            + self._smoother.delay_s(LATENCY_AT_HZ) * samplerate
        )
        self.limited_frames = 0
        self.onset_after_frames = self._grid.window_frames
        self.reset()

    def reset(self) -> None:
        """Return to the state of a new stream."""
        grid = self._grid
        self._pending = np.zeros(grid.hop_frames)
        self._pending_frames = 0
        self._ready = np.zeros(grid.hop_frames)
        self._past = np.zeros(grid.window_frames - 1)
        self._past_peaks = np.zeros(grid.hops_in_window - 1)
        self._peak_before = 0.0
        self._ringing = 0
        self._bandpass.reset()
        self._tracker.reset()
        self._smoother.reset()
        if self.follower:
            self.follower.reset()

    @property
    def asleep(self) -> bool:
        """Whether nothing is played, and what was heard has no effect any more."""
        return self._tracker.idle and not self._ringing

    @property
    def frames_to_hop(self) -> int:
        """Frames that the hop under way still lacks."""
        return self._grid.hop_frames - self._pending_frames

    def begin_hop(self) -> None:
        """Let the next frame be the first of a hop; while it is asleep only."""
        if not self._pending_frames:
            return
        # What came of the hop under way is silence, but the band-pass may still ring.
        filtered = self._bandpass.process(self._pending[: self._pending_frames])
        joined = np.concatenate((self._past, filtered))
        self._past = joined[joined.size - self._past.size :]
        self._peak_before = float(np.abs(filtered).max())
        self._pending_frames = 0
        self._ready = np.zeros(self._grid.hop_frames)

    def process(self, mono: FloatArray) -> FloatArray:
        """Return the next (frames,) of vibration, `latency_frames` behind the sound."""
        filled = self._pending_frames + mono.size
        if filled < self._grid.hop_frames:
            self._pending[self._pending_frames : filled] = mono
            self._pending_frames = filled
        else:
            self._ready = np.concatenate((self._ready, *self._hops_due(mono)))
        ready = self._ready
        self._ready = ready[mono.size :]
        return ready[: mono.size]

    def _hops_due(self, mono: FloatArray) -> list[FloatArray]:
        """Return the vibration of the hops that these frames complete, and keep what is over."""
        hop = self._grid.hop_frames
        pending = np.concatenate((self._pending[: self._pending_frames], mono))
        whole = pending.size - pending.size % hop
        self._pending_frames = pending.size - whole
        self._pending[: self._pending_frames] = pending[whole:]
        most = HOPS_AT_ONCE * hop
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
        """Return the vibration of whole hops: (hops x hop_frames,) in and out."""
        grid = self._grid
        hops = sound.size // grid.hop_frames
        filtered = self._bandpass.process(sound)
        joined = np.concatenate((self._past, filtered))
        self._past = joined[joined.size - self._past.size :]
        windows = strided_windows(
            joined[grid.hop_frames - 1 :], grid.window_frames, grid.hop_frames
        )
        heard = (self._loudest(filtered, hops) >= self._silence).nonzero()[0]
        if not heard.size and self._tracker.idle and not self._ringing:
            if self.follower:
                self.follower.rest()
            return np.zeros(sound.size)
        glides, awake = self._glide(windows, heard, hops)
        return self._play(glides, awake)

    def _loudest(self, filtered: FloatArray, hops: int) -> FloatArray:
        """Return a bound on each window's magnitude: the peak of the hops that it touches."""
        peaks = np.abs(filtered).reshape(hops, -1).max(axis=1)
        peaks[0] = max(peaks[0], self._peak_before)
        self._peak_before = 0.0
        peaks = np.concatenate((self._past_peaks, peaks))
        self._past_peaks = peaks[hops:]
        bound: FloatArray = strided_windows(peaks, peaks.size - hops + 1, 1).max(axis=1)
        return bound

    def _glide(
        self, windows: FloatArray, heard: np.ndarray[tuple[int], np.dtype[np.intp]], hops: int
    ) -> tuple[Glides, list[bool]]:
        """Return what the oscillators do in each hop, and whether anything still sounds."""
        glides = Glides.silent(hops, self._tracker.slots)
        found = None
        if heard.size:
            whole = heard.size == hops
            spectra = self._spectrum.transform(windows if whole else windows[heard])
            loudness = loudness_db(spectra, self._loudness_weights) if self.follower else []
            found = self._analysis.strongest(spectra)
            edges = found.boundaries(heard.size).tolist()
            hz = vibration_hz(found.audio_hz, self._parameters)
            gain = self._smoother.compensation(hz)
        awake = []
        row = 0
        for hop in range(hops):
            mine, strength = slice(0, 0), 1.0
            if found is not None and row < heard.size and heard[row] == hop:
                mine = slice(edges[row], edges[row + 1])
                if self.follower:
                    strength = self.follower.strength(loudness[row])
                row += 1
            elif self.follower:
                self.follower.rest()
            if found is not None and mine.start < mine.stop and strength > 0.0:
                amplitude, limited = self._levelled(found.take(mine), strength)
                if limited:
                    self.limited_frames += self._grid.hop_frames
                self._tracker.follow(
                    glides, hop, found.audio_hz[mine], hz[mine], amplitude * gain[mine]
                )
                self._ringing = self._ring_hops
            elif not self._tracker.idle:
                self._tracker.fade(glides, hop)
            elif self._ringing:
                self._ringing -= 1
            awake.append(self._ringing > 0)
        return glides, awake

    def _levelled(self, found: Principals, strength: float) -> tuple[FloatArray, bool]:
        """Return the amplitudes of one hop's partials, and whether they were limited.

        strength: what the follower makes of their loudness.
        """
        amplitude = law_amplitudes(found.amplitude, found.r, self._full_scale_r, self._parameters)
        if self.follower:
            power = float((amplitude * amplitude).sum())
            amplitude = amplitude * self.follower.gain_for(strength, power)
        return limited_amplitudes(amplitude)

    def _play(self, glides: Glides, awake: list[bool]) -> FloatArray:
        """Return the hops' vibration; what sleeps is exactly 0 and forgets its ringing."""
        hop_frames = self._grid.hop_frames
        vibration = np.zeros(len(awake) * hop_frames)
        first = 0
        while first < len(awake):
            last = first + 1
            while last < len(awake) and awake[last] == awake[first]:
                last += 1
            if awake[first]:
                low_rate = self._bank.render(glides.hops(first, last))
                played, limited = below_full_scale(self._smoother.render(low_rate))
                vibration[first * hop_frames : last * hop_frames] = played
                self.limited_frames += limited
            else:
                self._smoother.reset()
            first = last
        return vibration
