/* The power in every band of ISO 532-1 at the end of each tick.
 *
 * From 560 Hz up the onset search has spectra already. Under it their bins are wider than the bands, so
 * those have filters of their own, at the low rate: of the analytic signal, whose magnitude does not
 * ripple as the wave goes up and down.
 */

#include "loudness.h"

#include "exact.h"
#include "filter.h"

void band_powers_reset(const Settings *s, const BandPowers *powers)
{
    memset(powers->low, 0, sizeof *powers->low);
    memset(powers->recent, 0, (s->average_ticks - 1) * s->high_weights.length * sizeof(double));
}

/* ------------------------------------------------------------------------------------- low bands */

/* One sample through a chain of all-passes (a^2 - z^-2) / (1 - a^2 z^-2). */
INLINED double through(const double *squares, double state[CHAIN][2], double x)
{
    for (size_t one = 0; one < CHAIN; one++) {
        const double y = squares[one] * x + state[one][0];
        state[one][0] = state[one][1];
        state[one][1] = squares[one] * y - x;
        x = y;
    }
    return x;
}

/* The poles of all bands side by side. */
typedef struct {
    double real[LOW_MAX], imaginary[LOW_MAX], feed[LOW_MAX];
} Poles;

/* Take one sample of the analytic signal through both poles of each band, and add up its squares. */
INLINED void resonate(const Poles *poles, LowBands *low, double real, double imaginary,
                      double *restrict squares)
{
    for (size_t band = 0; band < LOW_MAX; band++) {
        double x = real, y = imaginary;
        for (size_t pole = 0; pole < 2; pole++) {
            const double re = low->real[pole][band], im = low->imaginary[pole][band];
            const double a = poles->real[band], b = poles->imaginary[band], feed = poles->feed[band];
            const double next = feed * x + (a * re - b * im);
            y = feed * y + (a * im + b * re);
            x = next;
            low->real[pole][band] = x;
            low->imaginary[pole][band] = y;
        }
        squares[band] += x * x + y * y;
    }
}

/* Set to 0 what has decayed, before its numbers become denormal and slow. */
static void drop_decayed(LowBands *low)
{
    const double *numbers = (const double *)low;
    double most = 0.0;
    for (size_t one = 0; one < LOW_STATES; one++)
        most = larger(fabs(numbers[one]), most);
    if (most < DECAYED)
        memset(low, 0, sizeof *low);
}

SIMD_CLONES_NARROW static void update_low(const Settings *s, LowBands *low, const double *samples,
                                          double *restrict squares)
{
    const CascadeDesign design = {s->low_smooth.at, s->low_smooth.length / SECTION_NUMBERS};
    const double *chain = s->quadrature.at;
    Poles poles = {{0.0}, {0.0}, {0.0}};
    for (size_t band = 0; band < s->low_weights.length; band++) {
        const double *row = s->low_poles.at + LOW_NUMBERS * band;
        poles.real[band] = row[0];
        poles.imaginary[band] = row[1];
        poles.feed[band] = row[2];
    }
    for (size_t step = 0; step < s->tick_steps; step++) {
        double x = 0.0;
        for (size_t frame = 0; frame < s->decimation; frame++)
            x = cascade_step((Cascade *)(void *)low->smooth, design, *samples++);
        const double imaginary = through(chain, low->chains[0], x);
        const double real = through(chain + CHAIN, low->chains[1], low->before);
        low->before = x;
        resonate(&poles, low, real, imaginary, squares);
    }
    drop_decayed(low);
}

/* -------------------------------------------------------------------------------------- all bands */

void band_powers_update(const Settings *s, const BandPowers *powers, const double *samples,
                      const double *short_power, double *excitation)
{
    const size_t low = s->low_weights.length, high = s->high_weights.length, older = s->average_ticks - 1;
    double squares[LOW_MAX] = {0.0}, now[BANDS_MAX];
    memset(excitation, 0, s->loudness_scale.length * sizeof(double));
    update_low(s, powers->low, samples, squares);
    for (size_t band = 0; band < low; band++)
        excitation[(size_t)s->low_band_of.at[band]] += s->low_weights.at[band] * squares[band];
    double *above = excitation + (s->loudness_scale.length - high);
    for (size_t band = 0; band < high; band++) {
        double power = 0.0;
        for (size_t bin = (size_t)s->high_edges.at[band]; bin < (size_t)s->high_edges.at[band + 1]; bin++)
            power += short_power[bin];
        now[band] = s->high_weights.at[band] * power;
        double total = now[band];
        for (size_t tick = 0; tick < older; tick++)
            total += powers->recent[tick * high + band];
        above[band] = total / (double)s->average_ticks;
    }
    if (older) {
        memmove(powers->recent, powers->recent + high, (older - 1) * high * sizeof(double));
        memcpy(powers->recent + (older - 1) * high, now, high * sizeof(double));
    }
}

/* Threshold factor of ISO 532-1. */
#define THRESHOLD 0.25

/* Loudness in phon of a full-scale tone of 1 kHz. */
#define FULL_SCALE_PHON 94.0

static double fourth_root(double number) { return sqrt(sqrt(number)); }

Loudness loudness_of(const Settings *s, const double *excitation)
{
    Loudness now = {0.0, 0.0, {0.0}};
    double above = 0.0;
    size_t group = 0;
    for (size_t band = 0; band < s->loudness_scale.length; band++) {
        const double root = fourth_root(1.0 - THRESHOLD + THRESHOLD * excitation[band]);
        const double core = larger(0.0, s->loudness_scale.at[band] * (root - 1.0));
        const double width = s->loudness_widths.at[band];
        double tail = 0.0, left = 0.0;
        if (above > core) {
            const double slope = s->slope_a_bark / fourth_root(above);
            left = above * exact_exp(-slope * width);
            tail = (above - left) / slope;
        }
        now.sone += larger(core * width, tail);
        above = larger(core, left);
        if ((double)band >= s->loudness_groups.at[group + 1])
            group++;
        now.groups[group] += core * width;
    }
    const double phon = now.sone >= 1.0 ? 40.0 + 10.0 * exact_log2(now.sone)
                                          : 40.0 * exact_pow(now.sone + 5e-4, 0.35);
    now.db = phon - FULL_SCALE_PHON;
    return now;
}
