/* Partials followed from hop to hop: matching, births, deaths, and small changes averaged.
 *
 * A slot is a partial's own where they are nearest to one another and within reach.
 */

#include "tracking.h"

#include "scaling.h"

/* Where a partial goes. */
typedef struct {
    size_t nearest; /* slot that sounds; any where none does */
    size_t slot;    /* its own, or the number of slots where it has none yet */
    double gap_hz;  /* to the nearest; infinite where none sounds */
} Match;

/* To each of some what of others is nearest, by its place among them, and how near. */
typedef struct {
    uint64_t *nearest;
    double *gap_hz;
} Neighbours;

/* The slots that sound, by their place among them. */
typedef struct {
    size_t *slot;
    double *hz;
    Neighbours of_slots, of_partials;
} Alive;

static size_t most_alive(const Settings *settings)
{
    return settings->partials_max + settings->onset_partials_max;
}

/* Give every part its place in the memory, or count how much that is where there is none. */
static size_t layout_work(void *memory, const Settings *settings, Match **matches, Alive *alive,
                      Merging *merging)
{
    Arena arena = {memory, 0};
    const size_t partials_max = settings->partials_max, living = most_alive(settings);
    *matches = arena_alloc(&arena, partials_max, sizeof(Match));
    alive->slot = arena_alloc(&arena, living, sizeof(size_t));
    alive->hz = arena_doubles(&arena, living);
    alive->of_slots.nearest = arena_alloc(&arena, living, sizeof(uint64_t));
    alive->of_slots.gap_hz = arena_doubles(&arena, living);
    alive->of_partials.nearest = arena_alloc(&arena, partials_max, sizeof(uint64_t));
    alive->of_partials.gap_hz = arena_doubles(&arena, partials_max);
    merging->centres = arena_doubles(&arena, living + partials_max);
    merging->gathered = arena_alloc(&arena, living + partials_max, sizeof(PartialGroup));
    arena_arrays(&arena, ARRAYS(merging->merged), partials_max);
    return arena.used;
}

size_t tracking_work(const Settings *settings)
{
    Match *matches;
    Alive alive;
    Merging merging;
    return layout_work(NULL, settings, &matches, &alive, &merging);
}

static size_t living(const Settings *settings, const Slots *slots)
{
    size_t count = 0;
    for (size_t slot = 0; slot < tracking_slots(settings); slot++)
        count += slots->alive[slot] != 0.0;
    return count;
}

int tracking_sounds(const Settings *settings, const Slots *slots) { return living(settings, slots) != 0; }

int tracking_holds(const Settings *settings, const Slots *slots)
{
    size_t count = 0;
    for (size_t slot = 0; slot < tracking_slots(settings); slot++)
        count += slots->held_hops[slot] != 0.0;
    return count != 0;
}

double tracking_near_hz(const Settings *settings, double hz)
{
    const double ratio = settings->match_audio_hz / audio_hz(settings, hz);
    const double slope_hz = settings->scale_hz + settings->scale_ratio * hz;
    const double near_hz = settings->onset_reach * slope_hz * larger(settings->match_ratio, ratio);
    return settings->merge_ratio > 0.0 ? larger(near_hz, merging_hz(settings, hz)) : near_hz;
}

double tracking_sounding_near(const Settings *settings, const Slots *slots, double hz)
{
    const double near_hz = tracking_near_hz(settings, hz);
    double total = 0.0;
    for (size_t slot = 0; slot < tracking_slots(settings); slot++)
        if (slots->alive[slot] != 0.0 && fabs(slots->hz[slot] - hz) < near_hz)
            total += slots->amplitude[slot];
    return total;
}

double tracking_join(const Settings *settings, const Slots *slots, double before_end_s, double *hz,
                     double *phase)
{
    if (!(settings->merge_ratio > 0.0))
        return 0.0;
    const size_t none = tracking_slots(settings);
    const double near_hz = tracking_near_hz(settings, *hz);
    size_t found = none;
    double most = settings->joined_from;
    for (size_t slot = 0; slot < none; slot++)
        if (slots->alive[slot] != 0.0 && fabs(slots->hz[slot] - *hz) < near_hz &&
            slots->amplitude[slot] > settings->stronger * most) {
            found = slot;
            most = slots->amplitude[slot];
        }
    if (found == none)
        return 0.0;
    *hz = slots->hz[found];
    const double cycles = slots->phase[found] - *hz * before_end_s;
    *phase = cycles - floor(cycles);
    return 1.0;
}

