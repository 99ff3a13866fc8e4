/* Sound as a host hands it over: read, measured, scaled and mixed. */

#ifndef CUSHION_CORE_SOUND_H
#define CUSHION_CORE_SOUND_H

#include "core_parts.h"

INLINED double sample_at(CoreSound sound, size_t frame, size_t channel)
{
    const char *at = (const char *)sound.at + (ptrdiff_t)frame * sound.frame_bytes +
                     (ptrdiff_t)channel * sound.channel_bytes;
    return sound.is_double ? *(const double *)(const void *)at : (double)*(const float *)(const void *)at;
}

/* Frames of `channels` doubles, one after another. */
INLINED CoreSound interleaved(const double *samples, size_t channels)
{
    return (CoreSound){samples, (ptrdiff_t)(channels * sizeof(double)), sizeof(double), 1};
}

INLINED CoreSound mixed_sound(const Core *core)
{
    return interleaved(core->mixed, core->design.info.vibrations);
}

/* The same as the transform takes it. */
INLINED Sound sound_of(CoreSound sound, size_t channels)
{
    return (Sound){sound.at, sound.frame_bytes, sound.channel_bytes, channels, !sound.is_double};
}

INLINED CoreSound later(CoreSound sound, size_t frames)
{
    sound.at = (const char *)sound.at + (ptrdiff_t)frames * sound.frame_bytes;
    return sound;
}

/* Note the loudest sample and the mean square of a channel. */
void sound_measure(CoreLevel *level, CoreSound sound, size_t channel, size_t frames, double samplerate);

/* Undo the listener's volume, into core->sound: the gain moves in a straight line from `from` to `to` over
 * the call, of which these frames begin at `first`. Where it amplifies, no sample exceeds full scale. */
void sound_scale(Core *core, CoreSound sound, size_t frames, double from, double to, double first,
                 double call_frames);

/* Mix the sources by their weights, channel by channel in order, into core->mixed. */
void sound_mix(Core *core, CoreSound sound, size_t frames);

#endif
