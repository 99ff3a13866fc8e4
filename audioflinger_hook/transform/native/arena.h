/* Memory that is handed out piece by piece. */

#ifndef CUSHION_ARENA_H
#define CUSHION_ARENA_H

#include "common.h"

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/asan_interface.h>
#define GAP 32
#else
#define GAP 0
#define ASAN_POISON_MEMORY_REGION(place, bytes) ((void)0)
#endif

/* Without a base, the bytes are only counted. */
typedef struct {
    char *base;
    size_t used;
} Arena;

/* Return room for `count` elements of `bytes` bytes, at a multiple of 16; NULL without a base. Under a
 * sanitizer, a gap follows that nobody may touch. */
INLINED void *arena_alloc(Arena *arena, size_t count, size_t bytes)
{
    const size_t size = (count * bytes + 15) / 16 * 16;
    char *here = arena->base ? arena->base + arena->used : NULL;
    if (here)
        ASAN_POISON_MEMORY_REGION(here + size, GAP);
    arena->used += size + GAP;
    return here;
}

#endif
