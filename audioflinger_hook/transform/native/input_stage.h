/* Replaces unusable samples with 0, mixes channels to mono and applies the band-pass. The mix is mid + g side,
 * as in downmix.py. The factor g, 0 to 1, is above 0 only if the channels nearly cancel in mid. mid = (L+R)/2
 * and side = (L-R)/2, where L (left) and R (right) are weighted sums of channels. */

#pragma once

#include "../../core/core.h"
#include "settings.h"

INLINED double sample_of(const char *place, int is_double)
{
    if (is_double)
        return *(const double *)(const void *)place;
    return (double)*(const float *)(const void *)place;
}

/* Return the part of the sound that begins at a frame and a channel. */
INLINED CoreSound sound_from(CoreSound sound, size_t frame, size_t channel)
{
    sound.at = (const char *)sound.at + (ptrdiff_t)frame * sound.frame_bytes +
               (ptrdiff_t)channel * sound.channel_bytes;
    return sound;
}

/* Return how many leading frames are exactly 0 in all channels. */
size_t input_silent_first(CoreSound sound, size_t channels, size_t frames);

/* Return how many trailing frames are exactly 0 in all channels. */
size_t input_silent_last(CoreSound sound, size_t channels, size_t frames);

/* Band-pass frames in place; return the largest output magnitude. state: band_b.length - 1 doubles. */
double input_band_pass(const Settings *s, double *state, double *mono, size_t frames);

/* Write the band-pass output for silence; return its largest magnitude. frames: at least 1. */
double input_band_pass_silence(const Settings *s, double *state, double *mono, size_t frames);

#define MIX_GROUP 16 /* frames per measurement of power, as in downmix.py */

/* mean, side: smoothed powers of mid and side. newest: faster average of the sum of both powers. start, end:
 * factors on side at the start and the end of the current group of MIX_GROUP frames. */
typedef struct {
    double mean, side, newest, start, end;
} MixBalance;

/* State of one mix. of_mean, of_side: mid and side of the `frames` frames of the incomplete group. */
typedef struct {
    MixBalance balance;
    double frames, of_mean[MIX_GROUP], of_side[MIX_GROUP];
} DownmixState;

/* Return the channels' weights in mid, then in side; NULL if this number of channels has no known layout. */
const double *downmix_weights(const Settings *s, size_t channels);

/* Mix channels to mono. weights: the channels' weights in mid, then in side; or NULL: mean of the channels.
 * side: work space, one number per frame. Samples that are not finite or exceed magnitude_max count as 0;
 * return their number. */
size_t input_mix(const Settings *s, DownmixState *powers, CoreSound sound, size_t channels,
                 const double *weights, size_t frames, double *mono, double *side);

/* Update the state of a mix with frames of silence. */
void downmix_rest(const Settings *s, DownmixState *powers, size_t frames);
