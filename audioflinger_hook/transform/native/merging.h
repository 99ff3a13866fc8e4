/* Partials that a body cannot tell apart become one. */

#ifndef CUSHION_MERGING_H
#define CUSHION_MERGING_H

#include "common.h"
#include "settings.h"
#include "tracking.h"

/* Partials that are one: sums of their powers, and of power times frequency. */
typedef struct {
    double power, weighted_hz, strongest;
} PartialGroup;

/* Work space, and the merged partials with the share of the strongest in each. */
typedef struct {
    double *centres;        /* what sounds, then what has begun: most_alive + partials_max */
    PartialGroup *gathered; /* as many */
    double *audio_hz, *hz, *amplitude, *dominance; /* partials_max each */
} Merging;

/* How close a partial must be to one at this frequency to be part of it, in Hz of vibration. */
INLINED double merging_hz(const Settings *s, double hz)
{
    return larger(s->merge_hz, s->merge_ratio * hz);
}

/* Merge partials. The first `sounding` centres are frequencies that sound. */
Partials merging_merge(const Settings *settings, Merging *merging, size_t sounding,
                       Partials partials);

#endif
