/* The glides of all channels as they are played, for those who write down what vibrates. */

#include "glide_log.h"

void glide_log_add(GlideLog *log, GlideRow row)
{
    if (log->count == log->room)
        log->incomplete = 1;
    else
        log->rows[log->count++] = row;
}

void glide_log_add_all(GlideLog *log, GlidePlace place, const Glides *glides)
{
    for (size_t slot = 0; log->on && slot < place.slots; slot++) {
        if (glides->start_amplitude[slot] == 0.0 && glides->end_amplitude[slot] == 0.0)
            continue;
        glide_log_add(log, (GlideRow){
            (double)log->frame,      (double)place.frames,          (double)place.channel,
            (double)(place.first_slot + slot),
            glides->start_hz[slot],  glides->end_hz[slot],
            glides->start_amplitude[slot], glides->end_amplitude[slot], glides->start_phase[slot],
        });
    }
}
