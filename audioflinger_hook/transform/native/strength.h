/* How strong a channel vibrates, tick by tick, by how loud its sound is. */

#pragma once

#include "loudness.h"

/* What is remembered of one channel: state, doubles alone. Levels in dB of loudness. */
typedef struct {
    double programme; /* the usual level of what is played */
    double sound_ticks; /* of sound so far, up to start_ticks */
    double floor;     /* of the background noise */
    double loud;      /* falls slowly */
    double steady;    /* loudness without its jitter */
    double attack_ticks; /* for how long all changes are followed */
    double slow;      /* the same, averaged */
    double usual;     /* what rises of all sound are counted from */
    double boost, held_ticks; /* what a rise adds, and for how long it stays */
    double speech_left;       /* factor on what is speech */
    double smooth[GROUPS_OF_BANDS_MAX];    /* sone of each group, averaged */
    double usual_of[GROUPS_OF_BANDS_MAX];  /* what rises of each are counted from */
    double deviation[GROUPS_OF_BANDS_MAX]; /* how much each moves */
} Strength;

#define STRENGTH_STATES (sizeof(Strength) / sizeof(double))

/* Return to what is taken for granted before a stream. */
void strength_reset(const Settings *settings, Strength *strength);

/* Return to what is so after a long silence; the programme stays. */
void strength_rest(const Settings *settings, Strength *strength);

/* Take the next tick; return how strong it vibrates, the root of its felt partials' sum of squares; 0
 * where the gate is closed. */
double strength_follow(const Settings *settings, Strength *strength, const Loudness *loudness);

/* Whether the numbers are such as can be. */
int strength_is_possible(const Settings *settings, const Strength *strength);
