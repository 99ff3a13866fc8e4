#include "actuator.h"
#include "../../transform/native/exact.h"

#define FADE_S 0.04 /* of a change of level, source, delay or audibility */
#define DAMPING_CHECK_S 0.05
#define DOSE_MAX 1e30 /* replaces an invalid or larger integral, and exceeds every cap */
#define DAY_S 28800.0
#define FREE_SHARE 0.5 /* share of the allowed dose above which the cap lowers the gain */
#define NEGLIGIBLE 1e-60
#define DAMAGED 1e6 /* a sample of larger magnitude, or one that is not finite, counts as 0 */

/* Return the allowed growth rate of the dose, as a share of the rate without a cap. used: dose as a share of
 * the allowed dose. The result is 1 up to used = FREE_SHARE, then falls linearly to 0 at used = 1. */
static double remaining(double used)
{
    return smaller(1.0, larger(0.0, (1.0 - used) / (1.0 - FREE_SHARE)));
}

/* Compute the gain that keeps a day's dose within its caps. The integral of squares, for A(8), grows with the
 * second power of the gain; the integral of fourth powers, for the vibration dose value, with the fourth. */
static void update_gain(Exposure *e)
{
    const ExposureDesign *d = e->design;
    e->gain = 1.0;
    if (!(d->cap_a8_m_s2 > 0.0))
        return;
    const double a8 = sqrt(e->sums.squares / DAY_S) / d->cap_a8_m_s2;
    const double vdv = sqrt(sqrt(e->sums.fourths)) / d->cap_vdv;
    e->gain = smaller(sqrt(remaining(a8 * a8)), sqrt(sqrt(remaining(vdv * vdv * vdv * vdv))));
}

static void exposure_set_sums(Exposure *e, CoreDose sums)
{
    e->sums = sums;
    e->frames = 0;
    update_gain(e);
}

static void exposure_reset(Exposure *e, int doses_too)
{
    memset(e->past, 0, e->design->decimation_taps * sizeof(double));
    *e = (Exposure){.design = e->design, .past = e->past, .sums = e->sums, .frames = e->frames,
                    .gain = e->gain, .until_reading = e->design->reading_frames};
    if (doses_too)
        exposure_set_sums(e, (CoreDose){0.0, 0.0, 0.0, 0.0});
}

static CoreDose exposure_dose(const Exposure *e)
{
    CoreDose dose = e->sums;
    dose.time_s += (double)e->frames * e->design->period_s;
    return dose;
}

/* Return the newest sample of the drive after the low-pass `decimation`. */
static double decimated(const Exposure *e)
{
    const size_t taps = e->design->decimation_taps, first = taps - e->next;
    const double *weights = e->design->decimation;
    double sum = 0.0;
    for (size_t at = 0; at < first; at++)
        sum += e->past[e->next + at] * weights[at];
    for (size_t at = first; at < taps; at++)
        sum += e->past[at - first] * weights[at];
    return sum;
}

static void accumulate(Exposure *e)
{
    const ExposureDesign *d = e->design;
    double moved = cascade_step(&e->motion, d->motion, decimated(e) * d->volts_per_full_scale);
    if (d->motion_taps) {
        memmove(e->recent + 1, e->recent, (d->motion_taps - 1) * sizeof(double));
        e->recent[0] = moved;
        moved = 0.0;
        for (size_t tap = d->motion_taps; tap-- > 0;)
            moved += e->recent[tap] * d->motion_fir[tap];
    }
    const double weighted = cascade_step(&e->weighting, d->weighting, moved);
    const double above = cascade_step(&e->above, d->above, weighted);
    const double square = weighted * weighted;
    e->running += d->running_share * (square - e->running);
    e->frames++;
    e->sums.squares += d->period_s * square;
    e->sums.fourths += d->period_s * (square * square);
    e->sums.above += d->period_s * (above * above);
}

