/* All that a core is made for, read from the bytes of a design. */

#ifndef CUSHION_CORE_DESIGN_H
#define CUSHION_CORE_DESIGN_H

#include "core.h"
#include "drive/drive_design.h"

typedef struct {
    CoreInfo info; /* without memory_bytes */
    int has_transform, per_channel; /* one vibration for each channel */
    Design transform;
    const double *weights; /* (vibrations, 2, inputs): in the mean, and in half the difference; or NULL */
    size_t drives;
    size_t drive_of[CORE_ACTUATORS]; /* DRIVES_MAX: none */
} CoreDesign;

/* Read a design, and its drives into room for DRIVES_MAX of them, NULL to check them only. Return NULL,
 * or what is wrong with it. */
const char *core_design_read(CoreDesign *design, DriveDesign *drives, const void *bytes, size_t size);

#endif
