/* Merges partials whose vibration frequencies are too close. */

#include "tracking.h"
#include "scaling.h"

static double group_hz(const PartialGroup *group) { return group->weighted_hz / group->power; }

static void add(PartialGroup *group, PartialGroup other)
{
    group->power += other.power;
    group->weighted_hz += other.weighted_hz;
    group->strongest = larger(other.strongest, group->strongest);
}

/* Add each partial to the group with the nearest centre. If that centre is farther than merging_hz, start a
 * new group instead. Return the number of centres. */
static size_t gather(const Settings *s, Merging *merging, size_t centres, Partials partials)
{
    memset(merging->gathered, 0, (centres + partials.count) * sizeof(PartialGroup));
    for (size_t one = 0; one < partials.count; one++) {
        const double hz = partials.hz[one], power = partials.amplitude[one] * partials.amplitude[one];
        size_t nearest = 0;
        double gap_hz = INFINITY;
        for (size_t centre = 0; centre < centres; centre++) {
            const double distance_hz = fabs(hz - merging->centres[centre]);
            if (distance_hz < gap_hz) {
                nearest = centre;
                gap_hz = distance_hz;
            }
        }
        if (!centres || gap_hz > merging_hz(s, merging->centres[nearest])) {
            nearest = centres++;
            merging->centres[nearest] = hz;
        }
        add(&merging->gathered[nearest], (PartialGroup){power, power * hz, power});
    }
    return centres;
}

/* Remove groups without power, and sort the others by frequency; return their number. */
static size_t sort(PartialGroup *groups, size_t count)
{
    size_t kept = 0;
    for (size_t one = 0; one < count; one++) {
        const PartialGroup group = groups[one];
        if (!(group.power > 0.0))
            continue;
        size_t at = kept++;
        for (; at && group_hz(&groups[at - 1]) > group_hz(&group); at--)
            groups[at] = groups[at - 1];
        groups[at] = group;
    }
    return kept;
}

/* Merge the two closest groups while their gap is below merge_again times merging_hz; return the number of
 * remaining groups. */
static size_t join(const Settings *s, PartialGroup *groups, size_t count)
{
    while (count > 1) {
        size_t closest = 0;
        double least = INFINITY;
        for (size_t one = 0; one + 1 < count; one++) {
            const double hz = group_hz(&groups[one]);
            const double gap = (group_hz(&groups[one + 1]) - hz) / merging_hz(s, hz);
            if (gap < least) {
                least = gap;
                closest = one;
            }
        }
        if (least >= s->merge_again)
            break;
        add(&groups[closest], groups[closest + 1]);
        count--;
        for (size_t one = closest + 1; one < count; one++)
            groups[one] = groups[one + 1];
    }
    return count;
}

Partials merging_merge(const Settings *s, Merging *merging, size_t sounding, Partials partials)
{
    PartialGroup *groups = merging->gathered;
    const size_t centres = gather(s, merging, sounding, partials);
    const size_t count = join(s, groups, sort(groups, centres));
    for (size_t one = 0; one < count; one++) {
        merging->merged.hz[one] = group_hz(&groups[one]);
        merging->merged.audio_hz[one] = audio_hz(s, merging->merged.hz[one]);
        merging->merged.amplitude[one] = sqrt(groups[one].power);
        merging->merged.dominance[one] = groups[one].strongest / groups[one].power;
    }
    return (Partials){merging->merged.audio_hz, merging->merged.hz, merging->merged.amplitude, count};
}
