/* Tracks partials from hop to hop: matching, start, end, and smoothing of small changes. A slot continues a
 * partial if the two are nearest to each other in frequency, within a maximum distance. */

#include "tracking.h"
#include "scaling.h"

static size_t most_alive(const Settings *s) { return s->partials_max + s->onset_partials_max; }

TrackingWork tracking_layout(const Settings *s, Arena *arena)
{
    const size_t partials_max = s->partials_max, living = most_alive(s);
    TrackingWork work = {
        .matches = arena_alloc(arena, partials_max, sizeof(Match)),
        .alive.slot = arena_alloc(arena, living, sizeof(size_t)),
        .alive.hz = arena_doubles(arena, living),
        .alive.of_slots = {arena_alloc(arena, living, sizeof(uint64_t)), arena_doubles(arena, living)},
        .alive.of_partials = {arena_alloc(arena, partials_max, sizeof(uint64_t)),
                              arena_doubles(arena, partials_max)},
        .merging.centres = arena_doubles(arena, living + partials_max),
        .merging.gathered = arena_alloc(arena, living + partials_max, sizeof(PartialGroup)),
    };
    arena_arrays(arena, ARRAYS(work.merging.merged), partials_max);
    return work;
}

static size_t count_alive(const Settings *s, const Slots *slots)
{
    size_t count = 0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++)
        count += slots->alive[slot] != 0.0;
    return count;
}

int tracking_sounds(const Settings *s, const Slots *slots) { return count_alive(s, slots) != 0; }

int tracking_holds(const Settings *s, const Slots *slots)
{
    for (size_t slot = 0; slot < tracking_slots(s); slot++)
        if (slots->held[slot].hops != 0.0)
            return 1;
    return 0;
}

double tracking_near_hz(const Settings *s, double hz)
{
    const double ratio = s->match_audio_hz / audio_hz(s, hz);
    const double slope_hz = s->scale_hz + s->scale_ratio * hz;
    const double near_hz = s->onset_reach * slope_hz * larger(s->match_ratio, ratio);
    return s->merge_ratio > 0.0 ? larger(near_hz, merging_hz(s, hz)) : near_hz;
}

double tracking_sounding_near(const Settings *s, const Slots *slots, double hz)
{
    const double near_hz = tracking_near_hz(s, hz);
    double total = 0.0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++)
        if (slots->alive[slot] != 0.0 && fabs(slots->hz[slot] - hz) < near_hz)
            total += slots->amplitude[slot];
    return total;
}

