/* Loudness by ISO 532-1, and the vibration strength that follows from it. */

#pragma once

#include "settings.h"

#define GROUPS_OF_BANDS_MAX 8 /* largest number of groups of loudness bands */

/* Return whether the vibration strength follows loudness. */
INLINED int loudness_is_on(const Settings *s) { return s->loudness_scale.length != 0; }

#define BANDS_MAX 20  /* largest number of loudness bands */
#define LOW_MAX 8     /* largest number of low bands, which have filters of their own */
#define LOW_NUMBERS 3 /* numbers in a row of low_poles */
#define SMOOTH_STATES 6 /* states of the anti-aliasing low-pass */
#define SMOOTH_ROW 8    /* numbers in a row of low_smooth */
#define CHAIN 4       /* all-passes in each of the two chains that form an analytic signal */

/* Filter states of one channel. All members are doubles. */
typedef struct {
    double smooth[SMOOTH_STATES];               /* anti-aliasing low-pass */
    double chains[2][CHAIN][2];                 /* all-passes */
    double before;                              /* last sample at the low rate */
    double real[2][LOW_MAX], imaginary[2][LOW_MAX]; /* outputs of both one-pole filters of each low band */
} LowBands;

typedef struct {
    LowBands low;
    double *recent; /* excitation of the high bands: average_ticks - 1 rows, the oldest tick first */
} BandPowers;

void band_powers_reset(const Settings *s, BandPowers *powers);

/* State of one channel's strength. All members are doubles. Levels are loudness levels in phon, minus
 * FULL_SCALE_PHON of loudness.c. Levels of groups: 0 dB at 1 sone, 10 dB more for each factor of 2. */
typedef struct {
    double programme; /* level that follows `loud` very slowly */
    double sound_ticks; /* ticks with an open noise gate since the stream's start, up to start_ticks */
    double floor;     /* level of the background noise */
    double loud;      /* `slow` with a limited rate of fall */
    double steady;    /* loudness level with less jitter */
    double attack_ticks; /* remaining ticks in which jitter is not reduced */
    double slow;      /* average of `steady`; time constant: 30 ms */
    double usual;     /* slow average of `steady`; reference for rises */
    double boost, held_ticks; /* boost after a rise, in dB; remaining ticks of its hold time */
    double speech_left;       /* factor by which speech suppression lowers the strength */
    double smooth[GROUPS_OF_BANDS_MAX];    /* loudness of each group of bands in sone, averaged */
    double usual_of[GROUPS_OF_BANDS_MAX];  /* slow average of each group's level; a rise is relative to it */
    double deviation[GROUPS_OF_BANDS_MAX]; /* mean of |group's level - usual_of|, in dB */
} Strength;

void strength_reset(const Settings *s, Strength *strength);

/* Reset after a long silence; keep programme and sound_ticks. */
void strength_rest(const Settings *s, Strength *strength);

/* Process one tick. Return the vibration's target strength, the square root of its perceived power; 0 if the
 * noise gate is closed. samples: tick_frames frames of band-passed sound. short_power: powers of the onset
 * window's bins. */
double strength_of_tick(const Settings *s, BandPowers *powers, Strength *strength,
                        const double *samples, const double *short_power);
