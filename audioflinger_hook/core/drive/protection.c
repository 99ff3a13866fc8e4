/* Chooses each block's gain from the governor's prediction, the recent demand, the coil's temperature and a
 * gain ceiling. The known block is the next block to output. The coming block is still being received. */

#include "governor.h"

#define CAUTION_MAX 2.0
#define HALVINGS_MAX 10 /* the gain of a block is halved at most 10 times */

struct Protection {
    const ProtectionDesign *design;
    Governor governor;
    double *leaving; /* the block that is being output */
    size_t filled;   /* received frames of the coming block */
    double demands[2], demand, caution, recent_w, wanted_w, coil_k, magnet_k;
    double least_gain;
    int at_ease, is_silent;
    LimitedBy limited_by;
    uint64_t count, limited_blocks, infeasible_blocks;
};

Protection *protection_layout(const ProtectionDesign *d, Arena *arena)
{
    Protection counted, *made = arena_alloc(arena, 1, sizeof(Protection));
    Protection *const p = made ? made : &counted;
    p->design = d;
    governor_layout(&p->governor, d, arena);
    p->leaving = arena_alloc(arena, d->frames, sizeof(double));
    return made;
}

void protection_reset(Protection *p, int as_new)
{
    governor_reset(&p->governor);
    memset(p->leaving, 0, p->design->frames * sizeof(double));
    p->filled = 0;
    p->demands[0] = p->demands[1] = p->demand = p->recent_w = p->wanted_w = 0.0;
    p->caution = 1.0;
    p->at_ease = p->is_silent = 1;
    p->limited_by = NOT_LIMITED;
    if (!as_new)
        return;
    p->count = p->limited_blocks = p->infeasible_blocks = 0;
    p->least_gain = 1.0;
    p->coil_k = p->magnet_k = 0.0;
}

static double resistance_ohm(const Protection *p)
{
    return p->design->resistance_ohm * (1.0 + p->design->resistance_per_k * p->coil_k);
}

/* Advance the temperatures and the wanted power by a block. The wanted power is a decaying peak hold of the
 * average power at a gain of 1. */
static void warm(Protection *p, double power_w, double ungoverned_w)
{
    const ProtectionDesign *d = p->design;
    const double *by = d->thermal, coil_k = p->coil_k, magnet_k = p->magnet_k;
    if (!by)
        return;
    p->coil_k = by[0] * coil_k + by[1] * magnet_k + by[2] * power_w;
    p->magnet_k = by[3] * coil_k + by[4] * magnet_k + by[5] * power_w;
    p->recent_w += d->notice * (ungoverned_w - p->recent_w);
    p->wanted_w = larger(p->recent_w, d->forget * p->wanted_w);
}

static int limits_heat(const ProtectionDesign *d) { return d->thermal && d->hottest_k > 0.0; }

/* Return the allowed power, W: heat flow to the magnet, plus power to reach the limit in approach_s. */
static double power_allowed_w(const Protection *p)
{
    const ProtectionDesign *d = p->design;
    const double onward_w = (p->coil_k - p->magnet_k) / d->coil_k_per_w;
    return larger(0.0, onward_w + d->coil_j_per_k * (d->hottest_k - p->coil_k) / d->approach_s);
}

/* Return the mean power, W, that heats the coil to its limit in a block; 0 if the coil exceeds its limit even
 * without power. */
static double power_to_limit_w(const Protection *p)
{
    const double *by = p->design->thermal;
    return larger(0.0, (p->design->hottest_k - by[0] * p->coil_k - by[1] * p->magnet_k) / by[2]);
}

/* Halve the gain while this block would overheat the coil, then advance the temperatures. The predicted
 * current is an upper bound, since it assumes a cold coil. Return whether the gain was lowered. */
static int keep_within_heat(Protection *p, const GainDecision *decision, double *gain)
{
    if (!p->design->thermal)
        return 0;
    const double *power = decision->power, ohm = resistance_ohm(p);
    double square = power[0] + *gain * (power[1] + *gain * power[2]);
    int is_lowered = 0;
    for (; is_lowered < HALVINGS_MAX && limits_heat(p->design) && ohm * square > power_to_limit_w(p);
         is_lowered++) {
        *gain /= 2.0;
        square = power[0] + *gain * (power[1] + *gain * power[2]);
    }
    warm(p, larger(0.0, ohm * square), ohm * power[3]);
    return is_lowered;
}

/* Return whether the coil's temperature allows the wanted power. */
static int heat_is_far(const Protection *p)
{
    return !limits_heat(p->design) || p->wanted_w <= power_allowed_w(p);
}

/* Return whether the coil is so warm that the heat of every block must be checked. */
static int is_warm(const Protection *p)
{
    return limits_heat(p->design) && p->coil_k > 0.5 * p->design->hottest_k;
}

/* Hold the peak of the demand for one to two hold times, then let it decay. Let the safety factor, `caution`,
 * decay to 1. */
static void remember(Protection *p, double demand)
{
    const ProtectionDesign *d = p->design;
    if (p->count % d->hold_blocks == 0) {
        p->demands[1] = p->demands[0];
        p->demands[0] = 0.0;
    }
    p->demands[0] = larger(demand, p->demands[0]);
    p->demand = larger(d->release * p->demand, larger(p->demands[0], p->demands[1]));
    p->caution = 1.0 + d->release * (p->caution - 1.0);
}

