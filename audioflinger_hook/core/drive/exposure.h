/* Exposure to one actuator's vibration (ISO 2631-1): the seat's acceleration that the drive causes,
 * weighted and added up over a day, and the gain that caps the dose. device/drive/exposure/ designs it. */

#pragma once

#include "../../transform/native/filter.h"
#include "../core.h"

enum { DECIMATION_TAPS_MAX = 1024, MOTION_TAPS_MAX = 8 };

typedef struct {
    size_t factor; /* of the decimation */
    size_t decimation_taps, motion_taps;
    const double *decimation, *motion_fir; /* motion_taps 0: none */
    CascadeDesign motion, weighting, above; /* above: what is over 80 Hz */
    double m_s2_per_full_scale; /* volts at full scale; the motion is of a volt */
    double period_s;            /* of the decimated signal */
    double running_share;
    double cap_a8_m_s2, cap_vdv; /* 0: none */
    size_t reading_frames;       /* from one gain to the next */
} ExposureDesign;

typedef struct {
    const ExposureDesign *design;
    double *past; /* the last decimation_taps of drive, a ring */
    size_t next, phase, until_reading;
    double recent[MOTION_TAPS_MAX];
    Cascade motion, weighting, above;
    CoreDose sums;   /* its time_s: of before */
    uint64_t frames; /* of the decimated signal, since then */
    double running, gain;
} Exposure;

/* Lay out the exposure's memory; without memory, only count it. */
void exposure_layout(Exposure *exposure, const ExposureDesign *design, Arena *arena);

/* Come to rest; the day's dose stays unless asked. */
void exposure_reset(Exposure *exposure, int doses_too);

/* Take one finite sample of drive. */
void exposure_step(Exposure *exposure, double sample);

/* The dose of the day. */
CoreDose exposure_dose(const Exposure *exposure);

/* Continue a day with these sums. */
void exposure_set_sums(Exposure *exposure, CoreDose sums);
