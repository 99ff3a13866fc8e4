/* From vibration to the signal of one actuator. */

#include "actuator.h"

#include "../../transform/native/exact.h"

#define FADE_S 0.01     /* of level, source and delay: too slow to click, too fast to notice */
#define AUDIBLE_S 0.04
#define DAMPING_CHECK_S 0.05
#define DOSE_MAX 1e30 /* of what is no part of a dose */
#define DAMAGED 1e6 /* a larger sample is damage, as is one that is not finite */

void history_add(History *history, const double *vibration, size_t frames)
{
    for (size_t frame = 0; frame < frames; frame++) {
        for (size_t source = 0; source < history->sources; source++)
            history->samples[source * history->frames + history->next] = (float)*vibration++;
        history->next = history->next + 1 == history->frames ? 0 : history->next + 1;
    }
}

/* A source's sample, so many frames before the newest. */
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
    return ramp->from + (ramp->to - ramp->from) * ((double)ramp->done / (double)ramp->frames);
}

static void ramp_to(Ramp *ramp, double value)
{
    if (value == ramp->to)
        return;
    ramp->from = ramp_now(ramp);
    ramp->to = value;
    ramp->done = 0;
}

INLINED double ramp_step(Ramp *ramp)
{
    ramp->done += ramp->done < ramp->frames;
    return ramp_now(ramp);
}

void actuator_layout(Actuator *a, const DriveDesign *design, double samplerate, Arena *arena)
{
    Actuator counted;
    Actuator *const target = a ? a : &counted;
    target->design = design;
    target->samplerate = samplerate;
    target->protection = NULL;
    if (design && design->protection.models) {
        target->protection = protection_layout(&design->protection, arena);
        exposure_layout(&target->exposure, &design->exposure, arena);
        exposure_layout(&target->undamped, &design->exposure, arena);
    }
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

void actuator_begin(Actuator *a, TapPoint tap, double factor, int audible)
{
    a->tap = a->next_tap = a->wanted_tap = tap;
    a->tap_fade_frames = a->tap_faded = frames_in(FADE_S, a->samplerate);
    a->level = (Ramp){factor, factor, a->tap_fade_frames, a->tap_fade_frames};
    const double open = audible ? 1.0 : 0.0;
    const size_t frames = frames_in(AUDIBLE_S, a->samplerate);
    a->audible = (Ramp){open, open, frames, frames};
}

void actuator_change(Actuator *a, TapPoint tap, double factor, int audible)
{
    a->wanted_tap = tap;
    ramp_to(&a->level, factor);
    ramp_to(&a->audible, audible ? 1.0 : 0.0);
}

/* The delayed source times the level. A second change of source or delay begins when the first has
 * ended; of several that wait, the last counts. */
INLINED double routed(Actuator *a, const History *history, size_t back)
{
    if (a->tap_faded == a->tap_fade_frames &&
        (a->wanted_tap.source != a->tap.source || a->wanted_tap.delay != a->tap.delay)) {
        a->next_tap = a->wanted_tap;
        a->tap_faded = 0;
    }
    double sample = history_at(history, a->tap, back);
    if (a->tap_faded < a->tap_fade_frames) {
        const double share = (double)++a->tap_faded / (double)a->tap_fade_frames;
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
        cascade_drop_decayed(&a->damping, d->damping);
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
        if (open != 1.0) /* without a bend at either end */
            sample *= open * open * (3.0 - 2.0 * open);
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

/* A part of a dose; what is none counts as more than any cap. */
static double usable_sum(double sum) { return sum >= 0.0 && sum < DOSE_MAX ? sum : DOSE_MAX; }

void actuator_set_safety(Actuator *a, const ActuatorSafety *safety)
{
    if (!a->protection)
        return;
    const double ambient_c = a->design->protection.ambient_c;
    protection_set_temperatures(a->protection, safety->coil_c - ambient_c,
                                safety->magnet_c - ambient_c);
    const CoreDose dose = safety->dose, sums = {usable_sum(dose.time_s), usable_sum(dose.squares),
                                                usable_sum(dose.fourths), usable_sum(dose.above)};
    exposure_set_sums(&a->exposure, sums);
    if (a->design->damping_gain > 0.0)
        exposure_set_sums(&a->undamped, sums); /* the ratio begins at 1 */
}

void actuator_begin_day(Actuator *a)
{
    const CoreDose none = {0.0, 0.0, 0.0, 0.0};
    if (!a->protection)
        return;
    exposure_set_sums(&a->exposure, none);
    exposure_set_sums(&a->undamped, none);
}
