/* A design of the live form, read from the bytes that Python made (transform/design/blob.py). */

#ifndef CUSHION_DESIGN_BLOB_H
#define CUSHION_DESIGN_BLOB_H

#include <stddef.h>

#include "settings.h"

typedef struct {
    Settings settings; /* its tables lie in the bytes that were read */
    size_t samplerate; /* Hz */
    size_t latency_frames, tonal_latency_frames;
    void *bytes; /* those bytes; who allocated them frees them */
} Design;

/* Read a design; return NULL, or what is wrong with the bytes. They must lie at a multiple of 8, and
 * stay unchanged as long as the design is used. Offsets, lengths and values are checked: whatever the
 * bytes are, nothing beyond them is read. */
const char *design_open(Design *design, void *bytes, size_t size);

#endif
