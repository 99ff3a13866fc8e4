/* Exposure to one actuator's vibration. */

#include "exposure.h"

#define DAY_S 28800.0
#define FREE_SHARE 0.5 /* of the allowed dose, from which on the cap acts */
#define NEGLIGIBLE 1e-60

void exposure_layout(Exposure *e, const ExposureDesign *design, Arena *arena)
{
    double *past = arena_alloc(arena, design->decimation_taps, sizeof(double));
    if (!past)
        return;
    e->design = design;
    e->past = past;
}

/* The share of the dose that is left: 1 up to the free share, from there on down to 0. */
static double remaining(double used)
{
    return smaller(1.0, larger(0.0, (1.0 - used) / (1.0 - FREE_SHARE)));
}

/* The gain that lets a day's dose approach its limits but not pass them: a dose grows with the second
 * power of the gain, the vibration dose value's with the fourth. */
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

void exposure_reset(Exposure *e, int doses_too)
{
    memset(e->past, 0, e->design->decimation_taps * sizeof(double));
    memset(e->recent, 0, sizeof e->recent);
    memset(&e->motion, 0, sizeof e->motion);
    memset(&e->weighting, 0, sizeof e->weighting);
    memset(&e->above, 0, sizeof e->above);
    e->next = e->phase = 0;
    e->until_reading = e->design->reading_frames;
    e->running = 0.0;
    if (doses_too)
        exposure_set_sums(e, (CoreDose){0.0, 0.0, 0.0, 0.0});
}

CoreDose exposure_dose(const Exposure *e)
{
    CoreDose dose = e->sums;
    dose.time_s += (double)e->frames * e->design->period_s;
    return dose;
}

void exposure_set_sums(Exposure *e, CoreDose sums)
{
    e->sums = sums;
    e->frames = 0;
    update_gain(e);
}

/* The low-passed drive, of the frames up to the last one. */
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
    double moved = cascade_step(&e->motion, d->motion, decimated(e) * d->m_s2_per_full_scale);
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

void exposure_step(Exposure *e, double sample)
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
        cascade_drop_decayed(&e->motion, d->motion);
        cascade_drop_decayed(&e->weighting, d->weighting);
        cascade_drop_decayed(&e->above, d->above);
        if (e->running < NEGLIGIBLE)
            e->running = 0.0;
        update_gain(e);
    }
}