static void rest(Protection *p)
{
    governor_rest(&p->governor);
    memset(p->leaving, 0, p->design->frames * sizeof(double));
    p->limited_by = NOT_LIMITED;
    remember(p, 0.0);
    warm(p, 0.0, 0.0);
    p->at_ease = p->at_ease && heat_is_far(p);
}

/* Output the known block unchanged if no limit can be reached; return whether it was output. */
static int advance_unlimited(Protection *p)
{
    const double *drive = known_block(&p->governor)->drive;
    double mean_a2;
    if (!governor_advance_unlimited(&p->governor, &mean_a2))
        return 0;
    const double power_w = resistance_ohm(p) * mean_a2;
    warm(p, power_w, power_w);
    p->at_ease = heat_is_far(p);
    p->limited_by = NOT_LIMITED;
    memcpy(p->leaving, drive, p->design->frames * sizeof(double));
    return 1;
}

/* Output the known block with the largest gain that the limits allow. */
static void advance_limited(Protection *p, double gain_ceiling)
{
    const ProtectionDesign *d = p->design;
    const double before = p->governor.gain, *drive = known_block(&p->governor)->drive;
    const double ceiling = gain_ceiling >= 0.0 ? smaller(gain_ceiling, 1.0) : 0.0;
    const double allowed_w = limits_heat(d) ? power_allowed_w(p) : INFINITY;
    const double thermal = p->wanted_w > allowed_w ? sqrt(allowed_w / p->wanted_w) : 1.0;
    double requested_gain = smaller(1.0, before + d->recovery);
    requested_gain = smaller(requested_gain, 1.0 / larger(1.0, p->caution * p->demand));
    requested_gain = smaller(requested_gain, smaller(ceiling, thermal));
    const GainDecision found = governor_decide(&p->governor, requested_gain);
    remember(p, found.demand);
    if (found.gain < requested_gain)
        p->caution = smaller(CAUTION_MAX, d->caution * p->caution);
    /* For a demand above 1, the limits allow a gain of about 1 / demand. The ceiling scales this gain. */
    const double capped = ceiling / larger(1.0, p->demand);
    double gain = smaller(found.gain, capped);
    const int is_hot = keep_within_heat(p, &found, &gain);
    governor_advance(&p->governor, gain);
    for (size_t frame = 0; frame < d->frames; frame++) {
        const double share = (double)(frame + 1) / (double)d->frames;
        p->leaving[frame] = drive[frame] * (before * (1.0 - share) + gain * share);
    }
    if (smaller(gain, before) >= 1.0) /* at a gain of 1, a copy avoids rounding errors */
        memcpy(p->leaving, drive, d->frames * sizeof(double));
    p->least_gain = smaller(gain, p->least_gain);
    p->infeasible_blocks += (uint64_t)found.infeasible;
    p->limited_blocks += gain < 1.0;
    p->limited_by = NOT_LIMITED;
    if (gain < 1.0)
        p->limited_by = is_hot || thermal <= gain ? BY_TEMPERATURE
                        : ceiling < 1.0 && capped <= gain ? BY_EXPOSURE
                                                          : BY_MOTION;
    /* At ease: this block ends at a gain of 1, and neither demand nor wanted power is above its limit. */
    p->at_ease = gain >= 1.0 && p->caution * p->demand <= 1.0 && thermal >= 1.0;
    if (p->at_ease)
        p->caution = 1.0;
}

/* Output the known block when the coming block is complete. */
static void end_block(Protection *p, double gain_ceiling)
{
    p->count++;
    p->filled = 0;
    governor_take(&p->governor);
    if (p->is_silent && governor_is_at_rest(&p->governor)) {
        rest(p);
        return;
    }
    if (!(p->at_ease && !is_warm(p) && gain_ceiling >= 1.0 && advance_unlimited(p)))
        advance_limited(p, gain_ceiling);
    p->is_silent = coming_block(&p->governor)->loudest == 0.0;
    governor_next(&p->governor);
}

double protection_step(Protection *p, double sample, double gain_ceiling)
{
    const double leaves = p->leaving[p->filled];
    coming_block(&p->governor)->drive[p->filled] = sample;
    if (++p->filled == p->design->frames)
        end_block(p, gain_ceiling);
    return leaves;
}

void protection_report(const Protection *p, ActuatorReadings *readings)
{
    readings->gain = p->governor.gain;
    readings->least_gain = p->least_gain;
    readings->excursion_m = governor_excursion_m(&p->governor);
    readings->coil_c = p->design->ambient_c + p->coil_k;
    readings->magnet_c = p->design->ambient_c + p->magnet_k;
    readings->blocks = p->count;
    readings->limited_blocks = p->limited_blocks;
    readings->infeasible_blocks = p->infeasible_blocks;
    readings->limited_by = (uint64_t)p->limited_by;
}

void protection_set_temperatures(Protection *p, double coil_k, double magnet_k)
{
    const double hottest_k = p->design->hottest_k;
    p->coil_k = fabs(coil_k) < INFINITY ? larger(0.0, coil_k) : hottest_k;
    p->magnet_k = fabs(magnet_k) < INFINITY ? larger(0.0, magnet_k) : hottest_k;
}
