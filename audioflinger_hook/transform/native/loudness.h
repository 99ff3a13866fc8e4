/* Loudness after ISO 532-1, from the excitation of its bands. */

#pragma once

#include "settings.h"

/* Groups of bands whose rises count by themselves, at most. */
#define GROUPS_OF_BANDS_MAX 8

/* How loud a tick is. */
typedef struct {
    double db;   /* 0 for a full-scale tone of 1 kHz */
    double sone; /* of all bands */
    double groups[GROUPS_OF_BANDS_MAX]; /* sone of each, without what other bands mask */
} Loudness;

/* Whether loudness is followed at all. */
INLINED int loudness_is_on(const Settings *s) { return s->loudness_scale.length != 0; }

/* excitation: of each band, over its threshold in quiet. */
Loudness loudness_of(const Settings *settings, const double *excitation);

/* The most bands under those that the onset search's spectra show, and of all. */
#define LOW_MAX 8
#define BANDS_MAX 20

/* All-passes in each of the two chains that make a signal analytic. */
#define CHAIN 4

/* What is remembered of one channel. All of it is state, doubles alone. */
typedef struct {
    double smooth[16];                          /* of the low-pass before the low rate */
    double chains[2][CHAIN][2];                 /* of the all-passes */
    double before;                              /* the last sample at the low rate */
    double real[2][LOW_MAX], imaginary[2][LOW_MAX]; /* of both poles of each low band */
} LowBands;

typedef struct {
    LowBands *low;
    double *recent; /* of the high bands, average_ticks - 1 rows, the oldest first */
} BandPowers;

#define LOW_STATES (sizeof(LowBands) / sizeof(double))

/* Return to the state of a new stream. */
void band_powers_reset(const Settings *settings, const BandPowers *powers);

/* Write the excitation of each band over its threshold in quiet. samples: the newest tick_frames of
 * band-passed sound. short_power: of the bins of the onset search in this tick. */
void band_powers_update(const Settings *settings, const BandPowers *powers, const double *samples,
                      const double *short_power, double *excitation);
