/* Onset partials: they are born of an onset and play until the analysis knows what has begun. */

#pragma once

#include "speech.h"
#include "tracking.h"

/* One of them; all of it is state, and lies in one row of numbers. */
typedef struct {
    double sounds; /* 1 or 0 */
    double first_band, last_band;
    double hz, phase, amplitude;
    double goal; /* It grows to this amplitude. */
    double base; /* This amplitude sounds there without it. */
    double weight; /* The amplitude mapping leaves it this share of the level. */
    double age; /* It counts ticks. */
    double joins; /* 1 where it has frequency and phase of a partial of the tracker, or 0 */
} OnsetPartial;

/* What their frequencies and amplitudes are estimated from. */
typedef struct {
    const Onsets *onsets;
    const Speech *speech;
} OnsetSources;

/* Whether any sounds. */
int onset_partials_sounds(const Settings *settings, const OnsetPartial *partials);

/* Start partials for the onset that was found. ticks_left: to the end of the hop that the slots have
 * written last. */
void onset_partials_start(const Settings *settings, OnsetPartial *partials, OnsetSources sources,
                         const Slots *slots, size_t ticks_left);

/* Write one tick of glides, onset_partials_max slots; while more is told of the onset, follow that. */
void onset_partials_play(const Settings *settings, OnsetPartial *partials, OnsetSources sources,
                         const Slots *slots, Glides *glides);

/* Let those that are told as well as they can be go over to the tracker. */
void onset_partials_hand_over(const Settings *settings, OnsetPartial *partials, const Onsets *onsets,
                              Slots *slots);
