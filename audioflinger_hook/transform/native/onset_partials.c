#include "onset_partials.h"

#include "loudness.h"
#include "scaling.h"
#include "synthesis.h"

int onset_partials_sounds(const Settings *settings, const OnsetPartial *partials)
{
    for (size_t slot = 0; slot < settings->onset_partials_max; slot++)
        if (partials[slot].sounds != 0.0)
            return 1;
    return 0;
}

static Group group_of(const OnsetPartial *one)
{
    return (Group){(size_t)one->first_band, (size_t)one->last_band};
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

/* What all sums of amplitudes leave under the ceiling; where loudness is followed, that is for the
 * oscillators to keep. */
static double room(const Settings *settings, const OnsetPartial *partials, const Slots *slots)
{
    if (loudness_is_on(settings))
        return INFINITY;
    double goals = 0.0;
    for (size_t slot = 0; slot < settings->onset_partials_max; slot++)
        goals += partials[slot].sounds != 0.0 ? partials[slot].goal : 0.0;
    return larger(0.0, settings->ceiling - (tracking_loudest_sum(settings, slots) + goals));
}

static double sounding_near(const Settings *settings, const OnsetPartial *partials, double hz)
{
    const double near_hz = tracking_near_hz(settings, hz);
    double base = 0.0;
    for (size_t slot = 0; slot < settings->onset_partials_max; slot++)
        if (partials[slot].sounds != 0.0 && fabs(partials[slot].hz - hz) < near_hz)
            base += partials[slot].goal;
    return base;
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
                            sounding_near(s, partials, found.hz);
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
        partials[slot].first_band = (double)groups[which].first;
        partials[slot].last_band = (double)groups[which].last;
        partials[slot].base = base;
        partials[slot].weight = found.weight;
        partials[slot].goal = lacking;
    }
    for (size_t slot = 0; slot < s->onset_partials_max; slot++)
        if (young[slot])
            partials[slot].age = (double)s->heard_ticks;
}

/* Let a partial's goal follow what has been measured of its onset; return its new frequency. */
static double follow(const Settings *s, OnsetPartial *partials, OnsetPartial *one, OnsetSources sources,
                     const Slots *slots)
{
    const int is_young = one->age > 0.0 && one->age < (double)s->heard_ticks;
    if (!is_young || !onsets_are_measured(s, sources.onsets))
        return one->hz;
    const OnsetTone found = estimate(s, sources, group_of(one));
    /* Of a sound that is there already rounding leaves nothing, or next to nothing. */
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
        const Held held = {one->goal + one->base, one->weight,
                           onsets_loudness(s, onsets, group_of(one)), group_of(one)};
        tracking_adopt(s, slots, one->hz, one->phase, one->amplitude, held);
        memset(one, 0, sizeof *one);
    }
}
