/* How strong each partial of a hop is. */

#ifndef CUSHION_LEVELS_H
#define CUSHION_LEVELS_H

#include "live.h"

/* Set the amplitudes of what was found. Where loudness is followed only their proportion matters, and
 * what speech loses is noted for the strength; else they are scaled down where their sum would pass the
 * ceiling: return whether it would. */
int levels_set(Live *live, Channel *channel, size_t count);

/* The factor that makes amplitudes as strong as is wanted, as far as the ceiling allows. */
double levels_gain(const Live *live, double wanted, size_t count);

/* What the law leaves of the level of what was found, 1 of one tone. */
double levels_left_by_law(const Live *live, size_t count);

#endif
