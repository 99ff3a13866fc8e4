/* Predicts excursion, level and current of one actuator, and bounds its gain. */

#include "governor.h"

#define ROUNDING 1e-6 /* allowed rounding error, as a fraction of a limit */
#define TOGETHER 1e-9 /* an excursion below this fraction of its limit counts as 0 */
#define MECHANICAL 3  /* number of the actuator's states; the amplifier's (last output, filters) follow */

enum { FALL, RISE };
enum { FIXED, PER_GAIN, UNGOVERNED };

void governor_layout(Governor *g, const ProtectionDesign *d, Arena *arena)
{
    const size_t states = d->models * WHOLE_LANES(d->states);
    const size_t watched = WHOLE_LANES(d->watched), points = WHOLE_LANES(d->tail_points);
    const size_t frames = WHOLE_LANES(d->frames), moved = d->models * (2 * watched + points);
    const size_t longest = points > frames ? points : frames;
    const size_t quantities = moved + 2 * frames * (1 + d->currents);
    g->design = d;
    g->state = arena_doubles(arena, states);
    g->ungoverned = arena_doubles(arena, states);
    for (size_t part = 0; part < PARTS; part++) {
        g->end[part] = arena_doubles(arena, states);
        g->ends[part] = arena_doubles(arena, WHOLE_LANES(d->states));
    }
    g->column = arena_doubles(arena, longest);
    g->spare = arena_doubles(arena, longest);
    g->fixed = arena_doubles(arena, quantities);
    g->per_gain = arena_doubles(arena, quantities);
    for (size_t which = 0; which < 2; which++) {
        Block *block = &g->blocks[which];
        g->scaled[which] = arena_doubles(arena, ROW_FRAMES(d->frames));
        block->drive = arena_doubles(arena, ROW_FRAMES(d->frames));
        for (size_t half = 0; half < 2; half++) {
            block->excursion[half] = arena_doubles(arena, d->models * watched);
            block->state[half] = arena_doubles(arena, states);
            block->current[half] = arena_doubles(arena, d->currents * frames);
        }
    }
}

void governor_rest(Governor *g)
{
    const size_t states = g->design->models * WHOLE_LANES(g->design->states);
    memset(g->state, 0, states * sizeof(double));
    memset(g->ungoverned, 0, states * sizeof(double));
    g->is_ungoverned_equal = 1;
    g->gain = 1.0;
}

void governor_reset(Governor *g)
{
    const size_t row_bytes = ROW_FRAMES(g->design->frames) * sizeof(double);
    governor_rest(g);
    for (size_t which = 0; which < 2; which++) {
        memset(g->blocks[which].drive, 0, row_bytes);
        memset(g->scaled[which], 0, row_bytes);
        g->blocks[which].loudest = 0.0;
        g->blocks[which].has_responses = 0;
    }
    g->known = 0;
}

void governor_take(Governor *g)
{
    coming_block(g)->loudest = largest(coming_block(g)->drive, WHOLE_LANES(g->design->frames));
    coming_block(g)->has_responses = 0;
}

/* Compute a block's responses to a gain that falls from 1 to 0 and to a gain that rises from 0 to 1. */
SIMD_CLONES static void compute_responses(const ProtectionDesign *d, Block *block, double *fall,
                                          double *rise)
{
    const size_t frames = d->frames, row_frames = ROW_FRAMES(frames);
    for (size_t frame = 0; frame < frames; frame++) {
        const double share = (double)(frame + 1) / (double)frames;
        fall[frame] = block->drive[frame] * (1.0 - share);
        rise[frame] = block->drive[frame] * share;
    }
    const double *response = d->excursion_by_drive;
    for (size_t model = 0; model < d->models; model++, response += row_frames)
        for (size_t row = 0; row < d->watched; row++) {
            const size_t back = (d->watched - 1 - row) * d->stride;
            const size_t at = model * WHOLE_LANES(d->watched) + row;
            two_products(response + back, fall, rise, frames - back, &block->excursion[FALL][at],
                         &block->excursion[RISE][at]);
        }
    response = d->state_by_drive;
    for (size_t model = 0; model < d->models; model++)
        for (size_t one = 0; one < d->states; one++, response += row_frames) {
            const size_t at = model * WHOLE_LANES(d->states) + one;
            two_products(response, fall, rise, frames, &block->state[FALL][at], &block->state[RISE][at]);
        }
    response = d->current_by_drive;
    for (size_t model = 0; model < d->currents; model++, response += row_frames)
        for (size_t frame = 0; frame < frames; frame++) {
            const size_t at = model * WHOLE_LANES(frames) + frame;
            two_products(response + (frames - 1 - frame), fall, rise, frame + 1,
                         &block->current[FALL][at], &block->current[RISE][at]);
        }
    block->has_responses = 1;
}

