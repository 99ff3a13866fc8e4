"""Design of the listening parts: input stage, analysis of windows and search for onsets."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from audioflinger_hook.core.rounding import round_filter
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.synthesis import LiveGrid
from audioflinger_hook.transform.downmix import (
    CANCELS_FROM,
    CANCELS_UP_TO,
    POWER_GUARD,
    cancellation_shares,
    downmix_table,
)
from audioflinger_hook.transform.filters import fast_length, lowest_bins
from audioflinger_hook.transform.input_stage import DENORMAL_GUARD, MAGNITUDE_MAX, band_pass_roots
from audioflinger_hook.transform.mapping import VibrationMapping
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.principal import Spectrum, bins_in_band, peak_span_min

# Peaks below this many times 1/T (1.6 kHz) are cleared; from there the image is about -70 dB.
IMAGE_REACH_WINDOWS = 75.0
# Bins to either side of a peak that are cleared: its main lobe, and the half-power walk on it.
NEIGHBOURS = 7
# Entries of the window's table per bin; linear interpolation errs by 0.2 % of a side lobe.
TABLE_BINS_A_BIN = 32

SIDE_LOBE, SIDE_LOBE_FOLLOWED = 10 ** (-40 / 20), 10 ** (-34 / 20)
"""Side lobes of a Hamming window are 42.7 dB below their peak. The loudness follower lowers C_th:
side lobes of a low tone and of its image then add up to 36.7 dB under the tone."""

# Rise and fall times of the onset window: the newest sound counts at once.
OLD_SIDE_S, NEW_SIDE_S = 0.004, 0.001

EDGES_HZ = (200, 400, 600, 800, 1_200, 1_800, 2_600, 3_800, 5_600, 8_200, 12_000)
"""Edges of the onset bands. Under the first, a swing looks like a shift of the mean."""

FORGOTTEN_DB_A_S = 300.0
"""Rate at which a band's highest power is forgotten. A level that swells from nothing ten times a
second is no onset; a sound that begins after 30 ms of rest is."""

LOWEST_HZ = 70.0
"""What the onset window's lowest bin stands for: it holds half a period of 70 Hz at most."""

QUIETEST, WEAKEST = 0.02, 0.5
"""Shares of the weakest steady tone that is principal. Below the first no onset is searched;
below the second none is played."""

WORTH, MERGED_WORTH = 0.25, 0.1
"""Share of its amplitude that a partial must add to start. Where partials are merged it is in phase
with what sounds, so less is worth it."""


@dataclass(frozen=True, eq=False)
class InputDesign:
    """How samples are made usable and band-passed."""

    silence: float  # a window whose peak is below this has no principal frequency
    band_b: FloatArray  # band-pass: the numerator
    band_a: FloatArray  # band-pass: the denominator
    mix_slow: float  # this and the next two: see `cancellation_shares`
    mix_newest: float
    mix_evidence: float
    mix_weights: FloatArray = field(default_factory=downmix_table)
    mix_cancels_from: float = CANCELS_FROM
    mix_cancels_up_to: float = CANCELS_UP_TO
    mix_power_guard: float = POWER_GUARD
    magnitude_max: float = MAGNITUDE_MAX
    denormal_guard: float = DENORMAL_GUARD

    @classmethod
    def of(cls, parameters: TransformParameters, samplerate: int) -> InputDesign:
        """Return the design for one samplerate in Hz."""
        # By Parseval r <= max|x| fs sqrt(2.73/N) < max|x| fs: under this level nothing passes.
        silence = parameters.live_threshold_hz / samplerate
        band = round_filter(*band_pass_roots(parameters, samplerate))
        return cls(silence, *band, *cancellation_shares(samplerate))


