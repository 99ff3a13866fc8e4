/* Spectral peaks: amplitudes, removal of mirror images, interpolation and search. */

#include "analysis.h"
#include "exact.h"

#define HALF_POWER 0.70710678118654752440 /* 1/sqrt(2) */

#define NEIGHBOURS 7   /* bins on each side of a peak from which its mirror image is subtracted */
#define TWICE_BELOW 20 /* mirror images shift peaks below this bin; these peaks are interpolated twice */
#define TABLE_BINS_A_BIN 32 /* entries of image_table per bin of the spectrum */

/* Amplitudes with a smaller ratio count as equal, since rounding errors may make them differ. */
#define APART_FROM (1.0 + 1e-9)

/* Minimum of |curvature| of A^0.2, as a share of the peak's A^0.2. Lower values may be rounding errors. */
#define CURVED 1e-6

/* Write the magnitude of each bin, without the overflow protection of hypot, which audio does not need. */
SIMD_CLONES void peaks_amplitudes(Spectrum spectrum, double *restrict amplitude, int32_t bins)
{
    const double *restrict real = spectrum.real, *restrict imaginary = spectrum.imaginary;
    for (int32_t bin = 0; bin < bins; bin++)
        amplitude[bin] = sqrt(real[bin] * real[bin] + imaginary[bin] * imaginary[bin]);
}

/* Return a peak's offset from its bin, in bins. l, m, r: fifth roots of the three amplitudes around the
 * bin. */
INLINED double top_offset(double l, double m, double r)
{
    const double curvature = smaller(l - 2.0 * m + r, -CURVED * m);
    const double ratio = (l - r) / (2.0 * curvature);
    /* At a peak, |ratio| is at most about 1/2. Infinite amplitudes give NaN: return 0. */
    return fabs(ratio) <= 1.0 ? ratio : 0.0;
}

/* Fit a parabola to A^0.2 around each peak (A: amplitude). Hamming main lobes are then nearly parabolic. */
SIMD_CLONES void peaks_refine(const double *amplitude, Peaks *peaks)
{
    const int32_t count = peaks->count;
    double *restrict before = peaks->before, *restrict top = peaks->top;
    double *restrict after = peaks->after;
    double *restrict offsets = peaks->offset, *restrict heights = peaks->height;
    double *restrict levels = peaks->level;
    for (int32_t one = 0; one < count; one++) {
        const double *here = amplitude + peaks->bin[one];
        before[one] = larger(here[-1], FLOOR * here[0]);
        top[one] = here[0];
        after[one] = larger(here[1], FLOOR * here[0]);
    }
    NO_ALIAS
    for (int32_t one = 0; one < count; one++) {
        const double l = fifth_root(before[one]), m = fifth_root(top[one]);
        const double r = fifth_root(after[one]);
        const double offset = top_offset(l, m, r);
        const double root = m - (l - r) * offset / 4.0;
        const double square = root * root, height = square * square * root;
        offsets[one] = offset;
        heights[one] = height;
        levels[one] = HALF_POWER * height;
    }
}

/* Interpolate the table of the window's spectrum linearly. Beyond the table, its last entry applies. */
INLINED double window_at(Table window, double distance_bins)
{
    const double position = distance_bins * TABLE_BINS_A_BIN;
    if (!(position < (double)(window.length - 1)))
        return window.at[window.length - 1];
    const int32_t below = (int32_t)position;
    const double here = window.at[below];
    return here + (position - (double)below) * (window.at[below + 1] - here);
}

/* In the lowest bins, list the peaks with amplitudes above weakest_image, and above weakest_share times the
 * highest amplitude in these bins. */
static void strong_low_peaks(const Settings *s, const double *amplitude, Peaks *peaks)
{
    const int32_t low_bins = (int32_t)(s->image_turn.length / 2) - NEIGHBOURS;
    int32_t count = 0;
    const double highest = low_bins > 1 ? maximum(amplitude + 1, (size_t)(low_bins - 1)) : 0.0;
    const double weakest = larger(s->weakest_image, s->weakest_share * highest);
    for (int32_t bin = 1; bin < low_bins; bin++) {
        const double here = amplitude[bin];
        peaks->bin[count] = bin;
        count += (here > weakest) & (here > APART_FROM * amplitude[bin - 1]) &
                 !(amplitude[bin + 1] > APART_FROM * here);
    }
    peaks->count = count;
}

/* Write the amplitudes of bins from `first` to `end` - 1 without the mirror image of the tone at `peak`.
 *
 * With phases relative to the window's centre, the window without its first sample has a real spectrum. The
 * first sample adds the same number to all bins of `spectrum`; this number is subtracted first. The mirror
 * image is the tone's conjugate amplitude times the window's spectrum around the negative frequency. */
