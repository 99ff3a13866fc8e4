/* The power in every band of ISO 532-1 at the end of each tick.
 *
 * From 560 Hz up the onset search has spectra already. Under it their bins are wider than the bands, so
 * those have filters of their own, at the low rate: of the analytic signal, whose magnitude does not
 * ripple as the wave goes up and down.
 */

#include "band_powers.h"

#include "common.h"
#include "filter_cascade.h"

size_t band_powers_low(const Settings *settings) { return settings->low_weights.length; }

size_t band_powers_high(const Settings *settings) { return settings->high_weights.length; }

size_t band_powers_count(const Settings *settings) { return settings->loudness_scale.length; }

void band_powers_reset(const Settings *s, const BandPowers *powers)
{
    memset(powers->low, 0, sizeof *powers->low);
    memset(powers->recent, 0, (s->average_ticks - 1) * band_powers_high(s) * sizeof(double));
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
            const double next = poles->feed[band] * x + (poles->real[band] * re - poles->imaginary[band] * im);
            y = poles->feed[band] * y + (poles->real[band] * im + poles->imaginary[band] * re);
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

SIMD_CLONES_NARROW static void hear_low(const Settings *s, LowBands *low, const double *samples,
                                        double *restrict squares)
{
    const CascadeDesign design = {s->low_smooth.at, s->low_smooth.length / SECTION_NUMBERS};
    const double *chain = s->quadrature.at;
    Poles poles = {{0.0}, {0.0}, {0.0}};
    for (size_t band = 0; band < band_powers_low(s); band++) {
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
    const size_t low = band_powers_low(s), high = band_powers_high(s), older = s->average_ticks - 1;
    double squares[LOW_MAX] = {0.0}, now[BANDS_MAX];
    memset(excitation, 0, band_powers_count(s) * sizeof(double));
    hear_low(s, powers->low, samples, squares);
    for (size_t band = 0; band < low; band++)
        excitation[(size_t)s->low_band_of.at[band]] += s->low_weights.at[band] * squares[band];
    double *above = excitation + (band_powers_count(s) - high);
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