@dataclass(frozen=True, eq=False)
class AnalysisDesign:
    """How principal frequencies are found in a window's spectrum."""

    fft_length: int
    bins: int  # number of bins that are analysed
    first_bin: int  # first bin on which a peak counts
    last_bin: int  # last bin on which a peak counts; below `first_bin` if there is none
    partials_max: int
    bin_hz: float
    threshold_hz: float  # C_th: r of a principal frequency is above it
    peak_span_min: float  # see `peak_span_min`
    weakest_image: float  # peaks up to this amplitude keep their image
    weakest_share: float  # so do peaks up to this share of the highest low amplitude
    image_first: float  # the window's first sample as a share of the sum of the others
    side_lobe: float  # peaks up to this share of the highest amplitude are left out
    window: FloatArray
    image_table: FloatArray  # both are described at `window_tables`
    image_turn: FloatArray

    @classmethod
    def of(cls, parameters: TransformParameters, spectrum: Spectrum, bins: int) -> AnalysisDesign:
        """Return the design for the first bins of spectra, with the parameters' own C_th."""
        first_bin, last_bin = bins_in_band(parameters, spectrum.bin_hz, bins)
        image_turn, image_table = window_tables(spectrum, bins)
        followed = parameters.loudness_db > 0.0
        full_scale_r = parameters.unit_strength_hz(spectrum.samplerate)
        return cls(
            fft_length=spectrum.fft_length,
            bins=bins,
            first_bin=first_bin,
            last_bin=last_bin,
            partials_max=parameters.partials_max,
            bin_hz=spectrum.bin_hz,
            threshold_hz=parameters.threshold_hz,
            peak_span_min=peak_span_min(parameters, spectrum.bin_hz),
            # A steady tone is principal from here up; a weaker peak is no tone that could wobble.
            weakest_image=parameters.threshold_hz / full_scale_r,
            # A weaker peak may be a side lobe, whose image is not its own.
            weakest_share=SIDE_LOBE_FOLLOWED if followed else 0.0,
            image_first=float(spectrum.window[0] / spectrum.window[1:].sum()),
            side_lobe=SIDE_LOBE_FOLLOWED if followed else SIDE_LOBE,
            window=spectrum.window,
            image_table=image_table,
            image_turn=image_turn,
        )


