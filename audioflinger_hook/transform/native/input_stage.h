/* What arrives, made safe, mixed and band-passed. */

#pragma once

#include "settings.h"

/* Frames of sound as Python holds them: at any distance from one another, in any direction. */
typedef struct {
    const char *at;
    ptrdiff_t frame_bytes, channel_bytes;
    size_t channels;
    int is_float; /* 32 bits a sample, else 64 */
} Sound;

/* How many of so many frames, from the first on, are exactly 0 in all their channels. */
size_t input_silent_first(Sound sound, size_t frames);

/* The same from the last on backwards. */
size_t input_silent_last(Sound sound, size_t frames);

/* Write the mean of the channels of so many frames, by the weights of downmix_weights, and half the
 * difference of their halves; without weights, the plain mean and nothing else. Return how many
 * samples were unusable and count as 0: not finite, or above magnitude_max. */
size_t input_mix(const Settings *settings, Sound sound, const double *weights, size_t frames,
                 double *mono, double *side);

/* Band-pass frames in place; return the largest magnitude. state: as many as the filter's order. */
double input_band_pass(const Settings *settings, double *state, double *mono, size_t frames);

/* The same of so many frames of silence, one at least. */
double input_band_pass_silence(const Settings *settings, double *state, double *mono, size_t frames);
