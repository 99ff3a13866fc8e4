/* Loudness by ISO 532-1 at the end of each tick, and the vibration strength that follows from it.
 *
 * From 560 Hz up, band powers come from the spectra of the onset window. Below 560 Hz, where the bins of
 * these spectra are wider than the bands, filters process the analytic signal at the low (decimated) rate. The
 * magnitude of a tone's analytic signal is constant. */

#include "loudness.h"
#include "exact.h"
#include "filter.h"

void band_powers_reset(const Settings *s, BandPowers *powers)
{
    memset(&powers->low, 0, sizeof powers->low);
    memset(powers->recent, 0, (s->average_ticks - 1) * s->high_weights.length * sizeof(double));
}

/* Apply the anti-aliasing low-pass to the frames of one step; return the low-pass's last output. */
INLINED double smoothed(const double *row, double *states, const double *samples, size_t frames)
{
    double next[SMOOTH_ROW] = {0.0};
    for (size_t frame = 0; frame < frames; frame++, row += SMOOTH_ROW)
        for (size_t one = 0; one < SMOOTH_ROW; one++)
            next[one] += row[one] * samples[frame];
    for (size_t state = 0; state < SMOOTH_STATES; state++, row += SMOOTH_ROW)
        for (size_t one = 0; one < SMOOTH_ROW; one++)
            next[one] += row[one] * states[state];
    memcpy(states, next, SMOOTH_STATES * sizeof *states);
    return next[SMOOTH_STATES];
}

/* Filter one sample by a chain of all-passes (a^2 - z^-2) / (1 - a^2 z^-2). */
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

/* Complex pole and input gain of each low band. */
typedef struct {
    double real[LOW_MAX], imaginary[LOW_MAX], feed[LOW_MAX];
} Poles;

/* Filter one sample of the analytic signal by each band's two poles; add |output|^2 to `squares`. */
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

SIMD_CLONES_NARROW static void update_low(const Settings *s, LowBands *low, const double *samples,
                                          double *restrict squares)
{
    const double *chain = s->quadrature.at;
    Poles poles = {{0.0}, {0.0}, {0.0}};
    for (size_t band = 0; band < s->low_weights.length; band++) {
        const double *row = s->low_poles.at + LOW_NUMBERS * band;
        poles.real[band] = row[0];
        poles.imaginary[band] = row[1];
        poles.feed[band] = row[2];
    }
    for (size_t step = 0; step < s->tick_steps; step++) {
        const double x =
            smoothed(s->low_smooth.at, low->smooth, samples + step * s->decimation, s->decimation);
        const double imaginary = through(chain, low->chains[0], x);
        const double real = through(chain + CHAIN, low->chains[1], low->before);
        low->before = x;
        resonate(&poles, low, real, imaginary, squares);
    }
    drop_decayed(low, sizeof *low);
}

/* Write each band's excitation relative to the threshold in quiet. short_power: bin powers of the onset
 * window. */
