/* Cores of design files. */

#pragma once

#include "../../core/core.h"

/* A core with the memory that it works in. */
typedef struct {
    Core *core; /* NULL: none */
    CoreInfo info;
    void *design, *memory;
} LoadedCore;

/* Make a core of the design in a file; return NULL, or what is wrong. Allocates. */
const char *core_load(LoadedCore *loaded, const char *path);

/* Make a core of the design of a profile for a samplerate: the file that HAPTIC_CUSHION_DESIGN names,
 * or one of the user's, or one beside the plugin. Return 1; or, after one line on stderr, 0 where there is
 * no design, and -1 where it cannot be used. Allocates. */
int core_find(LoadedCore *loaded, const char *profile, unsigned long samplerate);

void core_unload(LoadedCore *loaded);
