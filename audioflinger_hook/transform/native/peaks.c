/* The peaks of a spectrum: its amplitudes, cleared of images, and where they rise and fall. */

#include "analysis.h"

#include "exact.h"

#define HALF_POWER 0.70710678118654752440 /* 1/sqrt(2) */

/* Bins to either side of a peak that are cleared of its image: main lobe, and half-power walk on it. */
#define NEIGHBOURS 7

/* Peaks under this bin are cleared twice, as images move the places where they are looked up. */
#define TWICE_BELOW 20

/* Entries of the window's table a bin; lines between them are within 0.2 % of a side lobe. */
#define TABLE_BINS_A_BIN 32

/* Two amplitudes are told apart from this ratio on, so that rounding decides nothing between
 * equals: the spectrum of a single sample is flat. */
#define APART_FROM (1.0 + 1e-9)

/* The same for a top: the three fifth roots around it are curved at least by this share of it. */
#define CURVED 1e-6

/* ----------------------------------------------------------------------------------- amplitudes */

/* |X|, without the overflow guard of hypot: no sound comes near. */
SIMD_CLONES void peaks_amplitudes(Spectrum spectrum, double *restrict amplitude, int32_t bins)
{
    const double *restrict real = spectrum.real, *restrict imaginary = spectrum.imaginary;
    for (int32_t bin = 0; bin < bins; bin++)
        amplitude[bin] = sqrt(real[bin] * real[bin] + imaginary[bin] * imaginary[bin]);
}

/* Bins from a peak's own to its refined top, of the fifth roots of the amplitudes around. */
INLINED double top_offset(double l, double m, double r)
{
    const double curvature = smaller(l - 2.0 * m + r, -CURVED * m);
    const double ratio = (l - r) / (2.0 * curvature);
    /* True half a bin at most; infinite amplitudes give no number. */
    return fabs(ratio) <= 1.0 ? ratio : 0.0;
}

/* Refine the tops of all peaks: the parabola in A^0.2, in which a Hamming main lobe is nearest to
 * one, through each peak and the bins beside it. */
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

/* --------------------------------------------------------------------------------------- images */

/* The window's spectrum this many bins from its middle, on a line between the table's entries. */
INLINED double window_at(Table window, double distance_bins)
{
    const double position = distance_bins * TABLE_BINS_A_BIN;
    if (!(position < (double)(window.length - 1)))
        return window.at[window.length - 1];
    const int32_t below = (int32_t)position;
    const double here = window.at[below];
    return here + (position - (double)below) * (window.at[below + 1] - here);
}

/* List the peaks whose images are worth clearing. */
static void strong_low_peaks(const Settings *s, const double *amplitude, Peaks *peaks)
{
    const int32_t low_bins = (int32_t)(s->image_turn.length / 2) - NEIGHBOURS;
    int32_t count = 0;
    double highest = 0.0;
    for (int32_t bin = 1; bin < low_bins; bin++)
        highest = larger(amplitude[bin], highest);
    const double weakest = larger(s->weakest_image, s->weakest_share * highest);
    for (int32_t bin = 1; bin < low_bins; bin++) {
        const double here = amplitude[bin];
        peaks->bin[count] = bin;
        count += (here > weakest) & (here > APART_FROM * amplitude[bin - 1]) &
                 !(amplitude[bin + 1] > APART_FROM * here);
    }
    peaks->count = count;
}

/* Write the amplitudes of bins from `first` up to `end` without the image of the tone whose peak this
 * is.
 *
 * With phases counted from the window's centre its spectrum is real, but for its first sample, which
 * has no partner. There the image is the tone's conjugate, on the window's spectrum around minus the
 * tone's frequency. Of the first sample it adds the same number to all bins.
 */
static void without_image(const Settings *s, Spectrum spectrum, int32_t peak, double offset,
                          int32_t first, int32_t end, double *cleared)
{
    const double *cosines = s->image_turn.at, *sines = cosines + s->image_turn.length / 2;
    const double height = window_at(s->image_table, fabs(offset));
    const double re = spectrum.real[peak], im = spectrum.imaginary[peak];
    const double cosine = cosines[peak], sine = sines[peak];
    const double tone_real = (re * cosine - im * sine) / height;
    const double tone_imaginary = (re * sine + im * cosine) / height;
    /* A bin is a quarter of a turn there, or a little less. */
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

/* Refine the tops of the lowest peaks once more, without the images that the first places tell of. */
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

/* Clear the low amplitudes of what the images of strong peaks add.
 *
 * Where the neighbourhoods of two peaks overlap, in the valley between, the upper one's stands. All
 * peaks are those of the amplitudes as they were.
 */
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

/* ---------------------------------------------------------------------------------------- peaks */

/* Note for each bin but the last whether the amplitude rises from it to the next. */
SIMD_CLONES static void mark_rising(const double *restrict amplitude, uint8_t *restrict rising, int32_t bins)
{
    for (int32_t bin = 0; bin < bins; bin++)
        rising[bin] = amplitude[bin + 1] > APART_FROM * amplitude[bin];
}

/* List the peaks of the band that can be principal.
 *
 * A peak is higher than the bin to its left and not lower than that to its right; the walk down
 * from it goes on while the amplitude does not rise. A spectrum that ends rising has no peak there.
 * No bandwidth exceeds the span between the valleys, and refinement raises a peak by a bounded
 * factor: what stays under the threshold at that bound is left out before anything costly.
 */
void peaks_list(const Settings *s, const double *amplitude, Turns turns, Peaks *peaks)
{
    const int32_t top_bin = (int32_t)s->bins - 1, first = (int32_t)s->first_bin, last = (int32_t)s->last_bin;
    int32_t count = 0;
    uint8_t was = 0;
    mark_rising(amplitude, turns.rising, top_bin);
    for (int32_t bin = 0; bin < top_bin; bin++) {
        turns.bin[count] = bin;
        count += turns.rising[bin] ^ was;
        was = turns.rising[bin];
    }
    /* A valley, a peak, a valley ... */
    turns.bin[count] = top_bin;
    int32_t able = 0;
    for (int32_t turn = 0; turn + 1 < count; turn += 2) {
        const int32_t left = turns.bin[turn], bin = turns.bin[turn + 1];
        const int32_t right = turns.bin[turn + 2];
        peaks->left[able] = left;
        peaks->bin[able] = bin;
        peaks->right[able] = right;
        able += (bin >= first) & (bin <= last) &
                (amplitude[bin] * (double)(right - left) > s->peak_span_min);
    }
    peaks->count = able;
}
