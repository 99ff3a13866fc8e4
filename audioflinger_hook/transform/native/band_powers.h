/* The power in every band of ISO 532-1 at the end of each tick. */

#ifndef CUSHION_BAND_POWERS_H
#define CUSHION_BAND_POWERS_H

#include "settings.h"

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

size_t band_powers_low(const Settings *settings);
size_t band_powers_high(const Settings *settings);

/* Bands in all, the low ones of one band of ISO 532-1 counted once. */
size_t band_powers_count(const Settings *settings);

/* Return to the state of a new stream. */
void band_powers_reset(const Settings *settings, const BandPowers *powers);

/* Write the excitation of each band over its threshold in quiet. samples: the newest tick_frames of
 * band-passed sound. short_power: of the bins of the onset search in this tick. */
void band_powers_update(const Settings *settings, const BandPowers *powers, const double *samples,
                      const double *short_power, double *excitation);

#endif
