/* Signal chain of one actuator: source, delay, level, damping, protection, exposure, fade, in this order. */

#pragma once

#include "../core.h"
#include "../../transform/native/filter.h"
#include "protection.h"

/* Meter of the exposure to vibration (ISO 2631-1); device/drive/exposure.py computes its design. From the
 * drive (the actuator's signal), the meter predicts the seat's acceleration, weights its frequencies, and
 * integrates the second and fourth powers over a day. These integrals are the dose. A gain on the drive limits
 * the dose. */
enum { DECIMATION_TAPS_MAX = 1024, MOTION_TAPS_MAX = 8 };

typedef struct {
    size_t factor; /* decimation factor */
    size_t decimation_taps, motion_taps;
    const double *decimation, *motion_fir; /* coefficients of FIR filters; motion_taps 0: no motion_fir */
    CascadeDesign motion, weighting, above; /* above: high-pass at 80 Hz after weighting */
    double volts_per_full_scale; /* motion and motion_fir give m/s² per V */
    double period_s;            /* sample period of the decimated signal */
    double running_share;       /* weight of a new square in the running mean square */
    double cap_a8_m_s2, cap_vdv; /* largest A(8) and vibration dose value; 0: no cap */
    size_t reading_frames;       /* frames of the drive between updates of the gain */
} ExposureDesign;

typedef struct {
    const ExposureDesign *design;
    double *past; /* ring buffer: the last decimation_taps samples of the drive */
    size_t next, phase, until_reading;
    double recent[MOTION_TAPS_MAX];
    Cascade motion, weighting, above;
    CoreDose sums;   /* sums.time_s excludes the last `frames` frames; the other sums include them */
    uint64_t frames; /* frames of the decimated signal since `sums` was set */
    double running, gain;
} Exposure;

typedef struct {
    double damping_gain; /* 0: no damping */
    CascadeDesign damping;
    ProtectionDesign protection; /* protection.models 0: neither protection nor exposure */
    ExposureDesign exposure;
} DriveDesign;

/* Return the protection's delay in frames. */
INLINED size_t drive_latency_frames(const DriveDesign *design)
{
    return design->protection.models ? 2 * design->protection.frames : 0;
}

/* The latest vibration of all sources, rounded to float: one ring buffer of `frames` samples per source. */
typedef struct {
    float *samples;
    size_t sources, frames, next;
} History;

/* Append vibration, (frames, sources), to the history. */
void history_add(History *history, const double *vibration, size_t frames);

/* What an actuator reads from the history: index of the source, and delay in frames. */
typedef struct {
    size_t source, delay;
} TapPoint;

/* A factor that changes along `smooth_step`. A change waits until the one before has ended: cut short, that
 * would click. */
typedef struct {
    double from, to, wanted;
    size_t done, frames; /* done == frames: `to` is reached */
} Ramp;

typedef struct {
    const DriveDesign *design; /* NULL: no drive */
    double samplerate;
    TapPoint tap, next_tap, wanted_tap;
    size_t tap_fade_frames, tap_faded;
    Ramp level, audible;
    Cascade damping;
    size_t until_damping_check;
    uint64_t replaced;
    Protection *protection;
    Exposure exposure, undamped; /* undamped: exposure that the drive would cause without damping */
} Actuator;

/* Allocate the actuator's memory from the arena. If arena->base is NULL, only count bytes. */
void actuator_layout(Actuator *actuator, const DriveDesign *design, double samplerate, Arena *arena);

/* Reset all signals and models of motion. doses_too: reset temperatures, doses and counts as well. */
void actuator_reset(Actuator *actuator, int doses_too);

/* Fade to the given settings from the next frame on. at_once: set them without a fade. */
void actuator_set(Actuator *actuator, TapPoint tap, double factor, int audible, int at_once);

/* Process the newest `frames` frames of the history; write samples `stride` floats apart. */
void actuator_process(Actuator *actuator, const History *history, float *out, size_t stride,
                      size_t frames);

void actuator_report(const Actuator *actuator, ActuatorReadings *readings);

/* Set the temperatures, such as after a rest. */
void actuator_set_temperatures(Actuator *actuator, const ActuatorSafety *safety);

/* Restore saved temperatures and doses. */
void actuator_set_safety(Actuator *actuator, const ActuatorSafety *safety);

/* Reset the doses for a new day. */
void actuator_begin_day(Actuator *actuator);
