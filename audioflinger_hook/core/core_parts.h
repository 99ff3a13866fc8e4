/* What a core is made of, and what its parts share. */

#pragma once

#include "../transform/native/live.h"
#include "drive/actuator.h"

/* All that a core is made for, read from the bytes of a design. */
typedef struct {
    CoreInfo info; /* without memory_bytes */
    int has_transform, per_channel; /* one vibration for each channel */
    Settings settings; /* of the transform */
    const double *weights; /* (vibrations, 2, inputs): in the mean, and in half the difference; or NULL */
    size_t drives;
    size_t drive_of[CORE_ACTUATORS]; /* DRIVES_MAX: none */
} CoreDesign;

/* core_design.c. Read a design, and its drives into room for DRIVES_MAX of them, NULL to check them only.
 * Return NULL, or what is wrong with it. */
const char *core_design_read(CoreDesign *design, DriveDesign *drives, const void *bytes, size_t size);

#define PIECE_FRAMES 1024 /* sound is processed in pieces of up to this */

struct Core {
    CoreDesign design;
    Live live;
    DriveDesign *drives;
    Actuator *actuators;
    History history;
    double *sound;      /* (frames, inputs), if it is scaled or mixed */
    double *mixed;      /* (frames, vibrations), then two columns of work */
    double *vibration;  /* (frames, vibrations) */
    DownmixState *powers;  /* of the mixes */
    int is_fresh, is_opened; /* nothing was processed since core_reset, or core_open */
    double sound_gain;  /* of the last frame */
    Arena driven;       /* where history and actuators begin */
    size_t driven_bytes;
    uint64_t fingerprint; /* of the design */
    uint64_t day, frames, replaced, hops;
};

/* FNV-1a, 64 bits, of whole words. */
INLINED uint64_t fnv_1a(const void *memory, size_t bytes)
{
    const char *place = memory;
    uint64_t sum = 0xcbf29ce484222325u, word;
    for (size_t at = 0; at + sizeof word <= bytes; at += sizeof word) {
        memcpy(&word, place + at, sizeof word);
        sum = (sum ^ word) * 0x100000001b3u;
    }
    return sum;
}

/* core_memory.c. Lay out history and actuators: only pointers and lengths change. */
void core_layout_driven(Core *core, Arena *arena);

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

/* core_sound.c. Note the loudest sample and the mean square of a channel. */
void sound_measure(CoreLevel *level, CoreSound sound, size_t channel, size_t frames, double samplerate);

/* Undo the listener's volume, into core->sound: the gain moves in a straight line from `from` to `to` over
 * the call, of which these frames begin at `first`. Where it amplifies, no sample exceeds full scale. */
void sound_scale(Core *core, CoreSound sound, size_t frames, double from, double to, double first,
                 double call_frames);

/* Mix the sources by their weights, channel by channel in order, into core->mixed. */
void sound_mix(Core *core, CoreSound sound, size_t frames);
