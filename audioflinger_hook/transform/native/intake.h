/* What arrives, made safe, mixed and band-passed. */

#ifndef CUSHION_INTAKE_H
#define CUSHION_INTAKE_H

#include <stddef.h>

#include "settings.h"

/* Frames of sound as Python holds them: at any distance from one another, in any direction. */
typedef struct {
    const char *at;
    ptrdiff_t frame_bytes, channel_bytes;
    size_t channels;
    int is_float; /* 32 bits a sample, else 64 */
} Sound;

/* Whether the sample at this place is exactly 0. */
int intake_is_silent(const char *place, int is_float);

/* Write the mean of the channels of so many frames; return how many samples were unusable and count
 * as 0: not finite, or above magnitude_max. */
size_t intake_mono(const Settings *settings, Sound sound, size_t frames, double *mono);

/* Band-pass so many frames in place; return the largest magnitude among them. state: as many as the
 * filter's order. */
double intake_band_pass(const Settings *settings, double *state, double *mono, size_t frames);

#endif
