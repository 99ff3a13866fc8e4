/* From partials to vibration at the stream's rate. */

#ifndef CUSHION_SYNTHESIS_H
#define CUSHION_SYNTHESIS_H

#include "settings.h"
#include "tracking.h"

/* What the low-pass and the interpolation remember of one voice. */
typedef struct {
    double *state; /* of the low-pass: as many as its order */
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

/* Write one tick of vibration, (tick_frames,). hop: its part of the hop at the low rate. fresh: what
 * fresh partials do in it; NULL where none sounds. */
void synthesis_play(const Settings *settings, const double *hop, const Glides *fresh,
                    Smoothing *smoothing, double *vibration, double *work);

/* Round off what is beyond the knee; return how many samples that were. */
size_t synthesis_keep_below_full_scale(const Settings *settings, double *vibration);

#endif
