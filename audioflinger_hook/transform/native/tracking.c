/* Partials followed from hop to hop: matching, births, deaths, and small changes averaged.
 *
 * A slot is a partial's own where they are nearest to one another and within reach. The operations
 * are those of `partials.py`, in the same order.
 */

#include "tracking.h"

#include "common.h"
#include "space.h"

/* Where a partial goes. */
typedef struct {
    size_t nearest; /* slot that sounds; any where none does */
    size_t slot;    /* its own, or the number of slots where it has none yet */
    double gap_hz;  /* to the nearest; infinite where none sounds */
} Match;

/* The slots that sound, by their place among them. */
typedef struct {
    size_t *slot, *nearest_partial;
    double *hz, *gap_hz;
} Alive;

/* Give every part its place in the memory, or count how much that is where there is none. */
static size_t lay_out(void *memory, size_t partials_max, Match **matches, Alive *alive)
{
    Space space = {memory, 0};
    *matches = taken(&space, partials_max, sizeof(Match));
    alive->slot = taken(&space, partials_max, sizeof(size_t));
    alive->nearest_partial = taken(&space, partials_max, sizeof(size_t));
    alive->hz = taken(&space, partials_max, sizeof(double));
    alive->gap_hz = taken(&space, partials_max, sizeof(double));
    return space.used;
}

size_t tracking_work(size_t partials_max)
{
    Match *matches;
    Alive alive;
    return lay_out(NULL, partials_max, &matches, &alive);
}

int tracking_sounds(const Settings *settings, const Slots *slots)
{
    for (size_t slot = 0; slot < 2 * settings->partials_max; slot++)
        if (slots->alive[slot] != 0.0)
            return 1;
    return 0;
}

/* The share of a change that is followed: all of a clear one, little of a jitter. */
static double followed(const Settings *settings, double relative_change)
{
    return smaller(1.0, settings->steady_gain + relative_change * relative_change);
}

/* Find the slot nearest to each partial, and whether it is its own. */
static void match(const Settings *settings, const Slots *slots, Partials partials, Match *matches,
                  Alive alive)
{
    const size_t none = 2 * settings->partials_max;
    size_t count = 0;
    for (size_t slot = 0; slot < none && count < settings->partials_max; slot++)
        if (slots->alive[slot] != 0.0) {
            alive.slot[count] = slot;
            alive.nearest_partial[count] = 0;
            alive.hz[count] = slots->hz[slot];
            alive.gap_hz[count++] = INFINITY;
        }
    for (size_t one = 0; one < partials.count; one++) {
        size_t nearest = 0;
        double gap_hz = INFINITY;
        for (size_t other = 0; other < count; other++) {
            /* Written so that nothing branches: in noise nobody could foresee which way. */
            const double distance_hz = fabs(partials.hz[one] - alive.hz[other]);
            const int nearer = distance_hz < gap_hz, to_slot = distance_hz < alive.gap_hz[other];
            nearest = nearer ? other : nearest;
            gap_hz = nearer ? distance_hz : gap_hz;
            alive.nearest_partial[other] = to_slot ? one : alive.nearest_partial[other];
            alive.gap_hz[other] = to_slot ? distance_hz : alive.gap_hz[other];
        }
        matches[one].nearest = nearest;
        matches[one].gap_hz = gap_hz;
    }
    for (size_t one = 0; one < partials.count; one++) {
        const double ratio = settings->match_audio_hz / partials.audio_hz[one];
        const double slope_hz = settings->scale_hz + settings->scale_ratio * partials.hz[one];
        const double reach_hz = slope_hz * larger(settings->match_ratio, ratio);
        const size_t nearest = matches[one].nearest;
        const int mutual = count && alive.nearest_partial[nearest] == one;
        matches[one].nearest = count ? alive.slot[nearest] : 0;
        matches[one].slot = mutual && matches[one].gap_hz <= reach_hz ? matches[one].nearest : none;
    }
}

/* Give those without a slot the lowest free ones.
 *
 * One peak that wavers between one and two, as a fast chirp's does, would otherwise be in and out
 * of step with itself: so what splits off a partial begins at its phase.
 */
static void bear(const Settings *settings, Slots *slots, Partials partials, Match *matches)
{
    const size_t none = 2 * settings->partials_max;
    size_t free_slot = 0;
    for (size_t one = 0; one < partials.count; one++) {
        if (matches[one].slot < none)
            continue;
        while (slots->alive[free_slot] != 0.0)
            free_slot++;
        const int split = matches[one].gap_hz < settings->split_hz;
        slots->phase[free_slot] = split ? slots->phase[matches[one].nearest] : 0.0;
        slots->hz[free_slot] = partials.hz[one];
        matches[one].slot = free_slot++;
    }
}

static void start_hop(const Settings *settings, const Slots *slots, Glides *glides)
{
    const size_t bytes = 2 * settings->partials_max * sizeof(double);
    memcpy(glides->start_hz, slots->hz, bytes);
    memcpy(glides->start_amplitude, slots->amplitude, bytes);
    memcpy(glides->start_phase, slots->phase, bytes);
    memset(slots->amplitude, 0, bytes);
    memset(slots->alive, 0, bytes);
}

WIDE static void finish_hop(const Settings *settings, Slots *slots, Glides *glides)
{
    const size_t count = 2 * settings->partials_max;
    memcpy(glides->end_hz, slots->hz, count * sizeof(double));
    memcpy(glides->end_amplitude, slots->amplitude, count * sizeof(double));
    /* The mean frequency of a symmetric glide is that of its ends. */
    const double half_hop_s = 0.5 * settings->hop_s;
    for (size_t slot = 0; slot < count; slot++) {
        const double phase =
            slots->phase[slot] + half_hop_s * (glides->start_hz[slot] + slots->hz[slot]);
        slots->phase[slot] = phase - floor(phase);
    }
}

void tracking_follow(const Settings *settings, Slots *slots, Glides *glides, Partials partials,
                     void *work)
{
    Match *matches;
    Alive alive;
    lay_out(work, settings->partials_max, &matches, &alive);
    match(settings, slots, partials, matches, alive);
    bear(settings, slots, partials, matches);
    start_hop(settings, slots, glides);
    for (size_t one = 0; one < partials.count; one++) {
        const size_t slot = matches[one].slot;
        const double hz = slots->hz[slot], change_hz = partials.hz[one] - hz;
        slots->hz[slot] = hz + change_hz * followed(settings, change_hz / settings->steady_hz);
        const double level = glides->start_amplitude[slot];
        const double change = partials.amplitude[one] - level;
        const double steady = settings->steady_ratio * partials.amplitude[one];
        slots->amplitude[slot] = level + change * followed(settings, change / steady);
        slots->alive[slot] = 1.0;
    }
    finish_hop(settings, slots, glides);
}

void tracking_fade(const Settings *settings, Slots *slots, Glides *glides)
{
    start_hop(settings, slots, glides);
    finish_hop(settings, slots, glides);
}

void tracking_rest(const Settings *settings, Glides *glides)
{
    const size_t bytes = 2 * settings->partials_max * sizeof(double);
    memset(glides->start_amplitude, 0, bytes);
    memset(glides->end_amplitude, 0, bytes);
}
