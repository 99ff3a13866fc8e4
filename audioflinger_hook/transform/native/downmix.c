/* The mono mix of a sound's channels, and the sum of powers where it cancels. */

#include "downmix.h"

#include "common.h"

/* ------------------------------------------------------------------------------------- weights */

/* The table holds one layout after another: the number of its channels, then both rows. */
const double *downmix_weights(const Settings *settings, size_t channels)
{
    const Table *table = &settings->mix_weights;
    for (size_t at = 0; at < table->length;) {
        const size_t count = (size_t)table->at[at];
        if (count == channels)
            return table->at + at + 1;
        at += 1 + 2 * count;
    }
    return NULL;
}

int downmix_is_table(Table table)
{
    for (size_t at = 0; at < table.length;) {
        const double count = table.at[at], room = (double)(table.length - at - 1) / 2.0;
        if (!(count >= 1.0 && count <= room && count == floor(count)))
            return 0;
        at += 1 + 2 * (size_t)count;
    }
    return 1;
}

/* -------------------------------------------------------------------------------------- powers */

INLINED double smoothed(double before, double share, double power)
{
    return share * power + (1.0 - share) * before;
}

INLINED void note_powers(const Settings *s, MixPowers *powers, double of_mean, double of_side)
{
    powers->mean = smoothed(powers->mean, s->mix_slow, of_mean);
    powers->side = smoothed(powers->side, s->mix_slow, of_side);
    powers->newest = smoothed(powers->newest, s->mix_newest, of_mean + of_side);
}

void downmix_restore(const Settings *settings, MixPowers *powers, double *mono, const double *side,
                     size_t frames)
{
    const Settings s = *settings;
    MixPowers held = *powers;
    for (size_t frame = 0; frame < frames; frame++) {
        const double of_mean = mono[frame] + s.mix_power_guard;
        const double of_side = side[frame] + s.mix_power_guard;
        note_powers(&s, &held, of_mean * of_mean, of_side * of_side);
        const double both = held.mean + held.side;
        const double mean = held.mean + s.mix_evidence * held.newest;
        if (mean < s.mix_cancels_from * both) {
            const double left = s.mix_cancels_from - mean / both;
            const double most = smaller(left / (s.mix_cancels_from - s.mix_cancels_up_to), 1.0);
            mono[frame] += most * most * (3.0 - 2.0 * most) * side[frame];
        }
    }
    *powers = held;
}

void downmix_rest(const Settings *settings, MixPowers *powers, size_t frames)
{
    const double power = settings->mix_power_guard * settings->mix_power_guard;
    for (size_t frame = 0; frame < frames; frame++) {
        const MixPowers before = *powers;
        note_powers(settings, powers, power, power);
        if (!memcmp(&before, powers, sizeof before))
            return; /* at rest: the other frames leave it as this one has */
    }
}

int downmix_is_possible(const MixPowers *powers)
{
    return isfinite(powers->mean) && powers->mean >= 0.0 && isfinite(powers->side) &&
           powers->side >= 0.0 && isfinite(powers->newest) && powers->newest >= 0.0;
}
