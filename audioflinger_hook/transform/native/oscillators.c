/* Oscillators of one tick (about 2 ms). Glides give frequencies and relative amplitudes. In each step (one
 * sample at the low rate), a common gain scales all partials to the target strength. Strength is the square
 * root of the perceived power. */

#include "synthesis.h"

#define SILENT 1e-9    /* strengths up to this value count as silence */
#define NO_POWER 1e-20 /* powers up to this value count as 0 */

/* Partials that sound in one tick. turns (phase), level (amplitude), wave: tick_steps numbers per partial. */
typedef struct {
    size_t count, steps;
    double *turns, *level, *wave;
    double *hz;    /* vibration frequency at the tick's end */
    double *felt;  /* body's sensitivity at this frequency */
    double *share; /* perceived amplitude after the filters, per unit of amplitude before them */
} Sounding;

static size_t most_sounding(const Settings *s) { return tracking_slots(s) + s->onset_partials_max; }

size_t oscillators_work(const Settings *s) { return most_sounding(s) * (3 * s->tick_steps + 3); }

static Sounding laid_out(const Settings *s, double *work)
{
    const size_t most = most_sounding(s), each = most * s->tick_steps;
    double *numbers = work + 3 * each;
    return (Sounding){0, s->tick_steps, work, work + each, work + 2 * each,
                      numbers, numbers + most, numbers + 2 * most};
}

void oscillators_begin_hop(const Settings *s, Oscillators *oscillators)
{
    double rise = 0.0;
    for (size_t slot = 0; slot < tracking_slots(s); slot++)
        rise += oscillators->hop.end_amplitude[slot] - oscillators->hop.start_amplitude[slot];
    oscillators->drive.rises = rise > s->still;
}

/* Glide shapes, one entry per step of the hop or tick. shape, whole: completed share of the change of
 * amplitude and of frequency, 0 to 1. seconds: time. glide_s: integral of `whole` over time. */
typedef struct {
    const double *shape, *whole, *seconds, *glide_s;
    size_t at; /* steps since the glides began */
} TickShapes;

static void add(const Settings *s, Sounding *sounding, const Glides *glides, size_t slots, TickShapes shapes)
{
    const size_t steps = sounding->steps;
    for (size_t slot = 0; slot < slots; slot++) {
        const double start = glides->start_amplitude[slot];
        const double rise = glides->end_amplitude[slot] - start;
        if (start == 0.0 && rise == 0.0)
            continue;
        const double hz = glides->start_hz[slot], rise_hz = glides->end_hz[slot] - hz;
        const double phase = glides->start_phase[slot];
        double *turns = sounding->turns + sounding->count * steps;
        double *level = sounding->level + sounding->count * steps;
        for (size_t step = 0; step < steps; step++) {
            const size_t at = shapes.at + step;
            turns[step] = hz * shapes.seconds[at] + rise_hz * shapes.glide_s[at] + phase;
            level[step] = rise * shapes.shape[at] + start;
        }
        const double end_hz = hz + rise_hz * shapes.whole[shapes.at + steps - 1];
        const double felt = table_at(s->felt_weights, s->gain_step_hz, end_hz);
        sounding->hz[sounding->count] = end_hz;
        sounding->felt[sounding->count] = felt;
        sounding->share[sounding->count] = felt / table_at(s->gain_table, s->gain_step_hz, end_hz);
        sounding->count++;
    }
}

SIMD_CLONES_NARROW static void oscillate(const double *restrict turns, size_t count, double *restrict wave)
{
    for (size_t one = 0; one < count; one++)
        wave[one] = cosine_of_turns(turns[one]);
}

/* Return the perceived power in a step, without beats. */
static double power_of(const Sounding *sounding, size_t step)
{
    double power = 0.0;
    for (size_t one = 0; one < sounding->count; one++) {
        const double felt = sounding->level[one * sounding->steps + step] * sounding->share[one];
        power += felt * felt;
    }
    return power;
}

static double sum_of(const Sounding *sounding, size_t step)
{
    double sum = 0.0;
    for (size_t one = 0; one < sounding->count; one++)
        sum += sounding->level[one * sounding->steps + step];
    return sum;
}

/* If the sum of amplitudes would exceed the ceiling, weight amplitudes by a power of the body's sensitivity.
 * Return the exponent at the tick's end; `before` is the exponent at the tick's start. */
static double concentrate(const Settings *s, const Sounding *sounding, double wanted, double before)
{
    const size_t last = sounding->steps - 1;
    const double power = power_of(sounding, last);
    double after = 0.0;
    if (power > 0.0) {
        const double over = wanted / sqrt(power) * sum_of(sounding, last) / s->ceiling - 1.0;
        after = over > 0.0 ? smaller(s->concentrated, s->concentrated * over) : 0.0;
    }
    if (!(before > 0.0) && !(after > 0.0))
        return after;
    for (size_t one = 0; one < sounding->count; one++) {
        double *level = sounding->level + one * sounding->steps;
        double factor = exact_pow(sounding->felt[one], before);
        const double ratio = exact_pow(sounding->felt[one], (after - before) / (double)sounding->steps);
        for (size_t step = 0; step < sounding->steps; step++)
            level[step] *= factor *= ratio;
    }
    return after;
}

