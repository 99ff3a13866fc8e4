/* What a core is made of; core_sound.c, core_memory.c and core_state.c share it. */

#ifndef CUSHION_CORE_PARTS_H
#define CUSHION_CORE_PARTS_H

#include "../transform/native/live.h"
#include "core.h"
#include "core_design.h"

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

/* Lay out history and actuators: only pointers and lengths change. */
void core_layout_driven(Core *core, Arena *arena);

#endif
