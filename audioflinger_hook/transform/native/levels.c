/* Sets the amplitudes of a hop's partials: amplitude mapping, speech suppression, ceiling. */

#include "live.h"
#include "scaling.h"

/* Set each amplitude to P_k r_k / b or, if energy_mapping is set, to sqrt(A_k r_k / b); "Amplitude" in
 * docs/transform.md defines the symbols. If the strength follows loudness, multiply the amplitudes by `tilt`. */
static void strengthen(Live *live, size_t count)
{
    const Settings *s = &live->settings;
    const double sum_r = sum(live->found.r, count);
    for (size_t one = 0; one < count; one++) {
        const double r = live->found.r[one];
        live->amplitude[one] = s->energy_mapping ? sqrt(live->found.amplitude[one] * r / s->full_scale_r)
                                            : r * r / (sum_r * s->full_scale_r);
        if (loudness_is_on(s))
            live->amplitude[one] *= tilt(s, live->hz[one]);
    }
}

static void lower_speech(Live *live, const Channel *channel, size_t count)
{
    for (size_t one = 0; one < count; one++) {
        const double left =
            speech_gain(&live->settings, &channel->speech, live->found.audio_hz[one]);
        live->found.amplitude[one] *= left;
        live->found.r[one] *= left;
    }
}

static double felt_power(const Live *live, size_t count)
{
    const Settings *s = &live->settings;
    double power = 0.0;
    for (size_t one = 0; one < count; one++) {
        const double felt = live->amplitude[one] * table_at(s->felt_weights, s->gain_step_hz, live->hz[one]);
        power += felt * felt;
    }
    return power;
}

int levels_set(Live *live, Channel *channel, size_t count)
{
    const Settings *s = &live->settings;
    const int followed = loudness_is_on(s), lowered = s->speech_db > 0.0;
    strengthen(live, count);
    /* Speech is lowered before the amplitude mapping, so that the shares P_k of other partials rise. */
    if (lowered) {
        const double before = felt_power(live, count);
        lower_speech(live, channel, count);
        strengthen(live, count);
        if (followed && before > 0.0)
            channel->strength.speech_left = smaller(1.0, sqrt(felt_power(live, count) / before));
    }
    const double total = sum(live->amplitude, count);
    const int limited = !followed && !(total <= s->ceiling);
    if (limited)
        for (size_t one = 0; one < count; one++)
            live->amplitude[one] *= s->ceiling / total;
    return limited;
}

double levels_gain(const Live *live, double wanted, size_t count)
{
    const Settings *s = &live->settings;
    const double power = felt_power(live, count), total = sum(live->amplitude, count);
    return power > 0.0 ? smaller(smaller(s->gain_max, wanted / sqrt(power)), s->ceiling / total) : 0.0;
}

double levels_left_by_law(const Live *live, size_t count)
{
    double sum_r = 0.0, fourths = 0.0, energy = 0.0;
    if (live->settings.energy_mapping || !count)
        return 1.0;
    for (size_t one = 0; one < count; one++) {
        const double r = live->found.r[one];
        sum_r += r;
        fourths += r * r * r * r;
        energy += live->found.amplitude[one] * r;
    }
    return sqrt(fourths / (sum_r * sum_r * energy * live->settings.full_scale_r));
}