static void exposure_step(Exposure *e, double sample)
{
    const ExposureDesign *d = e->design;
    e->past[e->next] = sample;
    e->next = e->next + 1 == d->decimation_taps ? 0 : e->next + 1;
    if (++e->phase == d->factor) {
        e->phase = 0;
        accumulate(e);
    }
    if (--e->until_reading == 0) {
        e->until_reading = d->reading_frames;
        drop_decayed(&e->motion, sizeof e->motion);
        drop_decayed(&e->weighting, sizeof e->weighting);
        drop_decayed(&e->above, sizeof e->above);
        if (e->running < NEGLIGIBLE)
            e->running = 0.0;
        update_gain(e);
    }
}

void history_add(History *history, const double *vibration, size_t frames)
{
    for (size_t frame = 0; frame < frames; frame++) {
        for (size_t source = 0; source < history->sources; source++)
            history->samples[source * history->frames + history->next] = (float)*vibration++;
        history->next = history->next + 1 == history->frames ? 0 : history->next + 1;
    }
}

/* Return the source's sample, tap.delay + `back` frames before the newest frame. */
INLINED double history_at(const History *history, TapPoint tap, size_t back)
{
    const size_t distance = back + tap.delay + 1;
    const size_t at = history->next >= distance ? history->next - distance
                                                : history->next + history->frames - distance;
    return (double)history->samples[tap.source * history->frames + at];
}

static size_t frames_in(double seconds, double samplerate)
{
    const double frames = floor(seconds * samplerate + 0.5);
    return frames > 1.0 ? (size_t)frames : 1;
}

static double ramp_now(const Ramp *ramp)
{
    if (ramp->done == ramp->frames)
        return ramp->to;
    return ramp->from + (ramp->to - ramp->from) * smooth_step((double)ramp->done / (double)ramp->frames);
}

INLINED double ramp_step(Ramp *ramp)
{
    if (ramp->done < ramp->frames)
        ramp->done++;
    else if (ramp->wanted != ramp->to)
        *ramp = (Ramp){ramp->to, ramp->wanted, ramp->wanted, 1, ramp->frames};
    return ramp_now(ramp);
}

void actuator_layout(Actuator *a, const DriveDesign *design, double samplerate, Arena *arena)
{
    Actuator counted;
    Actuator *const target = a ? a : &counted;
    target->design = design;
    target->samplerate = samplerate;
    target->protection = NULL;
    if (!design || !design->protection.models)
        return;
    target->protection = protection_layout(&design->protection, arena);
    target->exposure.design = target->undamped.design = &design->exposure;
    target->exposure.past = arena_doubles(arena, design->exposure.decimation_taps);
    target->undamped.past = arena_doubles(arena, design->exposure.decimation_taps);
}

void actuator_reset(Actuator *a, int doses_too)
{
    if (a->protection) {
        protection_reset(a->protection, doses_too);
        exposure_reset(&a->exposure, doses_too);
        exposure_reset(&a->undamped, doses_too);
    }
    memset(&a->damping, 0, sizeof a->damping);
    a->until_damping_check = frames_in(DAMPING_CHECK_S, a->samplerate);
    if (doses_too)
        a->replaced = 0;
}

void actuator_set(Actuator *a, TapPoint tap, double factor, int audible, int at_once)
{
    const double open = audible ? 1.0 : 0.0;
    a->wanted_tap = tap;
    a->level.wanted = factor;
    a->audible.wanted = open;
    if (!at_once)
        return;
    const size_t frames = frames_in(FADE_S, a->samplerate);
    a->tap = a->next_tap = tap;
    a->tap_fade_frames = a->tap_faded = frames;
    a->level = (Ramp){factor, factor, factor, frames, frames};
    a->audible = (Ramp){open, open, open, frames, frames};
}

/* Return the delayed source times the level. A change of source or delay starts a cross-fade after the
 * previous cross-fade has ended. A newer change replaces a waiting change. */
