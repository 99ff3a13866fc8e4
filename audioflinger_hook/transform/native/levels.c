/* How strong each partial of a hop is: the law of level, loudness, speech and the ceiling. */

#include "levels.h"

#include "common.h"
#include "scaling.h"

/* Set the amplitudes of what was found by the level law: P_k r_k over a full-scale tone's r, or by
 * the energy of each. */
static void strengthen(Live *live, size_t count)
{
    const Settings *s = &live->settings;
    double sum_r = 0.0;
    for (size_t one = 0; one < count; one++)
        sum_r += live->found.r[one];
    for (size_t one = 0; one < count; one++) {
        const double r = live->found.r[one];
        live->amplitude[one] = s->by_energy ? sqrt(live->found.amplitude[one] * r / s->full_scale_r)
                                            : r * r / (sum_r * s->full_scale_r);
        /* What is felt well takes less of the room under full scale. */
        if (loudness_is_on(s))
            live->amplitude[one] *= sqrt(table_at(s->felt_weights, s->gain_step_hz, live->hz[one]));
    }
}

static void lower_speech(Live *live, const Voice *voice, size_t count)
{
    for (size_t one = 0; one < count; one++) {
        const double left =
            speech_gain(&live->settings, voice->speech, live->found.audio_hz[one]);
        live->found.amplitude[one] *= left;
        live->found.r[one] *= left;
    }
}

int levels_set(Live *live, Voice *voice, double strength, size_t count)
{
    const Settings *s = &live->settings;
    double total = 0.0;
    strengthen(live, count);
    double gain = 1.0;
    if (loudness_is_on(s) && count)
        gain = loudness_gain(s, &voice->follower, strength, live->hz, live->amplitude, count);
    /* Before the law of level, so that what speech loses is not missing from the rest; after the
     * follower, which would turn the rest up. */
    if (s->speech_db > 0.0) {
        lower_speech(live, voice, count);
        strengthen(live, count);
    }
    for (size_t one = 0; one < count; one++)
        total += live->amplitude[one] *= gain;
    if (loudness_is_on(s))
        total = loudness_concentrate(s, live->hz, live->amplitude, count, total);
    const int limited = !(total <= s->ceiling);
    if (limited)
        for (size_t one = 0; one < count; one++)
            live->amplitude[one] *= s->ceiling / total;
    return limited;
}

double levels_left_by_law(const Live *live, size_t count)
{
    double sum_r = 0.0, fourths = 0.0, energy = 0.0;
    if (live->settings.by_energy || !count)
        return 1.0;
    for (size_t one = 0; one < count; one++) {
        const double r = live->found.r[one];
        sum_r += r;
        fourths += r * r * r * r;
        energy += live->found.amplitude[one] * r;
    }
    return sqrt(fourths / (sum_r * sum_r * energy * live->settings.full_scale_r));
}
