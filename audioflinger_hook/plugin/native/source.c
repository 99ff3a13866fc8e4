/* The transform of one source. */

#include "source.h"

#include <stdio.h>
#include <stdlib.h>

Source *source_open(const char *profile, unsigned long samplerate, size_t channels)
{
    Source *source = channels <= CHANNELS_MAX ? calloc(1, sizeof *source) : NULL;
    if (!source)
        return NULL;
    if (!design_find(&source->design, profile, samplerate)) {
        free(source);
        return NULL;
    }
    if (live_open(&source->live, &source->design.settings, channels, 0)) {
        fprintf(stderr, "haptic_cushion: not enough memory for profile %s\n", profile);
        design_close(&source->design);
        free(source);
        return NULL;
    }
    source->sound.samplerate = source->vibration.samplerate = (double)samplerate;
    return source;
}

void source_close(Source *source)
{
    if (!source)
        return;
    live_close(&source->live);
    design_close(&source->design);
    free(source);
}

void source_reset(Source *source)
{
    live_reset(&source->live);
    source->sound.peak = source->sound.square = 0.0;
    source->vibration.peak = source->vibration.square = 0.0;
}

void source_process(Source *source, const float *const *inputs, float *vibration, size_t frames)
{
    const size_t channels = source->live.channels;
    for (size_t channel = 0; channel < channels; channel++)
        for (size_t frame = 0; frame < frames; frame++)
            source->samples[frame * channels + channel] =
                inputs[channel] ? inputs[channel][frame] : 0.0f;
    const Sound sound = {
        .at = (const char *)source->samples,
        .frame_bytes = (ptrdiff_t)(channels * sizeof(float)),
        .channel_bytes = sizeof(float),
        .channels = channels,
        .is_float = 1,
    };
    live_process(&source->live, sound, frames, source->computed);
    for (size_t frame = 0; frame < frames; frame++)
        vibration[frame] = (float)source->computed[frame];
    source->frames += frames;
    level_add(&source->sound, source->samples, frames * channels, channels);
    level_add(&source->vibration, vibration, frames, 1);
}