INLINED double routed(Actuator *a, const History *history, size_t back)
{
    if (a->tap_faded == a->tap_fade_frames &&
        (a->wanted_tap.source != a->tap.source || a->wanted_tap.delay != a->tap.delay)) {
        a->next_tap = a->wanted_tap;
        a->tap_faded = 0;
    }
    double sample = history_at(history, a->tap, back);
    if (a->tap_faded < a->tap_fade_frames) {
        const double share = smooth_step((double)++a->tap_faded / (double)a->tap_fade_frames);
        sample += share * (history_at(history, a->next_tap, back) - sample);
        if (a->tap_faded == a->tap_fade_frames)
            a->tap = a->next_tap;
    }
    if (!(fabs(sample) <= DAMAGED)) {
        sample = 0.0;
        a->replaced++;
    }
    const double level = ramp_step(&a->level);
    return level != 1.0 ? level * sample : sample;
}

INLINED double damped(Actuator *a, double sample)
{
    const DriveDesign *d = a->design;
    sample = cascade_step(&a->damping, d->damping, 0.0 + d->damping_gain * sample);
    if (--a->until_damping_check == 0) {
        a->until_damping_check = frames_in(DAMPING_CHECK_S, a->samplerate);
        drop_decayed(&a->damping, sizeof a->damping);
    }
    return sample;
}

void actuator_process(Actuator *a, const History *history, float *out, size_t stride, size_t frames)
{
    const int is_damped = a->design && a->design->damping_gain != 0.0;
    for (size_t frame = 0; frame < frames; frame++, out += stride) {
        double sample = routed(a, history, frames - 1 - frame);
        if (is_damped) {
            if (a->protection)
                exposure_step(&a->undamped, sample);
            sample = damped(a, sample);
        }
        if (a->protection) {
            sample = protection_step(a->protection, sample, a->exposure.gain);
            exposure_step(&a->exposure, sample);
        }
        const double open = ramp_step(&a->audible);
        if (open != 1.0)
            sample *= open;
        *out = (float)sample;
    }
}

void actuator_report(const Actuator *a, ActuatorReadings *r)
{
    r->audible = ramp_now(&a->audible);
    r->gain = r->least_gain = r->exposure_gain = 1.0;
    r->replaced = a->replaced;
    if (!a->protection)
        return;
    protection_report(a->protection, r);
    r->exposure_gain = a->exposure.gain;
    r->dose = exposure_dose(&a->exposure);
    r->running_m_s2 = sqrt(larger(0.0, a->exposure.running));
    r->undamped_squares = a->undamped.sums.squares;
}

static double usable_sum(double sum) { return sum >= 0.0 && sum < DOSE_MAX ? sum : DOSE_MAX; }

void actuator_set_temperatures(Actuator *a, const ActuatorSafety *safety)
{
    if (!a->protection)
        return;
    const double ambient_c = a->design->protection.ambient_c;
    protection_set_temperatures(a->protection, safety->coil_c - ambient_c,
                                safety->magnet_c - ambient_c);
}

void actuator_set_safety(Actuator *a, const ActuatorSafety *safety)
{
    if (!a->protection)
        return;
    actuator_set_temperatures(a, safety);
    const CoreDose dose = safety->dose, sums = {usable_sum(dose.time_s), usable_sum(dose.squares),
                                                usable_sum(dose.fourths), usable_sum(dose.above)};
    exposure_set_sums(&a->exposure, sums);
    if (a->design->damping_gain > 0.0)
        exposure_set_sums(&a->undamped, sums); /* doses with and without damping start equal */
}

void actuator_begin_day(Actuator *a)
{
    const CoreDose none = {0.0, 0.0, 0.0, 0.0};
    if (!a->protection)
        return;
    exposure_set_sums(&a->exposure, none);
    exposure_set_sums(&a->undamped, none);
}