/* Return an upper bound on the excursion from now on, as a fraction of the limit. The bound adds the effects
 * of actuator energy, last amplifier output, amplifier state and drive. minus: state to subtract, or NULL.
 * drive: largest |drive| from now on. */
static double free_excursion(const ProtectionDesign *d, const double *state, const double *minus,
                             double drive)
{
    double most = 0.0;
    for (size_t model = 0; model < d->models; model++) {
        double energy = 0.0, amplifier = 0.0, last = 0.0;
        for (size_t one = 0; one < d->states; one++) {
            const size_t at = model * WHOLE_LANES(d->states) + one;
            const double value = state[at] - (minus ? minus[at] : 0.0);
            if (one < MECHANICAL)
                energy += value * value;
            else if (one == MECHANICAL)
                last = fabs(value);
            else
                amplifier += value * value;
        }
        double found = d->swing[model] * (sqrt(energy) + d->last_kick[model] * last);
        if (amplifier > 0.0)
            found += d->ring[model] * sqrt(amplifier);
        if (drive > 0.0)
            found += d->reach[model] * drive;
        if (!(found <= most))
            most = found;
        if (isnan(most))
            break;
    }
    return most;
}

/* Reserve places for `count` limited quantities a + g b: those of a at *fixed, those of b at *per_gain. */
INLINED void next_quantities(Governor *g, size_t count, double **fixed, double **per_gain)
{
    *fixed = g->fixed + g->quantities;
    *per_gain = g->per_gain + g->quantities;
    g->quantities += count;
}

/* Compute a model's response to the known block. FIXED: the gain falls from g->gain to 0. UNGOVERNED: the gain
 * is 1. */
INLINED void pass_block(const Governor *g, const double *by_state, size_t rows, const double *state,
                        const double *ungoverned, const double *fall, const double *rise, double *const *out)
{
    apply(by_state, rows, g->design->states, state, out[FIXED]);
    apply(by_state, rows, g->design->states, ungoverned, out[UNGOVERNED]);
    add(out[FIXED], fall, g->gain, rows);
    add(out[UNGOVERNED], fall, 1.0, rows);
    add(out[UNGOVERNED], rise, 1.0, rows);
}

/* Append the excursion to the limited quantities: in the known block, in the coming block, and in the free
 * oscillation after both. */
INLINED void limit_excursion(Governor *g, const double *ungoverned, double *demand)
{
    const ProtectionDesign *d = g->design;
    const size_t states = d->states, points = WHOLE_LANES(d->tail_points);
    const size_t watched = WHOLE_LANES(d->watched), state_rows = WHOLE_LANES(states);
    for (size_t model = 0; model < d->models; model++) {
        const size_t first = model * state_rows, row = model * watched;
        const double *by_state = d->excursion_by_state + model * states * watched;
        const double *advance = d->state_by_state + model * states * state_rows;
        const double *tail = d->tail_by_state + model * states * points;
        const Block *known = known_block(g);
        const double *fall = known->excursion[FALL] + row, *rise = known->excursion[RISE] + row;
        double *out[PARTS] = {NULL, NULL, g->column};
        double *const end[PARTS] = {g->end[0] + first, g->end[1] + first, g->end[2] + first};
        const double *const from[PARTS] = {end[0], end[1], end[2]};
        const double *const last[PARTS] = {g->ends[0], g->ends[1], g->ends[2]};

        next_quantities(g, watched, &out[FIXED], &out[PER_GAIN]);
        pass_block(g, by_state, watched, g->state + first, ungoverned + first, fall, rise, out);
        memcpy(out[PER_GAIN], rise, watched * sizeof(double));
        *demand = larger(largest(out[UNGOVERNED], watched), *demand);

        const double *to_0 = known->state[FALL] + first, *from_0 = known->state[RISE] + first;
        pass_block(g, advance, state_rows, g->state + first, ungoverned + first, to_0, from_0, end);
        memcpy(end[PER_GAIN], from_0, state_rows * sizeof(double));

        next_quantities(g, watched, &out[FIXED], &out[PER_GAIN]);
        apply_to(PARTS, by_state, watched, states, from, out);
        apply_to(PARTS, advance, state_rows, states, from, g->ends);
        for (size_t part = PER_GAIN; part <= UNGOVERNED; part++) {
            add(out[part], coming_block(g)->excursion[FALL] + row, 1.0, watched);
            add(g->ends[part], coming_block(g)->state[FALL] + first, 1.0, state_rows);
        }
        *demand = larger(largest(out[UNGOVERNED], watched), *demand);

        next_quantities(g, points, &out[FIXED], &out[PER_GAIN]);
        apply_to(PARTS, tail, points, states, last, out);
        *demand = larger(largest(out[UNGOVERNED], points), *demand);
    }
}

