/* From partials to vibration at the stream's rate. */

#ifndef CUSHION_SYNTHESIS_H
#define CUSHION_SYNTHESIS_H

#include "settings.h"
#include "tracking.h"

/* What the low-pass and the interpolation remember of one channel. */
typedef struct {
    double *state; /* of the low-pass */
    double *tail;  /* the last samples at the low rate: one less than taps */
} Smoothing;

size_t smoothing_states(const Settings *settings);
size_t smoothing_tail(const Settings *settings);

/* Return to rest. */
void smoothing_reset(const Settings *settings, Smoothing *smoothing);

/* The factor that undoes the low-pass's ripple at a vibration frequency. */
double smoothing_gain(const Settings *settings, double hz);

/* Doubles of work space that `synthesis_play` needs. */
size_t synthesis_work(const Settings *settings);

/* Write one hop at the low rate, (steps,). */
void synthesis_hop(const Settings *settings, const Glides *glides, double *low_rate);

/* Add one tick of onset partials at the low rate, (tick_steps,). */
void synthesis_add_onsets(const Settings *settings, const Glides *onset_partials, double *low_rate);

/* Write one tick of vibration, (tick_frames,). low_rate: (tick_steps,), which is overwritten. */
void synthesis_play(const Settings *settings, double *low_rate, Smoothing *smoothing, double *vibration,
                    double *work);

/* Round off what is beyond the knee; return how many samples that were. */
size_t synthesis_keep_below_full_scale(const Settings *settings, double *vibration);

#endif