static void band_powers_update(const Settings *s, BandPowers *powers, const double *samples,
                      const double *short_power, double *excitation)
{
    const size_t low = s->low_weights.length, high = s->high_weights.length, older = s->average_ticks - 1;
    double squares[LOW_MAX] = {0.0}, now[BANDS_MAX];
    memset(excitation, 0, s->loudness_scale.length * sizeof(double));
    update_low(s, &powers->low, samples, squares);
    for (size_t band = 0; band < low; band++)
        excitation[(size_t)s->low_band_of.at[band]] += s->low_weights.at[band] * squares[band];
    double *above = excitation + (s->loudness_scale.length - high);
    for (size_t band = 0; band < high; band++) {
        const size_t first = (size_t)s->high_edges.at[band], end = (size_t)s->high_edges.at[band + 1];
        now[band] = s->high_weights.at[band] * sum(short_power + first, end - first);
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

/* ------------------------------------------------------------------------------------ loudness */

typedef struct {
    double db;   /* loudness level in phon, minus FULL_SCALE_PHON */
    double sone; /* total loudness in sone */
    double groups[GROUPS_OF_BANDS_MAX]; /* sone of each group of bands, without masking between bands */
} Loudness;

#define THRESHOLD 0.25       /* threshold factor of ISO 532-1 */
#define FULL_SCALE_PHON 94.0 /* assumed loudness level of a full-scale tone of 1 kHz */

static double fourth_root(double number) { return sqrt(sqrt(number)); }

/* Write each band's specific loudness in sone per Bark, without masking between bands. */
SIMD_CLONES_NARROW static void specific_loudness(const double *restrict scale,
                                                 const double *restrict excitation, size_t bands,
                                                 double *restrict cores)
{
    for (size_t band = 0; band < bands; band++)
        cores[band] = larger(
            0.0, scale[band] * (fourth_root(1.0 - THRESHOLD + THRESHOLD * excitation[band]) - 1.0));
}

static Loudness loudness_of(const Settings *s, const double *excitation)
{
    Loudness now = {0.0, 0.0, {0.0}};
    double above = 0.0, cores[BANDS_MAX];
    size_t group = 0;
    specific_loudness(s->loudness_scale.at, excitation, s->loudness_scale.length, cores);
    for (size_t band = 0; band < s->loudness_scale.length; band++) {
        const double core = cores[band], width = s->loudness_widths.at[band];
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

/* ------------------------------------------------------------------------------------ strength */

#define DB_A_DECADE 33.219280948873624 /* dB for a factor of 10 in sone, which is 10 dB for a factor of 2 */
#define STILL 1e-30 /* smaller values are set to 0, because arithmetic with denormal numbers is slow */

void strength_reset(const Settings *s, Strength *strength)
{
    strength->programme = s->programme_start;
    strength->sound_ticks = 0.0;
    strength_rest(s, strength);
}

void strength_rest(const Settings *s, Strength *strength)
{
    const double programme = strength->programme, sound_ticks = strength->sound_ticks;
    memset(strength, 0, sizeof *strength);
    strength->programme = programme;
    strength->sound_ticks = sound_ticks;
    strength->floor = strength->loud = strength->steady = strength->slow = s->floor_min;
    strength->speech_left = 1.0;
    strength->usual = s->silence_db;
    for (size_t group = 0; group < GROUPS_OF_BANDS_MAX; group++) {
        strength->usual_of[group] = s->silence_db;
        strength->deviation[group] = s->deviation_start;
    }
}

/* Return how far the noise gate is open, 0 to 1. */
static double open_gate(const Settings *s, const Strength *strength)
{
    const double under = smaller(strength->floor, strength->programme - s->floor_under);
    const double over = smaller(1.0, (strength->steady - larger(s->floor_min, under)) / s->gate);
    return over >= s->gate_margin ? over * over * (3.0 - 2.0 * over) : 0.0;
}

/* Move the programme level towards strength->loud. At the start of a stream, it falls faster. */
static void move_programme(const Settings *s, Strength *strength, double gate)
{
    const double above = strength->loud - strength->programme;
    const double missing = clip(above, -s->far, s->far);
    double move = clip(above, -1.0, 1.0) * s->programme_step +
                  missing * (missing > 0.0 ? s->programme_rise : s->programme_fall);
    if (strength->sound_ticks < s->start_ticks) {
        strength->sound_ticks += 1.0;
        move += clip(above + s->start_near, -s->far, 0.0) / (s->start_weight + strength->sound_ticks);
    }
    strength->programme = clip(strength->programme + gate * move, s->programme_min, s->programme_top);
}

/* Average the loudness of each group over time. Write each average plus group_sone as a level: 0 dB at 1 sone,
 * 10 dB more for each factor of 2. */
SIMD_CLONES_NARROW static void smooth_groups(const Settings *s, double *restrict smooth,
                                             const double *restrict sone, double *restrict level)
{
    for (size_t group = 0; group < GROUPS_OF_BANDS_MAX; group++) {
        const double now = smooth[group] + s->group_smooth * (sone[group] - smooth[group]);
        smooth[group] = now < STILL ? 0.0 : now;
        level[group] = DB_A_DECADE * LOG10_E * log_of_normal(smooth[group] + s->group_sone);
    }
}

/* Update all groups of bands; return the largest boost, in dB, that follows from the rise of a single group.
 * The function `boost` then subtracts the rise of the total loudness. */
static double wanted_rise(const Settings *s, Strength *strength, const Loudness *loudness)
{
    double wanted = 0.0, level[GROUPS_OF_BANDS_MAX];
    smooth_groups(s, strength->smooth, loudness->groups, level);
    for (size_t group = 0; group + 1 < s->loudness_groups.length; group++) {
        double *deviation = &strength->deviation[group];
        const double rise = level[group] - strength->usual_of[group];
        const double over = rise - s->boost_deviations * *deviation;
        if (over > 0.0) {
            const double share = loudness->groups[group] / (loudness->sone + s->nothing);
            const double counts = clip((share - s->boost_share_from) / s->boost_share_width, 0.0, 1.0);
            wanted = larger(wanted, smaller(s->boost_max, s->boost_slope * counts * over));
        }
        *deviation += s->group_deviates * (smaller(s->deviation_max, fabs(rise)) - *deviation);
        if (*deviation < STILL)
            *deviation = 0.0;
        strength->usual_of[group] += rise * (rise > 0.0 ? s->group_up : s->group_down);
    }
    return wanted;
}

/* Update the boost. A rise in a few bands that hardly changes the total loudness raises the boost at once. */
static void boost(const Settings *s, Strength *strength, double wanted)
{
    const double above = strength->steady - strength->usual;
    const double natural = s->slope * above;
    const double extra = larger(0.0, wanted - larger(0.0, natural) - s->boost_natural);
    strength->usual += above * (above > 0.0 ? s->group_up : s->group_down);
    if (extra >= strength->boost) {
        strength->boost = extra;
        strength->held_ticks = s->boost_hold_ticks;
        return;
    }
    strength->held_ticks = larger(0.0, strength->held_ticks - 1.0);
    if (strength->held_ticks == 0.0)
        strength->boost = larger(extra, strength->boost - s->boost_fall);
}

double strength_of_tick(const Settings *s, BandPowers *powers, Strength *strength, const double *samples,
                        const double *short_power)
{
    double excitation[BANDS_MAX];
    band_powers_update(s, powers, samples, short_power, excitation);
    const Loudness loudness = loudness_of(s, excitation);
    const double change = loudness.db - strength->steady;
    if (change > s->jump)
        strength->attack_ticks = s->attack_ticks;
    const double jitter = strength->attack_ticks > 0.0 ? 0.0 : s->jitter;
    const double small = clip(change, -jitter, jitter);
    strength->attack_ticks = larger(0.0, strength->attack_ticks - 1.0);
    strength->steady += (change - small) + s->jitter_followed * small;
    strength->slow += s->slow_followed * (strength->steady - strength->slow);
    strength->floor = larger(s->floor_min, smaller(strength->floor + s->floor_rise, strength->steady));
    strength->loud = larger(larger(s->floor_min, strength->loud - s->release), strength->slow);
    const double gate = open_gate(s, strength);
    if (gate > 0.0)
        move_programme(s, strength, gate);
    boost(s, strength, wanted_rise(s, strength, &loudness));
    if (!(gate > 0.0))
        return 0.0;
    const double level = s->target + s->slope * (strength->steady - strength->programme);
    return gate * strength->speech_left * exact_amplitude(level + strength->boost * strength->speech_left);
}
