"""Constants and tables of the input stage, the analysis of windows and the detection of onsets."""

from dataclasses import dataclass, field

import numpy as np

from audioflinger_hook.core.rounding import round_filter
from audioflinger_hook.transform import downmix
from audioflinger_hook.transform.arrays import FloatArray
from audioflinger_hook.transform.design.synthesis import LiveGrid
from audioflinger_hook.transform.filters import fast_length, lowest_bins
from audioflinger_hook.transform.input_stage import DENORMAL_GUARD, MAGNITUDE_MAX, band_pass_roots
from audioflinger_hook.transform.mapping import VibrationMapping
from audioflinger_hook.transform.parameters import TransformParameters
from audioflinger_hook.transform.principal import Spectrum, bins_in_band, peak_span_min

IMAGE_REACH_WINDOWS = 75.0
"""Images of tones are removed below this multiple of 1/T, by default 1.6 kHz. A tone's image is the
component at negative frequency. The image's side lobes disturb low bins. At the frequency of a
higher tone, these side lobes are under -70 dB relative to the tone."""

NEIGHBOURS = 7  # a peak's image is removed from this number of bins on each side
TABLE_BINS_A_BIN = 32  # entries per bin in the table of the window's spectrum

SIDE_LOBE, SIDE_LOBE_FOLLOWED = 10 ** (-40 / 20), 10 ** (-34 / 20)
"""Peaks up to these shares of the highest amplitude are ignored, without and with loudness control.
A Hamming window has side lobes of -42.7 dB. For a low tone, the side lobes of the tone and of its
image add up to -36.7 dB. With loudness control, C_th is lower, so side lobes could exceed it."""

OLD_SIDE_S, NEW_SIDE_S = 0.004, 0.001  # rise and fall time of the onset window

EDGES_HZ = (200, 400, 600, 800, 1_200, 1_800, 2_600, 3_800, 5_600, 8_200, 12_000)
"""Edges of the onset bands. The onset window is too short to measure oscillations below 200 Hz."""

FORGOTTEN_DB_A_S = 300.0
"""Decay rate of a band's recent maximum, dB/s. In 30 ms of silence, the recent maximum falls by 9
dB."""

LOWEST_HZ = 70.0  # frequency assigned to the onset window's lowest bin

QUIETEST, WEAKEST = 0.02, 0.5
"""Lowest amplitudes of detected and of played onsets, relative to the weakest principal tone."""

WORTH, MERGED_WORTH = 0.25, 0.1
"""Smallest excess of an onset's amplitude over existing partials, as a share of this amplitude. The
second value is for merged partials, which are in phase with existing partials."""


@dataclass(frozen=True, eq=False)
class InputDesign:
    """Constants and tables of the input stage."""

    silence: float  # a window whose samples all have smaller magnitudes has no principal frequency
    band_b: FloatArray  # numerator of the band-pass
    band_a: FloatArray  # denominator of the band-pass
    mix_slow: float  # for this and the next two fields, see `cancellation_shares`
    mix_newest: float
    mix_evidence: float
    mix_weights: FloatArray = field(default_factory=downmix.downmix_table)
    mix_cancels_from: float = downmix.CANCELS_FROM
    mix_cancels_up_to: float = downmix.CANCELS_UP_TO
    mix_power_guard: float = downmix.POWER_GUARD
    magnitude_max: float = MAGNITUDE_MAX
    denormal_guard: float = DENORMAL_GUARD

    @classmethod
    def of(cls, parameters: TransformParameters, samplerate: int) -> "InputDesign":
        """Return the design for one samplerate in Hz."""
        # By Parseval's theorem, r <= max|x| fs sqrt(2.73/N) < max|x| fs.
        silence = parameters.live_threshold_hz / samplerate
        band = round_filter(*band_pass_roots(parameters, samplerate))
        return cls(silence, *band, *downmix.cancellation_shares(samplerate))


@dataclass(frozen=True, eq=False)
class AnalysisDesign:
    """Constants and tables for the search for principal frequencies in a window's spectrum."""

    fft_length: int
    bins: int  # number of analysed bins
    first_bin: int  # first bin in the band
    last_bin: int  # last bin in the band; less than `first_bin` if no bin is in the band
    partials_max: int
    bin_hz: float
    threshold_hz: float  # C_th, the threshold of r
    peak_span_min: float  # see `peak_span_min`
    weakest_image: float  # images of peaks up to this amplitude are not removed
    weakest_share: float  # the same for peaks up to this share of the highest low bin
    image_first: float  # first sample of the window divided by the sum of all other samples
    side_lobe: float  # peaks up to this share of the highest amplitude are ignored
    window: FloatArray
    image_table: FloatArray  # window's spectrum, see `window_tables`
    image_turn: FloatArray  # phase rotations, see `window_tables`

    @classmethod
    def of(cls, parameters: TransformParameters, spectrum: Spectrum, bins: int) -> "AnalysisDesign":
        """Return the design for the first `bins` bins. `threshold_hz`: C_th of the live form."""
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
            # A weaker steady tone is not principal, so its image has no effect.
            weakest_image=parameters.threshold_hz / full_scale_r,
            # A weaker peak may be a side lobe, which has no image of its own.
            weakest_share=SIDE_LOBE_FOLLOWED if followed else 0.0,
            image_first=float(spectrum.window[0] / spectrum.window[1:].sum()),
            side_lobe=SIDE_LOBE_FOLLOWED if followed else SIDE_LOBE,
            window=spectrum.window,
            image_table=image_table,
            image_turn=image_turn,
        )


