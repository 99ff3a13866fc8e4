/* In every tick (about 2 ms), searches a window of about 5 ms for an onset. */

#pragma once

#include "fft.h"
#include "settings.h"

/* State of one channel's onset search. */
typedef struct {
    double *peaks;   /* largest magnitude in each tick of the onset window, the newest last */
    double *past;    /* powers of the bands in the last back_ticks ticks, the oldest first */
    double *highest; /* decaying maximum of each band's power, at onsets and in ticks back_ticks or more ago */
    double *power;   /* power of each bin, summed over the first heard_ticks ticks of the last onset */
    double *rising;  /* 1 for each band that rose at the last onset, else 0 */
    double since;    /* ticks since the last onset, at most rest_ticks + heard_ticks */
    double newest;   /* largest mean square of a tick of `power`, or of its last newest_frames frames */
    double peak;     /* largest magnitude in the ticks of `power` */
} Onsets;

/* Adjacent bands of one onset, from `first` to `last` - 1. */
typedef struct {
    size_t first, last;
} Group;

/* A new tone. hz: vibration frequency. weight: share of the onset's level. amplitude: 1 is full scale. */
typedef struct {
    double hz, weight, amplitude;
} OnsetTone;

INLINED size_t onsets_bands(const Settings *s) { return s->band_edges.length - 1; }

/* Return the size of the work space of `onsets_detect`, in doubles. */
size_t onsets_work(const Settings *s, const Fft *fft);

void onsets_reset(const Settings *s, Onsets *onsets);

/* Return whether the newest tick contains an onset; onsets->peaks must contain this tick. samples: the last
 * short_frames band-passed frames. work: its first short_bins numbers receive the bin powers. */
int onsets_detect(const Settings *s, const Fft *fft, Onsets *onsets, const double *samples, double *work);

/* Return whether this tick still improves the estimate of the last onset. */
INLINED int onsets_are_measured(const Settings *s, const Onsets *onsets)
{
    return onsets->since < (double)s->heard_ticks;
}

/* Group the bands that rose. Write the strongest groups, at most groups_max, in ascending order of frequency;
 * return their number. */
size_t onsets_groups(const Settings *s, const Onsets *onsets, Group *groups);

/* Return the onset's amplitude, as if the onset were one tone. */
INLINED double onsets_level(const Onsets *onsets)
{
    return smaller(sqrt(2.0 * onsets->newest), onsets->peak);
}

/* Estimate the tone that starts in a group of bands. Weight and amplitude are both 0 if onsets_level times
 * sqrt(x p) is below the setting `weakest`. docs/transform.md defines x and p. */
OnsetTone onsets_estimate(const Settings *s, const Onsets *onsets, Group group);

/* Return the sum, over a group of bands, of each band's largest power in the last back_ticks ticks. */
double onsets_power(const Settings *s, const Onsets *onsets, Group group);