void tracking_adopt(const Settings *settings, Slots *slots, double hz, double phase,
                    double amplitude, Held held)
{
    if (living(settings, slots) >= most_alive(settings))
        return;
    size_t slot = 0;
    while (slots->alive[slot] != 0.0)
        slot++;
    slots->hz[slot] = hz;
    slots->phase[slot] = phase;
    slots->amplitude[slot] = amplitude;
    slots->alive[slot] = 1.0;
    slots->held_amplitude[slot] = held.amplitude;
    slots->held_weight[slot] = held.weight;
    slots->held_loudness[slot] = held.loudness;
    slots->held_first[slot] = (double)held.group.first;
    slots->held_last[slot] = (double)held.group.last;
    slots->held_hops[slot] = (double)settings->hold_hops + 1.0;
}

/* The share of a change that is followed: all of a clear one, little of a jitter. */
static double weigh_change(const Settings *settings, double relative_change)
{
    return smaller(1.0, settings->steady_gain + relative_change * relative_change);
}

/* Find the nearest of others to each of some; of equals the first. Between a partial and the slot
 * with that place among those alive lies `first_hz` times the place more. Nothing branches: in noise
 * nobody could foresee which way. */
INLINED void nearest_of(const double *restrict hz, size_t count, const double *restrict other_hz,
                        size_t others, double first_hz, double others_first_hz, Neighbours found)
{
    uint64_t *restrict nearest = found.nearest;
    double *restrict gap_hz = found.gap_hz;
    for (size_t one = 0; one < count; one++) {
        nearest[one] = 0;
        gap_hz[one] = INFINITY;
    }
    for (size_t other = 0; other < others; other++)
        for (size_t one = 0; one < count; one++) {
            const double place_hz = first_hz * (double)(uint32_t)one + others_first_hz * (double)other;
            const double distance_hz = fabs(hz[one] - other_hz[other]) + place_hz;
            const int nearer = distance_hz < gap_hz[one];
            nearest[one] = nearer ? other : nearest[one];
            gap_hz[one] = nearer ? distance_hz : gap_hz[one];
        }
}

SIMD_CLONES static void find_neighbours(Partials partials, Alive alive, size_t count, double first_hz)
{
    nearest_of(partials.hz, partials.count, alive.hz, count, 0.0, first_hz, alive.of_partials);
    nearest_of(alive.hz, count, partials.hz, partials.count, first_hz, 0.0, alive.of_slots);
}

/* Find the slot nearest to each partial, and whether it is its own. */
static void match(const Settings *settings, const Slots *slots, Partials partials, Match *matches,
                  Alive alive)
{
    const size_t none = tracking_slots(settings);
    size_t count = 0;
    for (size_t slot = 0; slot < none && count < most_alive(settings); slot++)
        if (slots->alive[slot] != 0.0) {
            alive.slot[count] = slot;
            alive.hz[count++] = slots->hz[slot];
        }
    find_neighbours(partials, alive, count, settings->first_hz);
    for (size_t one = 0; one < partials.count; one++) {
        const double ratio = settings->match_audio_hz / partials.audio_hz[one];
        const size_t nearest = alive.of_partials.nearest[one];
        const int mutual = count && alive.of_slots.nearest[nearest] == one;
        matches[one].nearest = count ? alive.slot[nearest] : 0;
        matches[one].gap_hz = alive.of_partials.gap_hz[one];
        const int held = count && slots->held_hops[matches[one].nearest] > 0.0;
        const double slope_hz = settings->scale_hz + settings->scale_ratio * partials.hz[one];
        double reach_hz = slope_hz * larger(settings->match_ratio, ratio);
        if (settings->merge_ratio > 0.0)
            reach_hz = larger(reach_hz, merging_hz(settings, partials.hz[one]));
        if (held)
            reach_hz *= settings->onset_reach;
        matches[one].slot = mutual && matches[one].gap_hz <= reach_hz ? matches[one].nearest : none;
    }
}

/* Give those without a slot the lowest free ones.
 *
 * A partial that splits off another one begins at its phase. The peak of a fast chirp wavers between one
 * and two, and would be out of step with itself.
 */
