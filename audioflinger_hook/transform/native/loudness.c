/* The loudness follower of one voice; tests/oracle/loudness.py has it to read. */

#include "loudness.h"

#include "common.h"
#include "exact.h"
#include "scaling.h"

/* Sums of the bins that go on side by side, for registers of any width. */
#define LANES 8

int loudness_is_on(const Settings *settings) { return settings->loudness_weights.length != 0; }

void loudness_reset(const Settings *settings, Loudness *follower)
{
    *follower->programme = settings->programme_start;
    *follower->gain = 1.0;
    *follower->far_hops = 0.0;
    loudness_rest(settings, follower);
}

void loudness_rest(const Settings *settings, Loudness *follower)
{
    *follower->floor = *follower->loud = *follower->steady = settings->floor_min;
}

/* What measures loudness after ISO 532-1 in spectra of one kind. */
typedef struct {
    Table weights, edges, scale, widths;
    double slope_a_bark;
} Meter;

/* Threshold factor of ISO 532-1. */
#define THRESHOLD 0.25

/* Loudness in phon of a full-scale tone of 1 kHz. */
#define FULL_SCALE_PHON 94.0

/* Sum of the bins' weighted squares. imaginary: NULL where `real` holds squares. */
SIMD_CLONES static double weigh(const double *restrict weights, const double *restrict real,
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

static double weigh_squares(const double *weights, const double *squares, size_t bins)
{
    double total = 0.0;
    for (size_t bin = 0; bin < bins; bin++)
        total += weights[bin] * squares[bin];
    return total;
}

static double fourth_root(double number) { return sqrt(sqrt(number)); }

/* The loudness in dB of bins, times a factor; 0 dB for a full-scale tone of 1 kHz. imaginary: NULL
 * where `real` holds squares. */
static double measure(Meter meter, const double *real, const double *imaginary, double factor)
{
    double sone = 0.0, above = 0.0;
    for (size_t band = 0; band + 1 < meter.edges.length; band++) {
        const size_t first = (size_t)meter.edges.at[band];
        const size_t bins = (size_t)meter.edges.at[band + 1] - first;
        const double *weights = meter.weights.at + first;
        const double excitation =
            factor * (imaginary ? weigh(weights, real + first, imaginary + first, bins)
                                : weigh_squares(weights, real + first, bins));
        const double root = fourth_root(1.0 - THRESHOLD + THRESHOLD * excitation);
        const double core = larger(0.0, meter.scale.at[band] * (root - 1.0));
        const double width = meter.widths.at[band];
        double tail = 0.0, left = 0.0;
        if (above > core) {
            const double slope = meter.slope_a_bark / fourth_root(above);
            left = above * exact_exp(-slope * width);
            tail = (above - left) / slope;
        }
        sone += larger(core * width, tail);
        above = larger(core, left);
    }
    const double phon = sone >= 1.0 ? 40.0 + 10.0 * exact_log2(sone)
                                    : 40.0 * exact_pow(sone + 5e-4, 0.35);
    return phon - FULL_SCALE_PHON;
}

double loudness_loudness_db(const Settings *s, const double *real, const double *imaginary)
{
    const Meter meter = {s->loudness_weights, s->loudness_edges, s->loudness_scale,
                         s->loudness_widths, s->slope_a_bark};
    return measure(meter, real, imaginary, 1.0);
}

static double onset_loudness_db(const Settings *s, const double *power, double total, double level)
{
    const Meter meter = {s->onset_loudness_weights, s->onset_loudness_edges,
                         s->onset_loudness_scale, s->onset_loudness_widths, s->slope_a_bark};
    const double factor = level * level / larger(TINY, total);
    return measure(meter, power, NULL, factor) - s->onset_under;
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

/* Return the strength of a hop by its level above the programme and the gain that lowers it, in dB. */
static double felt(const Settings *s, double above, double turned_down)
{
    return exact_amplitude(s->target + s->slope * above + turned_down);
}

/* How far the programme's level goes after a jump that only a volume control makes: to a level that
 * is far away for long, until it is near. Above, only hops count that are far above themselves. */
static double jump(const Settings *s, Loudness *follower, double above, double now_above)
{
    double *far_hops = follower->far_hops;
    const int up = *far_hops > s->jump_up_hops, down = -*far_hops > s->jump_down_hops;
    if (above > (up ? s->near : s->jump))
        *far_hops = smaller(s->jump_up_hops, larger(0.0, *far_hops)) +
                    (now_above > s->near ? 1.0 : 0.0);
    else if (above < -(down ? s->near : s->jump))
        *far_hops = larger(-s->jump_down_hops, smaller(0.0, *far_hops)) - 1.0;
    else
        *far_hops = 0.0;
    if (*far_hops > s->jump_up_hops)
        return s->jump_up_step;
    return -*far_hops > s->jump_down_hops ? -s->jump_down_step : 0.0;
}

/* Loudness that follows clear changes at once and jitter hardly. */
static double steadied(const Settings *s, const Loudness *follower, double loudness_db)
{
    const double change = loudness_db - *follower->steady;
    const double small = within(change, -s->jitter, s->jitter);
    return *follower->steady += (change - small) + s->jitter_followed * small;
}

double loudness_strength(const Settings *s, Loudness *follower, double measured_db)
{
    const double loudness_db = steadied(s, follower, measured_db);
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
    *follower->programme = within(moved + jump(s, follower, above, loudness_db - programme), s->programme_min, s->programme_top);
    return gate * felt(s, above, loudness_db - *follower->loud);
}

double loudness_onset_strength(const Settings *s, const Loudness *follower, const double *power,
                               double level)
{
    if (!(level > 0.0))
        return 0.0;
    double total = 0.0;
    for (size_t bin = 0; bin < s->short_bins; bin++)
        total += power[bin];
    const double loudness_db = onset_loudness_db(s, power, total, level);
    const double squares = weigh_squares(s->onset_felt_squares.at, power, s->short_bins);
    const double sensitivity = sqrt(squares / larger(TINY, total));
    const double loud = larger(*follower->loud, loudness_db);
    const double strength = felt(s, loud - *follower->programme, loudness_db - loud);
    const double wanted = open_gate(s, follower, loudness_db) * strength / sensitivity;
    return smaller(s->gain_max * level, wanted);
}

double loudness_gain(const Settings *s, Loudness *follower, double strength, const double *hz,
                     const double *amplitude, size_t count)
{
    double power = 0.0;
    for (size_t one = 0; one < count; one++) {
        const double weighted = amplitude[one] * table_at(s->felt_weights, s->gain_step_hz, hz[one]);
        power += weighted * weighted;
    }
    *follower->gain = smaller(s->gain_max, strength / sqrt(power));
    return *follower->gain;
}

double loudness_concentrate(const Settings *s, const double *hz, double *amplitude, size_t count,
                            double total)
{
    const double over = total / s->ceiling - 1.0;
    if (!(over > 0.0))
        return total;
    const double exponent = smaller(s->concentrated, s->concentrated * over);
    double before = 0.0, after = 0.0;
    for (size_t one = 0; one < count; one++) {
        const double felt = table_at(s->felt_weights, s->gain_step_hz, hz[one]);
        const double old = amplitude[one] * felt;
        before += old * old;
        amplitude[one] *= exact_pow(felt, exponent);
        after += amplitude[one] * felt * (amplitude[one] * felt);
    }
    const double factor = sqrt(before / after);
    total = 0.0;
    for (size_t one = 0; one < count; one++)
        total += amplitude[one] *= factor;
    return total;
}

int loudness_is_possible(const Settings *s, const Loudness *follower)
{
    return *follower->programme >= s->programme_min && *follower->programme <= s->programme_top &&
           isfinite(*follower->steady) && *follower->floor >= s->floor_min && *follower->loud >= s->floor_min &&
           *follower->far_hops <= s->jump_up_hops + 1.0 &&
           -*follower->far_hops <= s->jump_down_hops + 1.0 && *follower->gain >= 0.0 && *follower->gain <= larger(1.0, s->gain_max);
}