@dataclass(frozen=True, eq=False)
class OnsetDesign:
    """How onsets are found in short windows, and which partials they start."""

    find_onsets: int  # 0 if there is only the analysis, without onsets
    short_frames: int  # frames in the onset window
    short_length: int  # length of the window's spectrum
    short_bins: int  # bins that are looked at
    short_ticks: int  # ticks that the window touches
    newest_frames: int  # last frames of a tick that count by themselves
    short_scale: float  # factor from squared bins to mean squares
    quietest: float  # power below which there are no onsets
    weakest: float  # amplitude below which no partial starts
    fading: float  # factor on the highest recent power, applied each tick
    short_window: FloatArray
    short_hz: FloatArray  # vibration frequency of each bin
    min_gain_share: float  # no partial starts if less than this share of its amplitude is missing
    band_edges: FloatArray  # bins: the first of each band, and past the last
    # A band rises where its power is this many times its recent maximum (6 dB), and more than
    # this share of all power: side lobes of the window are less.
    rise: float = 4.0
    minor: float = 0.01
    risen_share: float = 0.5  # share of all power that rising bands must exceed at an onset
    back_ticks: int = 3  # a band rises over its power this many ticks ago
    rest_ticks: int = 5  # ticks from one onset to the next
    # Ticks to a next onset that is `rearmed` times as strong: the last one was only the very first
    # of a sound, or a faint one before it.
    rearmed_ticks: int = 3
    rearmed: float = 10.0
    heard_ticks: int = 4  # ticks over which an onset's sound is measured, each better than the last
    groups_max: int = 4  # groups of bands in which one onset starts partials
    onset_partials_max: int = 8  # onset partials at a time
    forgotten: float = 1e-30  # power that counts as zero
    apart_from: float = 1.0 + 1e-9  # bands of a smaller ratio are equal: rounding decides nothing
    start_phase: float = 0.75  # phase at birth in cycles: a sine, whose first swing is felt at once
    # Sum p^2 / (sum p)^2 over the bins' powers p of a tone, in each tick after an onset. In noise
    # it is a tenth of it: there is so much in a group of bands.
    one_tone: FloatArray = field(default_factory=lambda: np.array((0.12, 0.28, 0.34, 0.36)))
    # Share of its amplitude that an onset partial reaches in its first tick, and in its second.
    rise_shares: FloatArray = field(default_factory=lambda: np.array((0.4, 1.0)))

    @classmethod
    def of(
        cls,
        parameters: TransformParameters,
        grid: LiveGrid,
        mapping: VibrationMapping,
        samplerate: int,
        find_onsets: bool,
    ) -> OnsetDesign:
        """Return the design for one grid and samplerate in Hz."""
        old, new = (max(1, round(side * samplerate)) for side in (OLD_SIDE_S, NEW_SIDE_S))
        length = 2 * fast_length(max(2, -(-(old + new) // 2)))
        window = np.concatenate(
            (
                0.5 - 0.5 * np.cos(np.pi * (np.arange(old) + 0.5) / old),
                0.5 + 0.5 * np.cos(np.pi * (np.arange(new) + 0.5) / new),
            )
        )
        bin_hz = samplerate / length
        nyquist = length // 2
        edges = {min(max(1, round(edge / bin_hz)), nyquist) for edge in EDGES_HZ}
        edges.add(min(max(2, round(parameters.band_high_hz / bin_hz)), nyquist))
        bins = max(edges)
        hz = np.maximum(np.arange(bins) * bin_hz, LOWEST_HZ)
        weakest = parameters.live_threshold_hz / parameters.unit_strength_hz(samplerate)
        return cls(
            find_onsets=int(find_onsets),
            short_frames=old + new,
            short_length=length,
            short_bins=bins,
            short_ticks=-(-(old + new) // grid.tick_frames),
            newest_frames=max(1, grid.tick_frames // 2),
            # From bins to mean squares, by Parseval; a real spectrum has each bin twice.
            short_scale=2.0 / (length * float(window @ window)),
            quietest=0.5 * (QUIETEST * weakest) ** 2,
            weakest=WEAKEST * weakest,
            fading=10 ** (-FORGOTTEN_DB_A_S * grid.tick_frames / samplerate / 10),
            short_window=window,
            short_hz=mapping.vibration_hz(
                np.clip(hz, parameters.band_low_hz, parameters.band_high_hz)
            ),
            min_gain_share=MERGED_WORTH if parameters.merge_ratio else WORTH,
            band_edges=np.array(sorted(edges), dtype=np.float64),
        )

    @property
    def delay_ticks(self) -> float:
        """Ticks by which an amplitude follows on average: each glides from share to share."""
        shares: list[float] = self.rise_shares.tolist()
        return len(shares) - sum(shares) + 0.5 * shares[-1]


def window_tables(
    spectrum: Spectrum, bins: int, reach_windows: float = IMAGE_REACH_WINDOWS
) -> tuple[FloatArray, FloatArray]:
    """Return what images are computed from: the turn of each low bin, the window's spectrum.

    Phases counted from the window's centre make the spectrum real. turn: cosines, then sines,
    (2, low bins + `NEIGHBOURS`). spectrum: 1 at 0, `TABLE_BINS_A_BIN` entries a bin. reach_windows:
    bins under this many times 1/T are low.
    """
    frames, length = spectrum.window_frames, spectrum.fft_length
    # An image is looked up at the sum of two frequencies, which the table must reach, and
    # neighbours must lie within the spectra.
    room = min(spectrum.bins // 2, bins) - 1 - NEIGHBOURS
    low_bins = max(0, min(int(reach_windows * length / frames), room))
    turned_bins = np.arange(low_bins + NEIGHBOURS if low_bins else 0)
    turn = 2.0 * np.pi * turned_bins * (frames / 2) / length
    # Only the lowest part of the window's spectrum, on a grid that much finer than a bin.
    entries = TABLE_BINS_A_BIN * 2 * turn.shape[-1] + 2
    fine_length = TABLE_BINS_A_BIN * length
    partnered = spectrum.window.copy()
    partnered[0] = 0.0
    fine = lowest_bins(partnered, entries, fine_length)
    turned = fine * np.exp(2j * np.pi * np.arange(entries) * (frames / 2) / fine_length)
    return np.stack((np.cos(turn), np.sin(turn))), turned.real / turned[0].real
