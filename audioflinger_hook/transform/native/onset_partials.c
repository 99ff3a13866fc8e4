/* Partials that start at an onset and play until they are handed over to the tracker at the end of a hop. */

#include "loudness.h"
#include "scaling.h"
#include "synthesis.h"
#include "tracking.h"

int onset_partials_sounds(const Settings *s, const OnsetPartial *partials)
{
    for (size_t slot = 0; slot < s->onset_partials_max; slot++)
        if (partials[slot].sounds != 0.0)
            return 1;
    return 0;
}

static OnsetTone estimate(const Settings *s, OnsetSources sources, Group group)
{
    OnsetTone tone = onsets_estimate(s, sources.onsets, group);
    if (loudness_is_on(s))
        tone.amplitude *= tilt(s, tone.hz);
    if (s->speech_db > 0.0)
        tone.amplitude *= speech_coarse_gain(s, sources.speech, audio_hz(s, tone.hz));
    tone.amplitude *= smoothing_gain(s, tone.hz);
    return tone;
}

/* Return the sum of goal amplitudes of onset partials within reach_hz of a frequency. */
static double goals_near(const Settings *s, const OnsetPartial *partials, double hz, double reach_hz)
{
    double goals = 0.0;
    for (size_t slot = 0; slot < s->onset_partials_max; slot++)
        if (partials[slot].sounds != 0.0 && fabs(partials[slot].hz - hz) < reach_hz)
            goals += partials[slot].goal;
    return goals;
}

/* Return the amplitude that is left under the ceiling. If the strength follows loudness, the oscillators
 * enforce the ceiling, and the result is infinite. */
static double room(const Settings *s, const OnsetPartial *partials, const Slots *slots)
{
    if (loudness_is_on(s))
        return INFINITY;
    const double goals = goals_near(s, partials, 0.0, INFINITY);
    return larger(0.0, s->ceiling - (tracking_loudest_sum(s, slots) + goals));
}

void onset_partials_start(const Settings *s, OnsetPartial *partials, OnsetSources sources,
                         const Slots *slots, size_t ticks_left)
{
    Group groups[FRESH_MAX];
    int young[FRESH_MAX];
    const size_t count = onsets_groups(s, sources.onsets, groups);
    for (size_t slot = 0; slot < s->onset_partials_max; slot++) {
        young[slot] = partials[slot].sounds != 0.0 && partials[slot].age < (double)s->heard_ticks;
        if (young[slot])
            partials[slot].goal = 0.0;
    }
    for (size_t which = 0; which < count; which++) {
        const OnsetTone found = estimate(s, sources, groups[which]);
        const double base = tracking_sounding_near(s, slots, found.hz) +
                            goals_near(s, partials, found.hz, tracking_near_hz(s, found.hz));
        const double lacking = smaller(found.amplitude - base, room(s, partials, slots));
        if (!(lacking > s->min_gain_share * found.amplitude))
            continue;
        size_t slot = 0;
        while (slot < s->onset_partials_max && !young[slot])
            slot++;
        if (slot < s->onset_partials_max) {
            young[slot] = 0;
            partials[slot].age = 1.0;
        } else {
            for (slot = 0; slot < s->onset_partials_max && partials[slot].sounds != 0.0;)
                slot++;
            if (slot == s->onset_partials_max)
                break;
            partials[slot] = (OnsetPartial){.sounds = 1.0, .hz = found.hz, .phase = s->start_phase};
            partials[slot].joins = tracking_join(s, slots, (double)ticks_left * s->tick_s,
                                              &partials[slot].hz, &partials[slot].phase);
        }
        partials[slot].bands = groups[which];
        partials[slot].base = base;
        partials[slot].weight = found.weight;
        partials[slot].goal = lacking;
    }
    for (size_t slot = 0; slot < s->onset_partials_max; slot++)
        if (young[slot])
            partials[slot].age = (double)s->heard_ticks;
}

/* Update a partial's goal and weight from the latest estimate; return the partial's new frequency in Hz. */
static double follow(const Settings *s, OnsetPartial *partials, OnsetPartial *one, OnsetSources sources,
                     const Slots *slots)
{
    const int is_young = one->age > 0.0 && one->age < (double)s->heard_ticks;
    if (!is_young || !onsets_are_measured(s, sources.onsets))
        return one->hz;
    const OnsetTone found = estimate(s, sources, one->bands);
    /* If other partials already have nearly this amplitude, the small difference may be a rounding error. */
    const double lacking = found.amplitude - one->base;
    const int little = lacking < s->min_held_share * found.amplitude || lacking < 0.0;
    const double wanted = little ? 0.0 : lacking;
    one->weight = found.weight;
    one->goal += smaller(wanted - one->goal, room(s, partials, slots));
    return one->joins == 0.0 ? found.hz : one->hz;
}

void onset_partials_play(const Settings *s, OnsetPartial *partials, OnsetSources sources, const Slots *slots,
                Glides *glides)
{
    for (size_t slot = 0; slot < s->onset_partials_max; slot++)
        if (partials[slot].sounds != 0.0)
            glides->end_hz[slot] = follow(s, partials, &partials[slot], sources, slots);
    for (size_t slot = 0; slot < s->onset_partials_max; slot++) {
        OnsetPartial *one = &partials[slot];
        if (one->sounds == 0.0) {
            glides->start_amplitude[slot] = glides->end_amplitude[slot] = 0.0;
            continue;
        }
        const double hz = glides->end_hz[slot];
        const size_t share = (size_t)smaller(one->age, (double)(s->rise_shares.length - 1));
        const double goal = one->goal * s->rise_shares.at[share];
        glides->start_hz[slot] = one->hz;
        glides->start_amplitude[slot] = one->amplitude;
        glides->end_amplitude[slot] = goal;
        glides->start_phase[slot] = one->phase;
        const double phase = one->phase + 0.5 * s->tick_s * (one->hz + hz);
        one->phase = phase - floor(phase);
        one->hz = hz;
        one->amplitude = goal;
        one->age = smaller(one->age + 1.0, (double)s->heard_ticks + (double)s->rise_shares.length);
        if (goal == 0.0 && one->age > (double)s->heard_ticks)
            memset(one, 0, sizeof *one);
    }
}

void onset_partials_hand_over(const Settings *s, OnsetPartial *partials, const Onsets *onsets, Slots *slots)
{
    for (size_t slot = 0; slot < s->onset_partials_max; slot++) {
        OnsetPartial *one = &partials[slot];
        if (one->sounds == 0.0 || one->age < (double)s->heard_ticks)
            continue;
        const double power = onsets_power(s, onsets, one->bands);
        const Held held = {one->goal + one->base, one->weight, power, one->bands, 0.0};
        tracking_adopt(s, slots, one->hz, one->phase, one->amplitude, held);
        memset(one, 0, sizeof *one);
    }
}
