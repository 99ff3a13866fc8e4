/* Protection of one actuator: keeps excursion, current, level and the coil's temperature within limits
 * by gain alone, ahead of time.
 *
 * device/drive/protection/ designs it and says why. A block of drive leaves two blocks later, times a gain
 * that moves in a straight line within the block. */

#ifndef CUSHION_PROTECTION_H
#define CUSHION_PROTECTION_H

#include <stddef.h>
#include <stdint.h>

#include "protection_design.h"

typedef enum { NOT_LIMITED, BY_MOTION, BY_TEMPERATURE, BY_EXPOSURE } LimitedBy;

typedef struct Protection Protection;

/* Lay out the protection's memory; without memory, only count it. */
Protection *protection_layout(const ProtectionDesign *design, Arena *arena);

/* Come to rest; as new: counts become 0, and the coil is cold. */
void protection_reset(Protection *protection, int as_new);

/* Take one finite sample of drive and return the one that leaves now. gain_ceiling: largest gain, 0 to 1. */
double protection_step(Protection *protection, double sample, double gain_ceiling);

typedef struct {
    double gain, least_gain; /* now, and since the reset */
    double excursion_m;      /* amplitude that the stored energy allows */
    double coil_k, magnet_k; /* above their surroundings */
    uint64_t blocks, limited_blocks, infeasible_blocks;
    LimitedBy limited_by;
} ProtectionReadings;

ProtectionReadings protection_readings(const Protection *protection);

/* Continue with these temperatures, K above the surroundings. */
void protection_set_temperatures(Protection *protection, double coil_k, double magnet_k);

#endif
