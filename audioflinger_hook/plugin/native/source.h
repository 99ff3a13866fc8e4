/* The transform of one source: channels of sound in, one channel of vibration out. */

#ifndef CUSHION_SOURCE_H
#define CUSHION_SOURCE_H

#include "../../transform/native/live.h"
#include "design_file.h"
#include "level_meter.h"

#define PIECE_FRAMES 1024 /* a host's buffer is processed in pieces of up to this */
#define CHANNELS_MAX 8

typedef struct {
    Design design;
    Live live;
    LevelMeter sound, vibration;
    uint64_t frames;
    float samples[PIECE_FRAMES * CHANNELS_MAX];
    double computed[PIECE_FRAMES];
} Source;

/* Make the transform of a profile for a samplerate; NULL after one line on stderr that says why.
 * Allocates. */
Source *source_open(const char *profile, unsigned long samplerate, size_t channels);

void source_close(Source *source);

/* Return to the state of a new stream. */
void source_reset(Source *source);

/* Write the vibration of up to PIECE_FRAMES of sound. Real-time safe. The output may be one of the
 * inputs; an input may be NULL, which is silence. */
void source_process(Source *source, const float *const *inputs, float *vibration, size_t frames);

#endif
