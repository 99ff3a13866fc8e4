/* The glides of all channels as they are played, for those who write down what vibrates. */

#ifndef CUSHION_GLIDE_LOG_H
#define CUSHION_GLIDE_LOG_H

#include <stddef.h>
#include <stdint.h>

#include "tracking.h"

/* What one slot does in one hop, or in one tick of onset partials. Only numbers: Python reads rows. */
typedef struct {
    double frame;  /* the first, counted from the start of the recording */
    double frames; /* of the hop or the tick */
    double channel, slot;
    double start_hz, end_hz, start_amplitude, end_amplitude, start_phase;
} GlideRow;

typedef struct {
    int on;         /* live streams never switch it on */
    int incomplete; /* there was no room */
    uint64_t frame; /* frames since it was switched on */
    size_t count, room;
    GlideRow *rows; /* the host's */
} GlideLog;

/* What part of a stream some glides belong to. first_slot: number of the first of them. */
typedef struct {
    size_t channel, first_slot, slots, frames;
} GlidePlace;

/* Add one row. */
void glide_log_add(GlideLog *log, GlideRow row);

/* Add the glides that sound. */
void glide_log_add_all(GlideLog *log, GlidePlace place, const Glides *glides);

#endif
