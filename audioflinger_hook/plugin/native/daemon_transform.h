/* The daemon's transform: a tap's channels in, one vibration or several out, as the page says. */

#ifndef CUSHION_DAEMON_TRANSFORM_H
#define CUSHION_DAEMON_TRANSFORM_H

#include <stddef.h>

#include "page.h"

typedef struct DaemonTransform DaemonTransform;

/* Make it; NULL after one line on stderr. Allocates. */
DaemonTransform *daemon_transform_open(unsigned long samplerate);

void daemon_transform_close(DaemonTransform *transform);

void daemon_transform_reset(DaemonTransform *transform);

/* Process any number of frames. Real-time safe. inputs, outputs: PAGE_CHANNELS each; those that are
 * not in use are ignored or silent. */
void daemon_transform_process(DaemonTransform *transform, float *const *inputs,
                              float *const *outputs, size_t frames);

#endif
