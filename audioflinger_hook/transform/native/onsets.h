/* Onsets: what begins, by a short window every tick. */

#pragma once

#include "fft.h"
#include "settings.h"

/* What is remembered of one channel. All of it is state. */
typedef struct {
    double *peaks;   /* largest magnitude of the ticks that the window touches, the last the newest */
    double *past;    /* the bands' powers in the last back_ticks, the oldest first */
    double *highest; /* of each band, forgotten bit by bit */
    double *power;   /* of each bin since the last onset */
    double *rising;  /* 1 for each band that rose at the last onset, else 0 */
    double *since;   /* ticks since then */
    double *newest;  /* mean square of what was newest, the largest since then */
    double *peak;    /* largest magnitude since then */
} Onsets;

/* Bands of something that begins, and past the last. */
typedef struct {
    size_t first, last;
} Group;

/* Vibration frequency in Hz, what the law would leave of the level, and that amplitude. */
typedef struct {
    double hz, weight, amplitude;
} OnsetTone;

INLINED size_t onsets_bands(const Settings *s) { return s->band_edges.length - 1; }

/* Doubles of work space that `onsets_detect` needs. */
size_t onsets_work(const Settings *settings, const Fft *fft);

/* Return to the state of a new stream. */
void onsets_reset(const Settings *settings, const Onsets *onsets);

/* Take one tick and return whether there is an onset in it. samples: the last short_frames of
 * band-passed sound, of which the last tick_frames are new; the peak of those is noted already. The
 * first short_bins numbers of `work` are then the powers of the bins. */
int onsets_detect(const Settings *settings, const Fft *fft, const Onsets *onsets,
                const double *samples, double *work);

/* Whether the last onset's sound is told better by this tick than by the one before. */
INLINED int onsets_are_measured(const Settings *s, const Onsets *onsets)
{
    return *onsets->since < (double)s->heard_ticks;
}

/* Write the bands of each thing that begins, by frequency; return how many, `groups_max` at most. */
size_t onsets_groups(const Settings *settings, const Onsets *onsets, Group *groups);

/* Amplitude of the sound that begins, as that of one tone. */
INLINED double onsets_level(const Onsets *onsets)
{
    return smaller(sqrt(2.0 * *onsets->newest), *onsets->peak);
}

/* Tell what begins in a group of bands; with weight 0 what is too weak to be principal. */
OnsetTone onsets_estimate(const Settings *settings, const Onsets *onsets, Group group);

/* Return the power that a group of bands has had of late. */
double onsets_loudness(const Settings *settings, const Onsets *onsets, Group group);
