/* Oscillators at the low rate, filters, and interpolation to the stream's sample rate. */

#include "synthesis.h"

void smoothing_reset(const Settings *s, Smoothing *smoothing)
{
    memset(smoothing->state, 0, smoothing_states(s) * sizeof(double));
    memset(smoothing->tail, 0, smoothing_tail(s) * sizeof(double));
}

/* Add partials with gliding frequency and amplitude. seconds, shape, glide_s: one entry per step. */
SIMD_CLONES static void add_partials(const Glides *glides, size_t count, const double *restrict seconds,
                                     const double *restrict shape, const double *restrict glide_s,
                                     size_t steps, double *restrict low_rate)
{
    for (size_t slot = 0; slot < count; slot++) {
        const double start = glides->start_amplitude[slot], rise = glides->end_amplitude[slot] - start;
        const double hz = glides->start_hz[slot], rise_hz = glides->end_hz[slot] - hz;
        const double phase = glides->start_phase[slot];
        if (start == 0.0 && glides->end_amplitude[slot] == 0.0)
            continue;
        for (size_t step = 0; step < steps; step++) {
            const double turns = hz * seconds[step] + rise_hz * glide_s[step] + phase;
            low_rate[step] += cosine_of_turns(turns) * (rise * shape[step] + start);
        }
    }
}

/* All slots share one amplitude shape, so the sum of amplitudes is largest at the start or the end of the
 * hop. The ceiling limits both sums, and therefore the wave. */
void synthesis_hop(const Settings *s, const Glides *glides, double *low_rate)
{
    const size_t count = tracking_slots(s);
    double rise = 0.0;
    for (size_t slot = 0; slot < count; slot++)
        rise += glides->end_amplitude[slot] - glides->start_amplitude[slot];
    const Table shape = rise > s->still ? s->attack : s->glide;
    memset(low_rate, 0, s->steps * sizeof(double));
    add_partials(glides, count, s->seconds.at, shape.at, s->glide_s.at, s->steps, low_rate);
}

void synthesis_add_onsets(const Settings *s, const Glides *onset_partials, double *low_rate)
{
    add_partials(onset_partials, s->onset_partials_max, s->seconds.at, s->tick_glide.at,
                 s->tick_glide_s.at, s->tick_steps, low_rate);
}

INLINED void filter_low(Table b, Table a, double *state, size_t order, double *samples, size_t count)
{
    double held[ORDER_MAX];
    memcpy(held, state, order * sizeof(double));
    for (size_t one = 0; one < count; one++)
        samples[one] = filter_step(b.at, a.at, held, order, samples[one]);
    memcpy(state, held, order * sizeof(double));
}

/* Polyphase interpolation: compute `decimation` frames per step of the low rate, each from `taps` samples. */
INLINED void multiply(const double *restrict low_rate, size_t steps, const double *restrict phases,
                        size_t taps, size_t decimation, double *restrict vibration)
{
    for (size_t step = 0; step < steps; step++, low_rate++, vibration += decimation)
        for (size_t frame = 0; frame < decimation; frame++) {
            double total = low_rate[0] * phases[frame];
            for (size_t tap = 1; tap < taps; tap++)
                total += low_rate[tap] * phases[tap * decimation + frame];
            vibration[frame] = total;
        }
}

SIMD_CLONES static void interpolate(const double *low_rate, size_t steps, Table phases, size_t decimation,
                              double *vibration)
{
    const size_t taps = phases.length / decimation;
    if (taps == 4)
        multiply(low_rate, steps, phases.at, 4, decimation, vibration);
    else
        multiply(low_rate, steps, phases.at, taps, decimation, vibration);
}

static void filter_sections(const Settings *s, double *state, double *samples, size_t count)
{
    const CascadeDesign design = {s->low_sections.at, s->low_sections.length / SECTION_NUMBERS};
    for (size_t one = 0; one < count; one++)
        samples[one] = cascade_step((Cascade *)(void *)state, design, samples[one]);
}

void synthesis_play(const Settings *s, double *low_rate, Smoothing *smoothing, double *vibration,
                    double *work)
{
    const size_t tail = smoothing_tail(s), order = smoothing_states(s);
    const size_t steps = s->tick_steps;
    if (s->low_sections.length)
        filter_sections(s, smoothing->state, low_rate, steps);
    else if (order == 6)
        filter_low(s->low_b, s->low_a, smoothing->state, 6, low_rate, steps);
    else
        filter_low(s->low_b, s->low_a, smoothing->state, order, low_rate, steps);
    memcpy(work, smoothing->tail, tail * sizeof(double));
    memcpy(work + tail, low_rate, steps * sizeof(double));
    interpolate(work, steps, s->phases, s->decimation, vibration);
    memcpy(smoothing->tail, work + steps, tail * sizeof(double));
}

SIMD_CLONES static int64_t beyond(const double *restrict samples, size_t count, double limit)
{
    int64_t total = 0;
    for (size_t one = 0; one < count; one++)
        total += fabs(samples[one]) > limit;
    return total;
}

size_t synthesis_keep_below_full_scale(const Settings *s, double *vibration)
{
    const double knee = s->knee, room = 1.0 - knee;
    const int64_t rounded = beyond(vibration, s->tick_frames, knee);
    if (!rounded)
        return 0;
    for (size_t frame = 0; frame < s->tick_frames; frame++) {
        const double size = fabs(vibration[frame]);
        const double lower = knee + room * exact_tanh((size - knee) / room) * (1.0 - 1e-6);
        if (size > knee)
            vibration[frame] = copysign(lower, vibration[frame]);
    }
    return (size_t)rounded;
}

void glide_log_add_all(GlideLog *log, const Glides *glides, size_t channel, size_t first_slot, size_t slots,
                       size_t frames)
{
    for (size_t slot = 0; log->rows && slot < slots; slot++) {
        if (glides->start_amplitude[slot] == 0.0 && glides->end_amplitude[slot] == 0.0)
            continue;
        glide_log_add(log, (CoreGlide){
            (double)log->frame, (double)frames, (double)channel, (double)(first_slot + slot),
            glides->start_hz[slot], glides->end_hz[slot],
            glides->start_amplitude[slot], glides->end_amplitude[slot], glides->start_phase[slot],
        });
    }
}
