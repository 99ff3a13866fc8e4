/* Structures that the core's source files share. */

#pragma once

#include "../transform/native/live.h"
#include "drive/actuator.h"

enum { DRIVES_MAX = CORE_ACTUATORS };

typedef struct {
    CoreInfo info; /* memory_bytes is not set */
    int has_transform, per_channel; /* per_channel: one vibration for each channel */
    Settings settings; /* settings of the transform */
    const double *weights; /* (vibrations, 2, inputs): weights of mean and of side signal, or NULL */
    size_t drives;
    size_t drive_of[CORE_ACTUATORS]; /* index of a drive; DRIVES_MAX: no drive */
} CoreDesign;

/* Parse a design; return NULL or an error message. drives: DRIVES_MAX drives to fill, or NULL to check
 * only. */
const char *core_design_read(CoreDesign *design, DriveDesign *drives, const void *bytes, size_t size);

#define PIECE_FRAMES 1024 /* largest number of frames that are processed at once */

/* State of a stream, except for the states of transform, source mix, history and actuators. */
typedef struct {
    int is_fresh, is_opened; /* no frame processed since core_reset; none since core_open */
    double sound_gain;       /* gain on the sound at the last frame */
    uint64_t day, frames, replaced;
} CoreState;

struct Core {
    CoreDesign design;
    Live live;
    DriveDesign *drives;
    double *sound;     /* (frames, inputs): sound times the gain of sound_scale */
    double *mixed;     /* mixed sources, (frames, vibrations), followed by work space */
    double *vibration; /* (frames, vibrations) */
    uint64_t fingerprint; /* hash of the design */
    uint64_t hops;        /* number of the last reported hop */
    Arena memory; /* start of the stream's state */
    size_t memory_bytes;
    CoreState *state;
    DownmixState *powers; /* mix state of each source */
    History *history;
    Actuator *actuators;
};

INLINED double sample_at(CoreSound sound, size_t frame, size_t channel)
{
    return sample_of(sound_from(sound, frame, channel).at, sound.is_double);
}

/* Return a CoreSound for contiguous frames, each of `channels` doubles. */
INLINED CoreSound interleaved(const double *samples, size_t channels)
{
    return (CoreSound){samples, (ptrdiff_t)(channels * sizeof(double)), sizeof(double), 1};
}