static void without_image(const Settings *s, Spectrum spectrum, int32_t peak, double offset,
                          int32_t first, int32_t end, double *cleared)
{
    const double *cosines = s->image_turn.at, *sines = cosines + s->image_turn.length / 2;
    const double height = window_at(s->image_table, fabs(offset));
    const double re = spectrum.real[peak], im = spectrum.imaginary[peak];
    const double cosine = cosines[peak], sine = sines[peak];
    const double tone_real = (re * cosine - im * sine) / height;
    const double tone_imaginary = (re * sine + im * cosine) / height;
    /* Per bin, the first sample's phase relative to the window's centre changes by about pi/2. */
    const double angle = (0.5 * PI) * offset, square = angle * angle;
    const double across = 1.0 - square * (0.5 - square / 24.0), along = angle * (1.0 - square / 6.0);
    const double share = s->image_first / height;
    const double first_real = share * (re * across + im * along);
    const double first_imaginary = share * (re * along - im * across);
    for (int32_t bin = first; bin < end; bin++) {
        const double image = window_at(s->image_table, (double)(bin + peak) + offset);
        const double x = spectrum.real[bin] - first_real;
        const double y = spectrum.imaginary[bin] - first_imaginary;
        const double turn_re = cosines[bin], turn_im = sines[bin];
        const double real = x * turn_re - y * turn_im - tone_real * image;
        const double imaginary = x * turn_im + y * turn_re + tone_imaginary * image;
        cleared[bin - first] = sqrt(real * real + imaginary * imaginary);
    }
}

/* From each peak below TWICE_BELOW, subtract the first estimate of its mirror image, and interpolate the peak
 * again. */
static void refine_without_images(const Settings *s, Spectrum spectrum, Peaks *peaks)
{
    for (int32_t one = 0; one < peaks->count && peaks->bin[one] < TWICE_BELOW; one++) {
        const int32_t peak = peaks->bin[one];
        double around[3];
        without_image(s, spectrum, peak, peaks->offset[one], peak - 1, peak + 2, around);
        if (!(around[1] > around[0]) || !(around[1] >= around[2]))
            continue;
        const double least = FLOOR * around[1];
        peaks->offset[one] = top_offset(fifth_root(larger(around[0], least)), fifth_root(around[1]),
                                        fifth_root(larger(around[2], least)));
    }
}

/* In a bin within NEIGHBOURS bins of two peaks, only the mirror image of the upper peak is subtracted. */
void peaks_clear_images(const Settings *s, Spectrum spectrum, double *amplitude, Peaks *peaks)
{
    strong_low_peaks(s, amplitude, peaks);
    peaks_refine(amplitude, peaks);
    refine_without_images(s, spectrum, peaks);
    for (int32_t one = 0; one < peaks->count; one++) {
        const int32_t peak = peaks->bin[one];
        const int32_t first = peak > NEIGHBOURS ? peak - NEIGHBOURS : 0;
        int32_t end = peak + NEIGHBOURS + 1;
        if (one + 1 < peaks->count && end > peaks->bin[one + 1] - NEIGHBOURS)
            end = peaks->bin[one + 1] - NEIGHBOURS;
        without_image(s, spectrum, peak, peaks->offset[one], first, end, amplitude + first);
    }
}

/* A peak exceeds its left neighbour, and its right neighbour does not exceed it; the last bin is never a
 * peak. The bandwidth is at most the distance between the minima beside a peak. A peak is omitted if even
 * this bandwidth gives an r below the threshold. */
void peaks_list(const Settings *s, const double *amplitude, int32_t *turns, Peaks *peaks)
{
    const int32_t top_bin = (int32_t)s->bins - 1, first = (int32_t)s->first_bin, last = (int32_t)s->last_bin;
    int32_t count = 0;
    int was = 0;
    for (int32_t bin = 0; bin < top_bin; bin++) {
        const int rising = amplitude[bin + 1] > APART_FROM * amplitude[bin];
        turns[count] = bin;
        count += rising ^ was;
        was = rising;
    }
    turns[count] = top_bin;
    int32_t able = 0;
    for (int32_t turn = 0; turn + 1 < count; turn += 2) {
        const int32_t left = turns[turn], bin = turns[turn + 1], right = turns[turn + 2];
        peaks->left[able] = left;
        peaks->bin[able] = bin;
        peaks->right[able] = right;
        able += (bin >= first) & (bin <= last) &
                (amplitude[bin] * (double)(right - left) > s->peak_span_min);
    }
    peaks->count = able;
}
