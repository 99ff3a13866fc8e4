/* From partials to vibration at the stream's rate. */

#pragma once

#include "filter.h"
#include "scaling.h"
#include "tracking.h"

/* What the low-pass and the interpolation remember of one channel. */
typedef struct {
    double *state; /* of the low-pass */
    double *tail;  /* the last samples at the low rate: one less than taps */
} Smoothing;

INLINED size_t smoothing_states(const Settings *s)
{
    return s->low_sections.length ? sizeof(Cascade) / sizeof(double) : s->low_b.length - 1;
}

INLINED size_t smoothing_tail(const Settings *s) { return s->phases.length / s->decimation - 1; }

/* Return to rest. */
void smoothing_reset(const Settings *settings, Smoothing *smoothing);

/* The factor that undoes the low-pass's ripple at a vibration frequency. */
INLINED double smoothing_gain(const Settings *s, double hz)
{
    return table_at(s->gain_table, s->gain_step_hz, hz);
}

/* Doubles of work space that `synthesis_play` needs. */
INLINED size_t synthesis_work(const Settings *s) { return smoothing_tail(s) + s->tick_steps; }

/* Write one hop at the low rate, (steps,). */
void synthesis_hop(const Settings *settings, const Glides *glides, double *low_rate);

/* Add one tick of onset partials at the low rate, (tick_steps,). */
void synthesis_add_onsets(const Settings *settings, const Glides *onset_partials, double *low_rate);

/* Write one tick of vibration, (tick_frames,). low_rate: (tick_steps,), which is overwritten. */
void synthesis_play(const Settings *settings, double *low_rate, Smoothing *smoothing, double *vibration,
                    double *work);

/* Round off what is beyond the knee; return how many samples that were. */
size_t synthesis_keep_below_full_scale(const Settings *settings, double *vibration);

/* What one slot does in one hop, or in one tick of onset partials. Only numbers: Python reads rows. */
typedef struct {
    double frame;  /* the first, counted from the start of the recording */
    double frames; /* of the hop or the tick */
    double channel, slot;
    double start_hz, end_hz, start_amplitude, end_amplitude, start_phase;
} GlideRow;

typedef struct {
    int on;         /* live streams never switch it on */
    uint64_t frame; /* frames since it was switched on */
    size_t count, room;
    GlideRow *rows; /* the host's */
} GlideLog;

/* Add a row if there is room. */
INLINED void glide_log_add(GlideLog *log, GlideRow row)
{
    if (log->count < log->room)
        log->rows[log->count++] = row;
}

/* Add the glides that sound. first_slot: number of the first of these slots; frames: of the hop or tick. */
void glide_log_add_all(GlideLog *log, const Glides *glides, size_t channel, size_t first_slot, size_t slots,
                       size_t frames);
