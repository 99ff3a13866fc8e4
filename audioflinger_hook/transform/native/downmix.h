/* The mono mix of a sound's channels, and the sum of powers where it cancels; as in downmix.py. */

#pragma once

#include "settings.h"

/* Frames whose power counts as one number, as in downmix.py. */
#define MIX_GROUP 16

/* Smoothed powers, of the mean, of the difference and of both of late; then the factor on the
 * difference at the start and at the end of the group under way. */
typedef struct {
    double mean, side, newest, start, end;
} MixBalance;

/* The state of one mix: that, and the samples so far of the group under way. */
typedef struct {
    MixBalance balance;
    double frames, of_mean[MIX_GROUP], of_side[MIX_GROUP];
} DownmixState;

#define DOWNMIX_STATE_NUMBERS (sizeof(DownmixState) / sizeof(double))

/* Return the weights of so many channels in the mean, then those in half the difference of the left
 * and right half; NULL where all channels are averaged. */
const double *downmix_weights(const Settings *settings, size_t channels);

/* Whether the table of weights can be read. */
int downmix_is_table(Table table);

/* Add so much of the difference to so many frames of the mean as this cancels. */
void downmix_restore(const Settings *settings, DownmixState *powers, double *mono, const double *side,
                     size_t frames);

/* Take so many frames of silence. */
void downmix_rest(const Settings *settings, DownmixState *powers, size_t frames);

/* Whether the numbers are such as powers can be. */
int downmix_is_possible(const DownmixState *powers);
