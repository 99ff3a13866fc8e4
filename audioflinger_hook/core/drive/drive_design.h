/* The drives of a design, read from its records. */

#ifndef CUSHION_DRIVE_DESIGN_H
#define CUSHION_DRIVE_DESIGN_H

#include "../../transform/native/design_blob.h"
#include "actuator.h"

enum { DRIVES_MAX = CORE_ACTUATORS };

/* Read the drive of this number. Return NULL, or what is wrong with it. Whatever the
 * records hold, nothing beyond them is read later. */
const char *drive_design_read(Records records, size_t number, DriveDesign *design);

#endif
