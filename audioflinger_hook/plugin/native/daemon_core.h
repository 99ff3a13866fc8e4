/* The daemon's core: a tap's channels in, the signals of all actuators out, as the page says. */

#pragma once

#include "design_file.h"
#include "page.h"

enum { DAEMON_INPUTS = CORE_CHANNELS, DAEMON_OUTPUTS = 32 };

typedef struct DaemonCore DaemonCore;

/* Make it; NULL after one line on stderr. Allocates. */
DaemonCore *daemon_core_open(unsigned long samplerate);

void daemon_core_close(DaemonCore *daemon);

void daemon_core_reset(DaemonCore *daemon);

/* Process any number of frames. Real-time safe. Ports that are not in use are ignored or silent. */
void daemon_core_process(DaemonCore *daemon, float *const inputs[DAEMON_INPUTS],
                         float *const outputs[DAEMON_OUTPUTS], size_t frames);