double tracking_join(const Settings *s, const Slots *slots, double before_end_s, double *hz, double *phase)
{
    if (!(s->merge_ratio > 0.0))
        return 0.0;
    const size_t none = tracking_slots(s);
    const double near_hz = tracking_near_hz(s, *hz);
    size_t found = none;
    double most = s->joined_from;
    for (size_t slot = 0; slot < none; slot++)
        if (slots->alive[slot] != 0.0 && fabs(slots->hz[slot] - *hz) < near_hz &&
            slots->amplitude[slot] > s->stronger * most) {
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

void tracking_adopt(const Settings *s, Slots *slots, double hz, double phase, double amplitude, Held held)
{
    if (count_alive(s, slots) >= most_alive(s))
        return;
    size_t slot = 0;
    while (slots->alive[slot] != 0.0)
        slot++;
    slots->hz[slot] = hz;
    slots->phase[slot] = phase;
    slots->amplitude[slot] = amplitude;
    slots->alive[slot] = 1.0;
    held.hops = (double)s->hold_hops + 1.0;
    slots->held[slot] = held;
}

/* Return the share of a change that a slot follows: 1 for large changes, steady_gain for the smallest. */
static double weigh_change(const Settings *s, double relative_change)
{
    return smaller(1.0, s->steady_gain + relative_change * relative_change);
}

/* Find the nearest of other_hz for each frequency in hz. A tiny distance per index (`first_hz`,
 * `others_first_hz`) breaks ties. In noise, branches would be unpredictable, so the inner loop has
 * none. */
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

/* Find each partial's nearest sounding slot, and whether that slot continues the partial. */
static void match(const Settings *s, const Slots *slots, Partials partials, Match *matches,
                  Alive alive, size_t count)
{
    const size_t none = tracking_slots(s);
    find_neighbours(partials, alive, count, s->first_hz);
    for (size_t one = 0; one < partials.count; one++) {
        const double ratio = s->match_audio_hz / partials.audio_hz[one];
        const size_t nearest = alive.of_partials.nearest[one];
        const int mutual = count && alive.of_slots.nearest[nearest] == one;
        matches[one].nearest = count ? alive.slot[nearest] : 0;
        matches[one].gap_hz = alive.of_partials.gap_hz[one];
        const int held = count && slots->held[matches[one].nearest].hops > 0.0;
        const double slope_hz = s->scale_hz + s->scale_ratio * partials.hz[one];
        double reach_hz = slope_hz * larger(s->match_ratio, ratio);
        if (s->merge_ratio > 0.0)
            reach_hz = larger(reach_hz, merging_hz(s, partials.hz[one]));
        if (held)
            reach_hz *= s->onset_reach;
        matches[one].slot = mutual && matches[one].gap_hz <= reach_hz ? matches[one].nearest : none;
    }
}

/* Give new partials the lowest free slots. A new partial less than split_hz from a sounding slot copies this
 * slot's phase. Without this, the two partials of a fast chirp, whose peak splits at times, could cancel
 * each other. */
static void bear(const Settings *s, Slots *slots, Partials partials, Match *matches)
{
    const size_t none = tracking_slots(s);
    size_t free_slot = 0;
    for (size_t one = 0; one < partials.count; one++) {
        if (matches[one].slot < none)
            continue;
        while (slots->alive[free_slot] != 0.0)
            free_slot++;
        const int split = matches[one].gap_hz < s->split_hz;
        slots->phase[free_slot] = split ? slots->phase[matches[one].nearest] : 0.0;
        slots->hz[free_slot] = partials.hz[one];
        matches[one].slot = free_slot++;
    }
}

double tracking_loudest_sum(const Settings *s, const Slots *slots)
{
    return larger(slots->start_sum, sum(slots->amplitude, tracking_slots(s)));
}

static void start_hop(const Settings *s, Slots *slots, Glides *glides)
{
    const size_t bytes = tracking_slots(s) * sizeof(double);
    memcpy(glides->start_hz, slots->hz, bytes);
    memcpy(glides->start_amplitude, slots->amplitude, bytes);
    memcpy(glides->start_phase, slots->phase, bytes);
    slots->start_sum = sum(slots->amplitude, tracking_slots(s));
    memset(slots->amplitude, 0, bytes);
    memset(slots->alive, 0, bytes);
}

SIMD_CLONES static void finish_hop(const Settings *s, Slots *slots, Glides *glides)
{
    const size_t count = tracking_slots(s);
    memcpy(glides->end_hz, slots->hz, count * sizeof(double));
    memcpy(glides->end_amplitude, slots->amplitude, count * sizeof(double));
    /* The mean frequency of a symmetric glide is the mean of the frequencies at both ends. */
    const double half_hop_s = 0.5 * s->hop_s;
    for (size_t slot = 0; slot < count; slot++) {
        const double phase =
            slots->phase[slot] + half_hop_s * (glides->start_hz[slot] + slots->hz[slot]);
        slots->phase[slot] = phase - floor(phase);
    }
}

/* Return a held partial's amplitude, which falls with the square root of the recent power of its bands. */
static double hold_amplitude(const Settings *s, const Held *held, const Onsets *onsets)
{
    if (!(held->power > 0.0))
        return 0.0;
    return held->amplitude * sqrt(smaller(1.0, onsets_power(s, onsets, held->bands) / held->power));
}

/* Return the factor, at most 1, that limits the Euclidean norm of the held partials' weights to `left`. */
static double known(const Settings *s, const Slots *slots, double left)
{
    double squares = 0.0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++)
        if (slots->held[slot].hops != 0.0)
            squares += slots->held[slot].weight * slots->held[slot].weight;
    return squares <= left * left ? 1.0 : left / sqrt(squares);
}

/* Raise the amplitudes of held partials, as far as `room` and `left` (see `tracking_follow`) allow. */
static void hold(const Settings *s, Slots *slots, double room, double left, const Onsets *onsets)
{
    const double share_known = known(s, slots, left);
    double total = 0.0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++) {
        Held *held = &slots->held[slot];
        slots->lacking[slot] = 0.0;
        if (held->hops == 0.0)
            continue;
        const double wanted = hold_amplitude(s, held, onsets);
        const int full = slots->alive[slot] == 0.0 && count_alive(s, slots) >= most_alive(s);
        held->hops -= 1.0;
        if (full || held->hops == 0.0 || wanted < s->min_held_share * held->amplitude) {
            held->hops = 0.0;
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

void tracking_follow(const Settings *s, Slots *slots, Glides *glides, Partials partials,
                     double room, double left, const Onsets *onsets, TrackingWork *work)
{
    Match *matches = work->matches;
    Merging *merging = &work->merging;
    const int merges = s->merge_ratio > 0.0 && partials.count;
    size_t sounding = 0;
    for (size_t slot = 0; slot < tracking_slots(s) && sounding < most_alive(s); slot++)
        if (slots->alive[slot] != 0.0) {
            work->alive.slot[sounding] = slot;
            work->alive.hz[sounding++] = slots->hz[slot];
        }
    if (merges) {
        memcpy(merging->centres, work->alive.hz, sounding * sizeof(double));
        partials = merging_merge(s, merging, sounding, partials);
    }
    match(s, slots, partials, matches, work->alive, sounding);
    bear(s, slots, partials, matches);
    start_hop(s, slots, glides);
    for (size_t one = 0; one < partials.count; one++) {
        const size_t slot = matches[one].slot;
        const double hz = slots->hz[slot], change_hz = partials.hz[one] - hz;
        const double share = weigh_change(s, change_hz / s->steady_hz);
        slots->hz[slot] = hz + change_hz * share * (merges ? merging->merged.dominance[one] : 1.0);
        const double level = glides->start_amplitude[slot];
        const double change = partials.amplitude[one] - level;
        const double steady = s->steady_ratio * partials.amplitude[one];
        slots->amplitude[slot] = level + change * weigh_change(s, change / steady);
        slots->alive[slot] = 1.0;
    }
    hold(s, slots, room, left, onsets);
    finish_hop(s, slots, glides);
}

void tracking_fade(const Settings *s, Slots *slots, Glides *glides)
{
    start_hop(s, slots, glides);
    memset(slots->held, 0, tracking_slots(s) * sizeof(Held));
    finish_hop(s, slots, glides);
}

void tracking_rest(const Settings *s, Glides *glides)
{
    const size_t bytes = tracking_slots(s) * sizeof(double);
    memset(glides->start_amplitude, 0, bytes);
    memset(glides->end_amplitude, 0, bytes);
}