@dataclass(frozen=True, eq=False)
class OnsetDesign:
    """Constants and tables of onset detection, and of the partials that an onset starts."""

    find_onsets: int  # 0 disables onsets
    short_frames: int  # frames in the onset window
    short_length: int  # FFT length
    short_bins: int  # number of analysed bins
    short_ticks: int  # number of ticks that the window overlaps
    newest_frames: int  # number of last frames of a tick whose level is measured separately
    short_scale: float  # factor from squared bins to mean squares
    quietest: float  # lowest power of an onset
    weakest: float  # lowest amplitude of an onset partial
    fading: float  # decay of a band's recent maximum of power, factor per tick
    short_window: FloatArray
    short_hz: FloatArray  # vibration frequency of each bin
    min_gain_share: float  # see `WORTH`
    band_edges: FloatArray  # first bin of each band, then the end of the last band
    rise: float = 4.0  # a band rises above this multiple of its recent maximum of power (6 dB)
    minor: float = 0.01  # a rising band must exceed this share of the total power
    risen_share: float = 0.5  # at an onset, rising bands contain more than this share of the power
    back_ticks: int = 3  # number of latest ticks that the recent maximum excludes
    # The interval between onsets is at least rest_ticks. A shorter interval requires that the power
    # is `rearmed` times that of 2 ticks before (of 1 tick before, for less than rearmed_ticks).
    rest_ticks: int = 5
    rearmed_ticks: int = 3
    rearmed: float = 10.0
    heard_ticks: int = 4  # an onset's sound is measured for this number of ticks
    groups_max: int = 4  # largest number of groups of bands in which one onset starts partials
    onset_partials_max: int = 8  # largest number of simultaneous onset partials
    forgotten: float = 1e-30  # smaller powers are set to 0
    apart_from: float = 1.0 + 1e-9  # powers with a smaller ratio count as equal
    start_phase: float = 0.75  # initial phase in cycles: a cosine then starts as a sine
    # Values of sum p^2 / (sum p)^2 for a pure tone with the bin powers p, one for each tick after
    # an onset. Noise has lower values.
    one_tone: FloatArray = field(default_factory=lambda: np.array((0.12, 0.28, 0.34, 0.36)))
    # Shares of the final amplitude of an onset partial at the ends of its first ticks.
    rise_shares: FloatArray = field(default_factory=lambda: np.array((0.4, 1.0)))

    @classmethod
    def of(
        cls,
        parameters: TransformParameters,
        grid: LiveGrid,
        mapping: VibrationMapping,
        samplerate: int,
        find_onsets: bool,
    ) -> "OnsetDesign":
        """Return the design for a time grid and a samplerate in Hz."""
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
            # By Parseval's theorem. The factor 2 stands for the bins at negative frequencies.
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
        """Mean delay, in ticks, due to the gradual rise of an onset partial's amplitude."""
        shares: list[float] = self.rise_shares.tolist()
        return len(shares) - sum(shares) + 0.5 * shares[-1]


def window_tables(
    spectrum: Spectrum, bins: int, reach_windows: float = IMAGE_REACH_WINDOWS
) -> tuple[FloatArray, FloatArray]:
    """Return tables for the removal of images: phase rotations, and the window's spectrum.

    An image is a tone's component at negative frequency. The rotations are cosines and sines, (2,
    low bins + `NEIGHBOURS`). They move the time origin to the window's centre, so that the window's
    spectrum is real. The spectrum is 1 at 0 Hz and has `TABLE_BINS_A_BIN` entries per bin.
    reach_windows: images are removed in the low bins, below this multiple of 1/T.
    """
    frames, length = spectrum.window_frames, spectrum.fft_length
    # The window's table must reach the sum of the frequencies of any two low bins.
    room = min(spectrum.bins // 2, bins) - 1 - NEIGHBOURS
    low_bins = max(0, min(int(reach_windows * length / frames), room))
    turned_bins = np.arange(low_bins + NEIGHBOURS if low_bins else 0)
    turn = 2.0 * np.pi * turned_bins * (frames / 2) / length
    entries = TABLE_BINS_A_BIN * 2 * turn.shape[-1] + 2
    fine_length = TABLE_BINS_A_BIN * length
    partnered = spectrum.window.copy()
    partnered[0] = 0.0
    fine = lowest_bins(partnered, entries, fine_length)
    turned = fine * np.exp(2j * np.pi * np.arange(entries) * (frames / 2) / fine_length)
    return np.stack((np.cos(turn), np.sin(turn))), turned.real / turned[0].real
