/* Oscillators at the low rate, the low-pass behind them, and interpolation to the stream's rate. */

#include "synthesis.h"

void smoothing_reset(const Settings *settings, Smoothing *smoothing)
{
    memset(smoothing->state, 0, smoothing_states(settings) * sizeof(double));
    memset(smoothing->tail, 0, smoothing_tail(settings) * sizeof(double));
}

/* ---------------------------------------------------------------------------------- oscillators */

/* Add partials whose frequency and amplitude glide; phase is the integral of frequency. Slots are added in
 * their order; those at amplitude 0 add nothing. shape, glide_s: one entry a step. */
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

/* One shape for all slots: then their sum never exceeds both its ends, which is what keeps the wave
 * under full scale. */
void synthesis_hop(const Settings *settings, const Glides *glides, double *low_rate)
{
    const size_t count = tracking_slots(settings);
    double rise = 0.0;
    for (size_t slot = 0; slot < count; slot++)
        rise += glides->end_amplitude[slot] - glides->start_amplitude[slot];
    const Table shape = rise > settings->still ? settings->attack : settings->glide;
    memset(low_rate, 0, settings->steps * sizeof(double));
    add_partials(glides, count, settings->seconds.at, shape.at, settings->glide_s.at, settings->steps,
                 low_rate);
}

void synthesis_add_onsets(const Settings *settings, const Glides *onset_partials, double *low_rate)
{
    add_partials(onset_partials, settings->onset_partials_max, settings->seconds.at, settings->tick_glide.at,
                 settings->tick_glide_s.at, settings->tick_steps, low_rate);
}

/* ------------------------------------------------------------------------------------ smoothing */

INLINED void filter_low(Table b, Table a, double *state, size_t order, double *samples,
                        size_t count)
{
    double held[ORDER_MAX];
    memcpy(held, state, order * sizeof(double));
    for (size_t one = 0; one < count; one++)
        samples[one] = filter_step(b.at, a.at, held, order, samples[one]);
    memcpy(state, held, order * sizeof(double));
}

/* Each step of the low rate becomes `decimation` frames: a matrix, by which the last `taps` samples
 * are multiplied. */
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

static void filter_sections(const Settings *settings, double *state, double *samples, size_t count)
{
    const CascadeDesign design = {settings->low_sections.at,
                                  settings->low_sections.length / SECTION_NUMBERS};
    for (size_t one = 0; one < count; one++)
        samples[one] = cascade_step((Cascade *)(void *)state, design, samples[one]);
}

void synthesis_play(const Settings *settings, double *low_rate, Smoothing *smoothing, double *vibration,
                    double *work)
{
    const size_t tail = smoothing_tail(settings), order = smoothing_states(settings);
    const size_t steps = settings->tick_steps;
    if (settings->low_sections.length)
        filter_sections(settings, smoothing->state, low_rate, steps);
    else if (order == 6)
        filter_low(settings->low_b, settings->low_a, smoothing->state, 6, low_rate, steps);
    else
        filter_low(settings->low_b, settings->low_a, smoothing->state, order, low_rate, steps);
    memcpy(work, smoothing->tail, tail * sizeof(double));
    memcpy(work + tail, low_rate, steps * sizeof(double));
    interpolate(work, steps, settings->phases, settings->decimation, vibration);
    memcpy(smoothing->tail, work + steps, tail * sizeof(double));
}

/* ----------------------------------------------------------------------------------------- knee */

SIMD_CLONES static int64_t beyond(const double *restrict samples, size_t count, double limit)
{
    int64_t total = 0;
    for (size_t one = 0; one < count; one++)
        total += fabs(samples[one]) > limit;
    return total;
}

size_t synthesis_keep_below_full_scale(const Settings *settings, double *vibration)
{
    const double knee = settings->knee, room = 1.0 - knee;
    const int64_t rounded = beyond(vibration, settings->tick_frames, knee);
    if (!rounded)
        return 0;
    for (size_t frame = 0; frame < settings->tick_frames; frame++) {
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
    for (size_t slot = 0; log->on && slot < slots; slot++) {
        if (glides->start_amplitude[slot] == 0.0 && glides->end_amplitude[slot] == 0.0)
            continue;
        glide_log_add(log, (GlideRow){
            (double)log->frame, (double)frames, (double)channel, (double)(first_slot + slot),
            glides->start_hz[slot], glides->end_hz[slot],
            glides->start_amplitude[slot], glides->end_amplitude[slot], glides->start_phase[slot],
        });
    }
}