/* Append the level of the drive in the known and the coming block to the limited quantities. */
INLINED void limit_level(Governor *g, double *demand)
{
    const ProtectionDesign *d = g->design;
    for (size_t block = 0; block < 2; block++) {
        const double *drive = block ? coming_block(g)->drive : known_block(g)->drive;
        double *fixed, *per_gain;
        next_quantities(g, WHOLE_LANES(d->frames), &fixed, &per_gain);
        for (size_t frame = 0; frame < d->frames; frame++) {
            const double share = (double)(frame + 1) / (double)d->frames;
            const double wanted = drive[frame] / d->level;
            fixed[frame] = block ? 0.0 : g->gain * (1.0 - share) * wanted;
            per_gain[frame] = (block ? 1.0 - share : share) * wanted;
            *demand = larger(fabs(wanted), *demand);
        }
        for (size_t frame = d->frames; frame < WHOLE_LANES(d->frames); frame++)
            fixed[frame] = per_gain[frame] = 0.0;
    }
}

/* Set decision->power from the predicted current that heats the coil. If current_a > 0, append the current of
 * each model to the limited quantities, and raise decision->demand where needed. */
INLINED void limit_current(Governor *g, const double *ungoverned, GainDecision *decision)
{
    const ProtectionDesign *d = g->design;
    const size_t states = d->states, frames = WHOLE_LANES(d->frames), state_rows = WHOLE_LANES(states);
    const double per_limit = d->current_a > 0.0 ? 1.0 / d->current_a : 0.0;
    for (size_t model = 0; model < d->currents; model++) {
        /* Currents 0 (which heats the coil) and 1 belong to model 0. */
        const size_t first = (model ? model - 1 : 0) * state_rows;
        const double *by_state = d->current_by_state + model * states * frames;
        const double *fall = known_block(g)->current[FALL] + model * frames;
        const double *rise = known_block(g)->current[RISE] + model * frames;
        const double *const from[PARTS] = {g->end[0] + first, g->end[1] + first, g->end[2] + first};
        double *out[PARTS] = {g->spare, NULL, g->column}, *fixed, *per_gain;
        pass_block(g, by_state, frames, g->state + first, ungoverned + first, fall, rise, out);
        if (model == 0) {
            const double share = 1.0 / (double)d->frames;
            decision->power[0] = share * product(out[FIXED], out[FIXED], frames);
            decision->power[1] = 2.0 * share * product(out[FIXED], rise, frames);
            decision->power[2] = share * product(rise, rise, frames);
            decision->power[3] = share * product(out[UNGOVERNED], out[UNGOVERNED], frames);
            continue;
        }
        next_quantities(g, frames, &fixed, &per_gain);
        for (size_t frame = 0; frame < frames; frame++) {
            fixed[frame] = per_limit * out[FIXED][frame];
            per_gain[frame] = per_limit * rise[frame];
        }
        decision->demand = larger(per_limit * largest(out[UNGOVERNED], frames), decision->demand);
        next_quantities(g, frames, &fixed, &per_gain);
        out[PER_GAIN] = per_gain;
        apply_to(PARTS, by_state, frames, states, from, out);
        for (size_t part = PER_GAIN; part <= UNGOVERNED; part++)
            add(out[part], coming_block(g)->current[FALL] + model * frames, 1.0, frames);
        for (size_t frame = 0; frame < frames; frame++) {
            fixed[frame] = per_limit * out[FIXED][frame];
            per_gain[frame] *= per_limit;
        }
        decision->demand = larger(per_limit * largest(out[UNGOVERNED], frames), decision->demand);
    }
}

/* Return the largest |a + g b| of all limited quantities at g = `gain`. */
INLINED double worst_at(const Governor *g, double gain)
{
    Lanes most = {0.0};
    double found = 0.0;
    for (size_t at = 0; at < g->quantities; at += LANES) {
        const Lanes reached = CONST_LANES_AT(g->fixed + at) + gain * CONST_LANES_AT(g->per_gain + at);
        const Lanes sizes = MAGNITUDES(reached);
        most = LARGER(sizes, most);
    }
    for (size_t lane = 0; lane < LANES; lane++)
        found = larger(most[lane], found);
    return found;
}

