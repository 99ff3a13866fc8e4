/* From vibration to the signal of one actuator: source and delay, level, damping, protection, exposure,
 * and the fade of what may be felt, in this order. */

#pragma once

#include "../core.h"
#include "../../transform/native/design_blob.h"
#include "exposure.h"
#include "protection.h"

/* What is done for one rig. */
typedef struct {
    double damping_gain; /* 0: not damped */
    CascadeDesign damping;
    ProtectionDesign protection; /* models 0: neither protection nor exposure */
    ExposureDesign exposure;
} DriveDesign;

/* Frames by which protection delays. */
INLINED size_t drive_latency_frames(const DriveDesign *design)
{
    return design->protection.models ? 2 * design->protection.frames : 0;
}

/* The last frames of all sources, rounded: a ring of `frames` for each. */
typedef struct {
    float *samples;
    size_t sources, frames, next;
} History;

/* Add frames of vibration, (frames, sources). */
void history_add(History *history, const double *vibration, size_t frames);

/* Where an actuator reads. */
typedef struct {
    size_t source, delay;
} TapPoint;

/* A factor that moves in a straight line. */
typedef struct {
    double from, to;
    size_t done, frames; /* of the way: done == frames at its end */
} Ramp;

typedef struct {
    const DriveDesign *design; /* NULL: nothing is done for the rig */
    double samplerate;
    TapPoint tap, next_tap, wanted_tap;
    size_t tap_fade_frames, tap_faded;
    Ramp level, audible;
    Cascade damping;
    size_t until_damping_check;
    uint64_t replaced;
    Protection *protection;
    Exposure exposure, undamped; /* undamped: of the signal before damping, for what it costs */
} Actuator;

/* Lay out an actuator's memory; without memory, only count it. */
void actuator_layout(Actuator *actuator, const DriveDesign *design, double samplerate, Arena *arena);

/* Come to rest; temperatures and doses stay unless asked. */
void actuator_reset(Actuator *actuator, int doses_too);

/* Use these at once, before the first frame. */
void actuator_begin(Actuator *actuator, TapPoint tap, double factor, int audible);

/* Fade to these from the next frame on. */
void actuator_change(Actuator *actuator, TapPoint tap, double factor, int audible);

/* Write the newest frames of the history, `stride` floats apart. */
void actuator_process(Actuator *actuator, const History *history, float *out, size_t stride,
                      size_t frames);

void actuator_report(const Actuator *actuator, ActuatorReadings *readings);

/* Continue with the state that outlives a process. */
void actuator_set_safety(Actuator *actuator, const ActuatorSafety *safety);

/* Begin a new day's dose. */
void actuator_begin_day(Actuator *actuator);

enum { DRIVES_MAX = CORE_ACTUATORS };

/* Read the drive of this number. Return NULL, or what is wrong with it. Whatever the
 * records hold, nothing beyond them is read later. */
const char *drive_design_read(Records records, size_t number, DriveDesign *design);
