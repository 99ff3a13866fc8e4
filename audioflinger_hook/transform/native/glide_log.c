/* The glides of all voices as they are played, for those who write down what vibrates. */

#include "glide_log.h"

#include <stdlib.h>

#define FIRST_ROOM 1024

static int make_room(GlideLog *log)
{
    if (log->count < log->room)
        return 1;
    const size_t room = log->room ? 2 * log->room : FIRST_ROOM;
    GlideRow *rows = realloc(log->rows, room * sizeof *rows);
    if (!rows) {
        log->incomplete = 1;
        return 0;
    }
    log->rows = rows;
    log->room = room;
    return 1;
}

void glide_log_add(GlideLog *log, GlidePlace place, const Glides *glides)
{
    if (!log->on)
        return;
    for (size_t slot = 0; slot < place.slots; slot++) {
        if (glides->start_amplitude[slot] == 0.0 && glides->end_amplitude[slot] == 0.0)
            continue;
        if (!make_room(log))
            return;
        log->rows[log->count++] = (GlideRow){
            (double)log->frame,      (double)place.frames,          (double)place.voice,
            (double)(place.first_slot + slot),
            glides->start_hz[slot],  glides->end_hz[slot],
            glides->start_amplitude[slot], glides->end_amplitude[slot], glides->start_phase[slot],
        };
    }
}

void glide_log_clear(GlideLog *log)
{
    free(log->rows);
    log->rows = NULL;
    log->count = log->room = 0;
    log->incomplete = 0;
}
