/* The mono mix of a sound's channels, and the sum of powers where it cancels. */

#include "downmix.h"

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

#define GROUP MIX_GROUP

INLINED double smoothed(double before, double share, double power)
{
    return share * power + (1.0 - share) * before;
}

/* Return the mean square of a group, added in this order. */
INLINED double power_of(const double *samples, double guard)
{
    double sums[4];
    for (size_t lane = 0; lane < 4; lane++) {
        const double one = samples[lane] + guard, two = samples[lane + 4] + guard;
        const double three = samples[lane + 8] + guard, four = samples[lane + 12] + guard;
        sums[lane] = (one * one + two * two) + (three * three + four * four);
    }
    return ((sums[0] + sums[2]) + (sums[1] + sums[3])) / GROUP;
}

/* Take note of the powers of a group. */
INLINED MixBalance after_group(const Settings *s, MixBalance old, double of_mean, double of_side)
{
    const MixBalance now = {
        .mean = smoothed(old.mean, s->mix_slow, of_mean),
        .side = smoothed(old.side, s->mix_slow, of_side),
        .newest = smoothed(old.newest, s->mix_newest, of_mean + of_side),
        .start = old.end,
    };
    return now;
}

/* Return the factor on the difference where a group ends. */
INLINED double factor_of(const Settings *s, MixBalance now)
{
    const double both = now.mean + now.side, mean = now.mean + s->mix_evidence * now.newest;
    if (!(mean < s->mix_cancels_from * both))
        return 0.0;
    const double left = s->mix_cancels_from - mean / both;
    const double most = smaller(left / (s->mix_cancels_from - s->mix_cancels_up_to), 1.0);
    return most * most * (3.0 - 2.0 * most);
}

/* Add the difference to some frames of a group, of which so many have been. */
INLINED void add_side(MixBalance now, double filled, double *mono, const double *side, size_t frames)
{
    if (!(now.start > 0.0 || now.end > 0.0))
        return;
    for (size_t frame = 0; frame < frames; frame++) {
        const double share = (filled + (double)frame + 1.0) / GROUP;
        mono[frame] += (now.start + (now.end - now.start) * share) * side[frame];
    }
}

/* Go on with the group under way; return how many frames that took. */
static size_t finish_group(const Settings *settings, DownmixState *powers, double *mono, const double *side,
                    size_t frames)
{
    const size_t filled = (size_t)powers->frames, room = GROUP - filled;
    const size_t part = frames < room ? frames : room;
    memcpy(powers->of_mean + filled, mono, part * sizeof(double));
    memcpy(powers->of_side + filled, side, part * sizeof(double));
    add_side(powers->balance, powers->frames, mono, side, part);
    powers->frames += (double)part;
    if (part == room) {
        const double guard = settings->mix_power_guard;
        powers->balance = after_group(settings, powers->balance, power_of(powers->of_mean, guard),
                                      power_of(powers->of_side, guard));
        powers->balance.end = factor_of(settings, powers->balance);
        powers->frames = 0.0;
    }
    return part;
}

/* Take whole groups, from the start of one on. */
static void take_groups(const Settings *settings, MixBalance *balance, double *mono,
                        const double *side, size_t groups)
{
    const double guard = settings->mix_power_guard;
    MixBalance now = *balance;
    for (; groups; groups--, mono += GROUP, side += GROUP) {
        const double of_mean = power_of(mono, guard), of_side = power_of(side, guard);
        add_side(now, 0.0, mono, side, GROUP);
        now = after_group(settings, now, of_mean, of_side);
        now.end = factor_of(settings, now);
    }
    *balance = now;
}

void downmix_restore(const Settings *settings, DownmixState *powers, double *mono, const double *side,
                     size_t frames)
{
    size_t done = powers->frames > 0.0 ? finish_group(settings, powers, mono, side, frames) : 0;
    const size_t groups = (frames - done) / GROUP;
    take_groups(settings, &powers->balance, mono + done, side + done, groups);
    done += groups * GROUP;
    if (done < frames)
        finish_group(settings, powers, mono + done, side + done, frames - done);
}

void downmix_rest(const Settings *settings, DownmixState *powers, size_t frames)
{
    double mono[GROUP] = {0.0}, side[GROUP] = {0.0};
    while (frames) {
        const DownmixState before = *powers;
        const size_t part = frames < GROUP ? frames : GROUP;
        downmix_restore(settings, powers, mono, side, part);
        frames -= part;
        if (!memcmp(&before, powers, sizeof before))
            frames %= GROUP; /* at rest: whole groups leave it as it is */
    }
}

int downmix_is_possible(const DownmixState *powers)
{
    const double *numbers = (const double *)powers;
    const MixBalance *now = &powers->balance;
    for (size_t which = 0; which < DOWNMIX_STATE_NUMBERS; which++)
        if (!isfinite(numbers[which]))
            return 0;
    return now->mean >= 0.0 && now->side >= 0.0 && now->newest >= 0.0 && now->start >= 0.0 &&
           now->start <= 1.0 && now->end >= 0.0 && now->end <= 1.0 && powers->frames >= 0.0 &&
           powers->frames < GROUP && powers->frames == floor(powers->frames);
}