static void bear(const Settings *settings, Slots *slots, Partials partials, Match *matches)
{
    const size_t none = tracking_slots(settings);
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

double tracking_loudest_sum(const Settings *settings, const Slots *slots)
{
    return larger(*slots->start_sum, sum(slots->amplitude, tracking_slots(settings)));
}

static void start_hop(const Settings *settings, const Slots *slots, Glides *glides)
{
    const size_t bytes = tracking_slots(settings) * sizeof(double);
    memcpy(glides->start_hz, slots->hz, bytes);
    memcpy(glides->start_amplitude, slots->amplitude, bytes);
    memcpy(glides->start_phase, slots->phase, bytes);
    *slots->start_sum = sum(slots->amplitude, tracking_slots(settings));
    memset(slots->amplitude, 0, bytes);
    memset(slots->alive, 0, bytes);
}

SIMD_CLONES static void finish_hop(const Settings *settings, Slots *slots, Glides *glides)
{
    const size_t count = tracking_slots(settings);
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

/* What a partial that is held is to have now, by what its bands have of late. */
static double hold_amplitude(const Settings *settings, const Slots *slots, size_t slot,
                          const Onsets *onsets)
{
    if (!(slots->held_loudness[slot] > 0.0))
        return 0.0;
    const Group group = {(size_t)slots->held_first[slot], (size_t)slots->held_last[slot]};
    const double share = onsets_loudness(settings, onsets, group) / slots->held_loudness[slot];
    return slots->held_amplitude[slot] * sqrt(smaller(1.0, share));
}

/* What is held of its amplitude now that a window shows what it consists of. */
static double known(const Settings *s, const Slots *slots, double left)
{
    double squares = 0.0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++)
        if (slots->held_hops[slot] != 0.0)
            squares += slots->held_weight[slot] * slots->held_weight[slot];
    return squares <= left * left ? 1.0 : left / sqrt(squares);
}

/* Keep what is held at its amplitude, as far as there is room and the law leaves it. */
static void hold(const Settings *s, Slots *slots, double room, double left, const Onsets *onsets)
{
    const double share_known = known(s, slots, left);
    double total = 0.0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++) {
        slots->lacking[slot] = 0.0;
        if (slots->held_hops[slot] == 0.0)
            continue;
        const double wanted = hold_amplitude(s, slots, slot, onsets);
        const int full = slots->alive[slot] == 0.0 && living(s, slots) >= most_alive(s);
        slots->held_hops[slot] -= 1.0;
        if (full || slots->held_hops[slot] == 0.0 ||
            wanted < s->min_held_share * slots->held_amplitude[slot]) {
            slots->held_hops[slot] = 0.0;
            continue;
        }
        slots->alive[slot] = 1.0;
        const double near = tracking_sounding_near(s, slots, slots->hz[slot]);
        slots->lacking[slot] = larger(0.0, wanted * share_known - near);
        total += slots->lacking[slot];
    }
    const double share = total <= room ? 1.0 : room / total;
    for (size_t slot = 0; slot < tracking_slots(s); slot++)
        slots->amplitude[slot] += share * slots->lacking[slot];
}

void tracking_follow(const Settings *settings, Slots *slots, Glides *glides, Partials partials,
                     double room, double left, const Onsets *onsets, void *work)
{
    Match *matches;
    Alive alive;
    Merging merging;
    layout_work(work, settings, &matches, &alive, &merging);
    const int merges = settings->merge_ratio > 0.0 && partials.count;
    if (merges) {
        size_t sounding = 0;
        for (size_t slot = 0; slot < tracking_slots(settings); slot++)
            if (slots->alive[slot] != 0.0 && sounding < most_alive(settings))
                merging.centres[sounding++] = slots->hz[slot];
        partials = merging_merge(settings, &merging, sounding, partials);
    }
    match(settings, slots, partials, matches, alive);
    bear(settings, slots, partials, matches);
    start_hop(settings, slots, glides);
    for (size_t one = 0; one < partials.count; one++) {
        const size_t slot = matches[one].slot;
        const double hz = slots->hz[slot], change_hz = partials.hz[one] - hz;
        const double share = weigh_change(settings, change_hz / settings->steady_hz);
        slots->hz[slot] = hz + change_hz * share * (merges ? merging.merged.dominance[one] : 1.0);
        const double level = glides->start_amplitude[slot];
        const double change = partials.amplitude[one] - level;
        const double steady = settings->steady_ratio * partials.amplitude[one];
        slots->amplitude[slot] = level + change * weigh_change(settings, change / steady);
        slots->alive[slot] = 1.0;
    }
    hold(settings, slots, room, left, onsets);
    finish_hop(settings, slots, glides);
}

void tracking_fade(const Settings *settings, Slots *slots, Glides *glides)
{
    start_hop(settings, slots, glides);
    memset(slots->held_hops, 0, tracking_slots(settings) * sizeof(double));
    finish_hop(settings, slots, glides);
}

void tracking_rest(const Settings *settings, Glides *glides)
{
    const size_t bytes = tracking_slots(settings) * sizeof(double);
    memset(glides->start_amplitude, 0, bytes);
    memset(glides->end_amplitude, 0, bytes);
}
