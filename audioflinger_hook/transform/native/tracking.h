/* Partials: oscillators that follow principal frequencies from hop to hop, or that start at an onset. */

#pragma once

#include "onsets.h"
#include "speech.h"

/* An onset partial whose amplitude is held until the analysis window (about 46 ms) contains the tone. */
typedef struct {
    double amplitude, weight; /* weight: share of the onset's level */
    double power;             /* power of `bands` at the start of the hold time */
    Group bands;
    double hops; /* remaining hold time in hops, plus 1; 0: not held */
} Held;

/* Oscillator slots of one channel: two for each possible partial, because ended partials still fade out.
 * Frequencies are in Hz of vibration, amplitudes relative to full scale, phases in cycles. */
typedef struct {
    double *hz, *amplitude, *phase;
    double *alive;   /* 1 if the slot sounds at the end of the hop, else 0 */
    double *lacking; /* held amplitude minus the sum of amplitudes near the slot's frequency, at least 0 */
    Held *held;
    double start_sum; /* sum of amplitudes at the hop's start */
} Slots;

enum { SLOT_ARRAYS = 5 }; /* arrays of doubles in Slots */

/* Frequency and amplitude of each slot at both ends of a hop or tick. Idle slots have the amplitudes 0, 0. */
typedef struct {
    double *start_hz, *end_hz, *start_amplitude, *end_amplitude, *start_phase;
} Glides;

/* Partials that the slots follow, ascending in frequency, at most partials_max. hz: vibration frequency. */
typedef struct {
    const double *audio_hz, *hz, *amplitude;
    size_t count;
} Partials;

/* Partials to merge: sums of power and of power times frequency; power of the strongest partial. */
typedef struct {
    double power, weighted_hz, strongest;
} PartialGroup;

/* Work space and result of merging. dominance: the strongest partial's share of its group's power. */
typedef struct {
    double *centres;        /* centres of groups, Hz of vibration: sounding slots, then new groups */
    PartialGroup *gathered; /* one group per centre */
    struct {
        double *audio_hz, *hz, *amplitude, *dominance;
    } merged;
} Merging;

/* The sounding slot nearest to a partial, and the slot that continues this partial. */
typedef struct {
    size_t nearest; /* nearest sounding slot; 0 if none sounds */
    size_t slot;    /* slot that continues the partial; tracking_slots if none does */
    double gap_hz;  /* distance to `nearest`; infinite if none sounds */
} Match;

/* For each frequency of one list: index and distance of the nearest frequency of another list. */
typedef struct {
    uint64_t *nearest;
    double *gap_hz;
} Neighbours;

/* Sounding slots, the nearest partial of each, and the nearest sounding slot of each partial. */
typedef struct {
    size_t *slot;
    double *hz;
    Neighbours of_slots, of_partials;
} Alive;

typedef struct {
    Match *matches;
    Alive alive;
    Merging merging;
} TrackingWork;

TrackingWork tracking_layout(const Settings *s, Arena *arena);

/* Return whether any slot sounds at the end of the latest hop. */
int tracking_sounds(const Settings *s, const Slots *slots);

INLINED size_t tracking_slots(const Settings *s) { return 2 * (s->partials_max + s->onset_partials_max); }

int tracking_holds(const Settings *s, const Slots *slots);

/* Return the sum of amplitudes at the start or the end of the latest hop, whichever is larger. */
double tracking_loudest_sum(const Settings *s, const Slots *slots);

/* Return the distance, Hz of vibration, below which a partial counts as near an onset partial at `hz`. */
double tracking_near_hz(const Settings *s, double hz);

/* Return the sum of amplitudes within `tracking_near_hz` of a vibration frequency, at the hop's end. */
double tracking_sounding_near(const Settings *s, const Slots *slots, double hz);

/* Set *hz and *phase to those of the strongest partial within `tracking_near_hz` of *hz, and return 1. *phase
 * is the phase before_end_s seconds before the hop's end. If merging is off, or if no such partial exceeds
 * joined_from, change nothing and return 0. */
double tracking_join(const Settings *s, const Slots *slots, double before_end_s, double *hz, double *phase);

/* At the end of a hop, continue an onset partial in a free slot without a phase jump, and hold its amplitude.
 * Do nothing if the largest allowed number of slots already sounds. */
void tracking_adopt(const Settings *s, Slots *slots, double hz, double phase, double amplitude, Held held);

/* Write the glides of one hop towards `partials`. room: limit for the summed amplitudes of held partials. left: result of `levels_left_by_law`. */
void tracking_follow(const Settings *s, Slots *slots, Glides *glides, Partials partials,
                     double room, double left, const Onsets *onsets, TrackingWork *work);

/* Write the glides of one hop in which all sounding partials fade out. */
void tracking_fade(const Settings *s, Slots *slots, Glides *glides);

/* Write the glides of one hop in which all slots are idle. */
void tracking_rest(const Settings *s, Glides *glides);

/* Return the distance up to which partials near a frequency are merged, in Hz of vibration. */
INLINED double merging_hz(const Settings *s, double hz)
{
    return larger(s->merge_hz, s->merge_ratio * hz);
}

/* Merge close partials. merging->centres begins with the frequencies of `sounding` slots. */
Partials merging_merge(const Settings *s, Merging *merging, size_t sounding, Partials partials);

/* State of a partial from its onset until the tracker continues it. */
typedef struct {
    double sounds; /* 1 or 0 */
    Group bands;
    double hz, phase, amplitude;
    double goal; /* amplitude after the attack */
    double base; /* sum of the other amplitudes near this frequency at the onset */
    double weight; /* amplitude as a share of the onset's level */
    double age; /* ticks since the onset */
    double joins; /* 1 if the partial started with frequency and phase of a tracked partial, else 0 */
} OnsetPartial;

/* Inputs of the estimates of onset partials. */
typedef struct {
    const Onsets *onsets;
    const Speech *speech;
} OnsetSources;

int onset_partials_sounds(const Settings *s, const OnsetPartial *partials);

/* Start partials for the latest onset. ticks_left: ticks until the end of the hop that `slots` describes. */
void onset_partials_start(const Settings *s, OnsetPartial *partials, OnsetSources sources,
                         const Slots *slots, size_t ticks_left);

/* Update the estimates; write the glides of one tick for all onset_partials_max slots. */
void onset_partials_play(const Settings *s, OnsetPartial *partials, OnsetSources sources,
                         const Slots *slots, Glides *glides);

/* At the end of a hop, hand the partials with final estimates over to the tracker. */
void onset_partials_hand_over(const Settings *s, OnsetPartial *partials, const Onsets *onsets, Slots *slots);
