/* The page of memory that the daemon and the plugin share; daemon/native/page.py reads the same layout.
 *
 * The daemon names the file in HAPTIC_CUSHION_PAGE. Each value has one writer and is written at once,
 * so neither side waits for the other: controls are the daemon's, all else is the plugin's. */

#pragma once

#include "../../core/core.h"

#define PAGE_MAGIC UINT64_C(0x3545474150485543) /* "CUHPAGE5" */

typedef struct {
    uint64_t magic;
    uint64_t size;         /* of all of it */
    uint64_t samplerate;   /* Hz; of the host: all is silent if the design is for another one */
    uint64_t cycle_frames; /* of the host's latest call */
    CoreControls controls;
    CoreReadings readings;
} Page;