/* Return (power with slow beats) / (power without beats) at the tick's end, at least beat_least^2. */
static double beat_of(const Settings *s, const Sounding *sounding)
{
    const size_t last = sounding->steps - 1;
    const double power = power_of(sounding, last);
    double crossed = 0.0;
    if (!(power > NO_POWER))
        return 1.0;
    for (size_t one = 0; one < sounding->count; one++)
        for (size_t other = 0; other < one; other++) {
            const double apart_hz = fabs(sounding->hz[one] - sounding->hz[other]);
            const double counts = smaller(1.0, (s->beat_hz - apart_hz) / s->beat_width_hz);
            if (!(counts > 0.0))
                continue;
            const size_t here = one * sounding->steps + last, there = other * sounding->steps + last;
            crossed += counts * (sounding->level[here] * sounding->share[one]) *
                       (sounding->level[there] * sounding->share[other]) *
                       cosine_of_turns(sounding->turns[here] - sounding->turns[there]);
        }
    return larger(s->beat_least * s->beat_least, 1.0 + 2.0 * crossed / power);
}

static double driven(const Settings *s, const Drive *drive, double hz)
{
    return drive->gain * exact_pow(table_at(s->felt_weights, s->gain_step_hz, hz), drive->moved);
}

/* Record the part of each glide in this tick, with the gains at the tick's start and end. */
static void log_tick(const Settings *s, OscillatorTick now, const Glides *glides, size_t slots,
                     size_t first_slot, TickShapes shapes, const Drive *before, const Drive *after)
{
    const size_t last = shapes.at + s->tick_steps - 1;
    for (size_t slot = 0; now.log->rows && slot < slots; slot++) {
        const double start = glides->start_amplitude[slot], hz = glides->start_hz[slot];
        const double rise = glides->end_amplitude[slot] - start, rise_hz = glides->end_hz[slot] - hz;
        double begun = 0.0, whole = 0.0, turns = 0.0;
        if (start == 0.0 && rise == 0.0)
            continue;
        if (shapes.at) {
            begun = shapes.shape[shapes.at - 1];
            whole = shapes.whole[shapes.at - 1];
            turns = hz * shapes.seconds[shapes.at - 1] + rise_hz * shapes.glide_s[shapes.at - 1];
        }
        const double phase = glides->start_phase[slot] + turns;
        const double from_hz = hz + rise_hz * whole, to_hz = hz + rise_hz * shapes.whole[last];
        glide_log_add(now.log, (CoreGlide){
            (double)now.log->frame, (double)s->tick_frames, (double)now.channel,
            (double)(first_slot + slot), from_hz, to_hz,
            driven(s, before, from_hz) * (start + rise * begun),
            driven(s, after, to_hz) * (start + rise * shapes.shape[last]),
            phase - floor(phase),
        });
    }
}

size_t oscillators_play(const Settings *s, Oscillators *oscillators, OscillatorTick now,
                        double *low_rate, double *work)
{
    Drive *drive = &oscillators->drive;
    Sounding sounding = laid_out(s, work);
    const size_t steps = s->tick_steps;
    const TickShapes hop = {drive->rises != 0.0 ? s->attack.at : s->glide.at, s->glide.at, s->seconds.at,
                            s->glide_s.at, now.tick * steps};
    const TickShapes tick = {s->tick_glide.at, s->tick_glide.at, s->seconds.at, s->tick_glide_s.at, 0};
    memset(low_rate, 0, steps * sizeof(double));
    if (drive->wanted > 0.0 || now.wanted > 0.0) {
        add(s, &sounding, &oscillators->hop, tracking_slots(s), hop);
        if (now.onset_partials)
            add(s, &sounding, now.onset_partials, s->onset_partials_max, tick);
    }
    if (!sounding.count) {
        /* The next partials start at the strength now.wanted. */
        *drive = (Drive){.wanted = now.wanted, .beat = 1.0, .rises = drive->rises};
        return 0;
    }
    oscillate(sounding.turns, sounding.count * steps, sounding.wave);
    const double moved = concentrate(s, &sounding, now.wanted, drive->moved);
    const double beat = beat_of(s, &sounding);
    const Drive before = *drive;
    double most = 0.0;
    size_t limited = 0;
    for (size_t step = 0; step < steps; step++)
        most = larger(power_of(&sounding, step), most);
    most = sqrt(most);
    for (size_t step = 0; most > SILENT && step < steps; step++) {
        const double part = (double)(step + 1) / (double)steps, sum = sum_of(&sounding, step);
        const double wanted = before.wanted + (now.wanted - before.wanted) * part;
        const double strength = larger(sqrt(power_of(&sounding, step)), s->weakest_step * most);
        double gain = wanted / (strength * sqrt(before.beat + (beat - before.beat) * part));
        gain = smaller(gain, s->gain_max);
        if (gain * sum > s->ceiling) {
            gain = s->ceiling / sum;
            limited++;
        }
        double total = 0.0;
        for (size_t one = 0; one < sounding.count; one++)
            total += sounding.level[one * steps + step] * sounding.wave[one * steps + step];
        low_rate[step] = gain * total;
        drive->gain = gain;
    }
    drive->wanted = now.wanted;
    drive->beat = beat;
    drive->moved = moved;
    log_tick(s, now, &oscillators->hop, tracking_slots(s), 0, hop, &before, drive);
    if (now.onset_partials)
        log_tick(s, now, now.onset_partials, s->onset_partials_max, tracking_slots(s), tick, &before, drive);
    return limited;
}
