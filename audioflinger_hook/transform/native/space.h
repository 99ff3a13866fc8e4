/* Memory that is handed out piece by piece. */

#ifndef CUSHION_SPACE_H
#define CUSHION_SPACE_H

#include "common.h"

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/asan_interface.h>
#define GAP 32
#else
#define GAP 0
#define ASAN_POISON_MEMORY_REGION(place, bytes) ((void)0)
#endif

/* Without a base it is only counted what is taken. */
typedef struct {
    char *base;
    size_t used;
} Space;

/* Take so many numbers of so many bytes, aligned for any; where memory is watched, a gap that must
 * not be touched comes behind them. */
INLINED void *taken(Space *space, size_t count, size_t bytes)
{
    const size_t size = (count * bytes + 7) / 8 * 8;
    char *here = space->base ? space->base + space->used : NULL;
    if (here)
        ASAN_POISON_MEMORY_REGION(here + size, GAP);
    space->used += size + GAP;
    return here;
}

#endif