/* Return the largest g with |a + g b| <= 1 for all limited quantities. Valid only if every |a| <= 1. */
INLINED double highest_gain(const Governor *g)
{
    const Lanes full = {1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0}, none = {0.0};
    Lanes least = full * INFINITY;
    double found = INFINITY;
    for (size_t at = 0; at < g->quantities; at += LANES) {
        const Lanes a = CONST_LANES_AT(g->fixed + at), b = CONST_LANES_AT(g->per_gain + at);
        const Lanes towards = (Lanes)(((Bits)a & ~SIGN) | ((Bits)(a * b) & SIGN));
        const Lanes room = full - towards, size = MAGNITUDES(b), smallest = full * 1e-300;
        /* A quantity with b = 0 allows every gain. */
        const Lanes gain = LARGER(room, none) / LARGER(size, smallest);
        least = SMALLER(gain, least);
    }
    for (size_t lane = 0; lane < LANES; lane++)
        found = smaller(least[lane], found);
    return found;
}

SIMD_CLONES GainDecision governor_decide(Governor *g, double requested_gain)
{
    const ProtectionDesign *d = g->design;
    const double *ungoverned = g->is_ungoverned_equal ? g->state : g->ungoverned;
    GainDecision found = {.gain = requested_gain};
    for (size_t block = 0; block < 2; block++)
        if (!g->blocks[block].has_responses)
            compute_responses(d, &g->blocks[block], g->scaled[FALL], g->scaled[RISE]);
    g->quantities = 0;
    limit_excursion(g, ungoverned, &found.demand);
    if (larger(known_block(g)->loudest, coming_block(g)->loudest) > d->level)
        limit_level(g, &found.demand);
    limit_current(g, ungoverned, &found);
    if (worst_at(g, requested_gain) <= 1.0)
        return found;
    const double highest = smaller(highest_gain(g), requested_gain);
    found.gain = highest;
    if (!(worst_at(g, highest) <= 1.0 + ROUNDING)) {
        found.gain = 0.0;
        found.infeasible = 1;
    }
    return found;
}

SIMD_CLONES int governor_advance_unlimited(Governor *g, double *mean_a2)
{
    const ProtectionDesign *d = g->design;
    const size_t states = d->states, frames = d->frames, last = frames - 1;
    const size_t state_rows = WHOLE_LANES(states), row_frames = ROW_FRAMES(frames);
    const double loudest = larger(known_block(g)->loudest, coming_block(g)->loudest);
    if (!g->is_ungoverned_equal || d->current_a > 0.0 || loudest > d->level ||
        !(free_excursion(d, g->state, NULL, loudest) <= 1.0))
        return 0;
    double *current = g->column;
    apply(d->current_by_state, WHOLE_LANES(frames), states, g->state, current);
    for (size_t frame = 0; frame < frames; frame++)
        current[frame] += product(d->current_by_drive + (last - frame), known_block(g)->drive, frame + 1);
    *mean_a2 = product(current, current, WHOLE_LANES(frames)) / (double)frames;
    const double *response = d->state_by_drive;
    for (size_t model = 0; model < d->models; model++) {
        double *state = g->state + model * state_rows, *end = g->end[FIXED] + model * state_rows;
        apply(d->state_by_state + model * states * state_rows, state_rows, states, state, end);
        for (size_t one = 0; one < states; one++, response += row_frames)
            end[one] += product(response, known_block(g)->drive, frames);
        memcpy(state, end, state_rows * sizeof(double));
    }
    g->gain = 1.0;
    return 1;
}

void governor_advance(Governor *g, double gain)
{
    const size_t states = g->design->models * WHOLE_LANES(g->design->states);
    const int was_limited = smaller(gain, g->gain) < 1.0;
    for (size_t at = 0; at < states; at++) {
        g->state[at] = g->end[FIXED][at] + gain * g->end[PER_GAIN][at];
        g->ungoverned[at] = g->end[UNGOVERNED][at];
    }
    g->is_ungoverned_equal =
        !was_limited && free_excursion(g->design, g->state, g->ungoverned, 0.0) < TOGETHER;
    g->gain = gain;
}

int governor_is_at_rest(const Governor *g)
{
    const ProtectionDesign *d = g->design;
    return coming_block(g)->loudest == 0.0 && known_block(g)->loudest == 0.0 &&
           free_excursion(d, g->state, NULL, 0.0) <= TOGETHER &&
           (g->is_ungoverned_equal || free_excursion(d, g->ungoverned, NULL, 0.0) <= TOGETHER);
}

double governor_excursion_m(const Governor *g)
{
    const double x = g->state[0], v = g->state[1];
    return g->design->swing_m * sqrt(x * x + v * v);
}
