/* The loudness follower of one voice. The operations are those of `follower.py` and `loudness.py`;
 * only the bins' sum is in another order. */

#include "loudness.h"

#include "common.h"

/* Sums of the bins that go on side by side, for registers of any width. */
#define LANES 8

int loudness_is_on(const Settings *settings) { return settings->loudness_weights.length != 0; }

void loudness_reset(const Settings *settings, Loudness *follower)
{
    *follower->programme = settings->programme_start;
    *follower->gain = 1.0;
    loudness_rest(settings, follower);
}

void loudness_rest(const Settings *settings, Loudness *follower)
{
    *follower->floor = *follower->loud = settings->floor_min;
}

WIDE static double weigh(const double *restrict weights, const double *restrict real,
                           const double *restrict imaginary, size_t bins)
{
    double lanes[LANES] = {0.0};
    const size_t whole = bins - bins % LANES;
    for (size_t bin = 0; bin < whole; bin += LANES)
        for (size_t lane = 0; lane < LANES; lane++) {
            const double re = real[bin + lane], im = imaginary[bin + lane];
            lanes[lane] += weights[bin + lane] * (re * re + im * im);
        }
    double total = 0.0;
    for (size_t bin = whole; bin < bins; bin++)
        total += weights[bin] * (real[bin] * real[bin] + imaginary[bin] * imaginary[bin]);
    for (size_t lane = 0; lane < LANES; lane++)
        total += lanes[lane];
    return total;
}

double loudness_loudness_db(const Settings *settings, const double *real, const double *imaginary)
{
    const Table weights = settings->loudness_weights;
    const double energy = weigh(weights.at, real, imaginary, weights.length);
    return 10.0 * log10(larger(energy, settings->nothing));
}

static double within(double number, double low, double high)
{
    return larger(low, smaller(high, number));
}

/* How far the soft gate is open, 0 to 1. */
static double open_gate(const Settings *s, const Loudness *follower, double loudness_db)
{
    const double under = smaller(*follower->floor, *follower->programme - s->floor_under);
    const double over = smaller(1.0, (loudness_db - larger(s->floor_min, under)) / s->gate);
    return over >= s->gate_margin ? over * over * (3.0 - 2.0 * over) : 0.0;
}

/* The strength of what is so far over the programme, and so far turned down. */
static double felt(const Settings *s, double above, double turned_down)
{
    return pow(10.0, (s->target + s->slope * above + turned_down) / 20.0);
}

double loudness_strength(const Settings *s, Loudness *follower, double loudness_db)
{
    const double floor = smaller(*follower->floor + s->floor_rise, loudness_db);
    *follower->floor = larger(s->floor_min, floor);
    const double loud = larger(*follower->loud - s->release, loudness_db);
    *follower->loud = larger(s->floor_min, loud);
    const double programme = *follower->programme;
    const double gate = open_gate(s, follower, loudness_db);
    if (!(gate > 0.0))
        return 0.0;
    const double above = *follower->loud - programme;
    const double missing = within(above, -s->far, s->far);
    const double faster = missing * (missing > 0.0 ? s->programme_rise : s->programme_fall);
    const double towards = within(above, -1.0, 1.0);
    const double moved = programme + gate * (towards * s->programme_step + faster);
    *follower->programme = within(moved, s->programme_min, s->programme_top);
    return gate * felt(s, above, loudness_db - *follower->loud);
}

double loudness_onset_gain(const Settings *s, const Loudness *follower, double level)
{
    if (!(level > 0.0))
        return 0.0;
    const double loudness_db = 20.0 * log10(level);
    const double loud = larger(*follower->loud, loudness_db);
    const double strength = felt(s, loud - *follower->programme, loudness_db - loud);
    return smaller(s->gain_max, open_gate(s, follower, loudness_db) * strength / level);
}

double loudness_gain(const Settings *s, Loudness *follower, double strength,
                     const double *amplitude, size_t count)
{
    double power = 0.0;
    for (size_t one = 0; one < count; one++)
        power += amplitude[one] * amplitude[one];
    *follower->gain = smaller(s->gain_max, strength / sqrt(power));
    return *follower->gain;
}

int loudness_is_possible(const Settings *s, const Loudness *follower)
{
    return *follower->programme >= s->programme_min && *follower->programme <= s->programme_top &&
           *follower->floor >= s->floor_min && *follower->loud >= s->floor_min &&
           *follower->gain >= 0.0 && *follower->gain <= larger(1.0, s->gain_max);
}
