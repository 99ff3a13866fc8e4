/* Turns partials into vibration: oscillators at the low rate (about 3 kHz), filters, interpolation. */

#pragma once

#include "../../core/core.h"
#include "filter.h"
#include "scaling.h"
#include "tracking.h"

/* State of one channel's output filters and interpolation. */
typedef struct {
    double *state; /* filter state of low-pass and high-passes */
    double *tail;  /* the last smoothing_tail samples at the low rate */
} Smoothing;

INLINED size_t smoothing_states(const Settings *s)
{
    return s->low_sections.length ? sizeof(Cascade) / sizeof(double) : s->low_b.length - 1;
}

INLINED size_t smoothing_tail(const Settings *s) { return s->phases.length / s->decimation - 1; }

void smoothing_reset(const Settings *s, Smoothing *smoothing);

/* Return the factor that compensates for the gain of low-pass and high-passes at a vibration frequency. */
INLINED double smoothing_gain(const Settings *s, double hz)
{
    return table_at(s->gain_table, s->gain_step_hz, hz);
}

/* Return the size of the work space of `synthesis_play`, in doubles. */
INLINED size_t synthesis_work(const Settings *s) { return smoothing_tail(s) + s->tick_steps; }

/* Write one hop: `steps` samples at the low rate. */
void synthesis_hop(const Settings *s, const Glides *glides, double *low_rate);

/* Add one tick of onset partials: tick_steps samples at the low rate. */
void synthesis_add_onsets(const Settings *s, const Glides *onset_partials, double *low_rate);

/* Filter and interpolate one tick: tick_steps low-rate samples (overwritten) become tick_frames samples. */
void synthesis_play(const Settings *s, double *low_rate, Smoothing *smoothing, double *vibration,
                    double *work);

/* In one tick, soft-clip the samples whose magnitude exceeds the knee; return their number. */
size_t synthesis_keep_below_full_scale(const Settings *s, double *vibration);

typedef struct {
    uint64_t frame; /* frames since the recording began */
    size_t count, room;
    CoreGlide *rows; /* memory of the host; NULL: recording is off */
} GlideLog;

INLINED void glide_log_add(GlideLog *log, CoreGlide row)
{
    if (log->count < log->room)
        log->rows[log->count++] = row;
}

/* Record all glides that sound. first_slot: number of the first slot. frames: length of the hop or tick. */
void glide_log_add_all(GlideLog *log, const Glides *glides, size_t channel, size_t first_slot, size_t slots,
                       size_t frames);

/* State of a channel's strength control at the end of the last tick. */
typedef struct {
    double wanted; /* target strength */
    double beat;   /* power with slow beats, divided by power without beats */
    double moved;  /* exponent: amplitudes are weighted by sensitivity^moved */
    double gain;   /* factor on amplitudes */
    double rises;  /* 1 if the sum of amplitudes rises in this hop, else 0 */
} Drive;

/* State of one channel's oscillators. hop: glides of the current hop. */
typedef struct {
    Drive drive;
    Glides hop;
} Oscillators;

/* Return the size of the work space of `oscillators_play`, in doubles. */
size_t oscillators_work(const Settings *s);

/* Set drive.rises from the new glides in oscillators->hop. */
void oscillators_begin_hop(const Settings *s, Oscillators *oscillators);

/* One tick of a channel. tick: index of the tick in the hop. onset_partials: NULL if none sounds. wanted:
 * target strength at the tick's end. */
typedef struct {
    size_t tick;
    const Glides *onset_partials;
    double wanted;
    GlideLog *log;
    size_t channel;
} OscillatorTick;

/* Write one tick: tick_steps samples at the low rate. Return how many samples the ceiling limited. */
size_t oscillators_play(const Settings *s, Oscillators *oscillators, OscillatorTick now,
                        double *low_rate, double *work);
