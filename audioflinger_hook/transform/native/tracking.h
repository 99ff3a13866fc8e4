/* Partials followed from hop to hop. */

#pragma once

#include "onsets.h"

/* The slots of one channel's oscillators: two sets of partials_max and onset_partials_max, as one may live
 * while another fades. Frequencies in Hz of vibration, amplitudes in full scale, phases in cycles. */
typedef struct {
    double *hz, *amplitude, *phase;
    double *alive; /* 1 or 0 */
    /* Of partials that were born of an onset, and are held: */
    double *held_first, *held_last; /* bands by which they are heard */
    double *held_loudness;          /* the power of those at their birth */
    double *held_hops;              /* that are left, and one; 0 of all others */
    double *held_amplitude;         /* while they are heard */
    double *held_weight;            /* what the law was taken to leave of the sound's level */
    double *lacking;                /* to that amplitude, within one call */
    double *start_sum;              /* one number: of the amplitudes at the hop's start */
} Slots;

enum { SLOT_ARRAYS = 11 }; /* all but start_sum */

/* What keeps a partial that was born of an onset. */
typedef struct {
    double amplitude, weight, loudness;
    Group group;
} Held;

/* What each slot does in one hop. A slot at amplitude 0 at both ends is idle. */
typedef struct {
    double *start_hz, *end_hz, *start_amplitude, *end_amplitude, *start_phase;
} Glides;

/* Partials to follow, ascending in frequency; partials_max at most. */
typedef struct {
    const double *audio_hz, *hz, *amplitude;
    size_t count;
} Partials;

/* Bytes of work space that `tracking_follow` needs. */
size_t tracking_work(const Settings *settings);

/* Whether any slot sounds after the last hop. */
int tracking_sounds(const Settings *settings, const Slots *slots);

INLINED size_t tracking_slots(const Settings *s) { return 2 * (s->partials_max + s->onset_partials_max); }

/* Whether a partial is held that no window has shown yet. */
int tracking_holds(const Settings *settings, const Slots *slots);

/* The larger of both ends' sums of amplitudes, of the last hop that was written. */
double tracking_loudest_sum(const Settings *settings, const Slots *slots);

/* How far from an onset partial its true frequency may be, in Hz of vibration. */
double tracking_near_hz(const Settings *settings, double hz);

/* The amplitudes near to a vibration frequency at the end of the hop. */
double tracking_sounding_near(const Settings *settings, const Slots *slots, double hz);

/* Set hz and phase to those of the strongest partial near to hz, at before_end_s seconds before the
 * end of the hop. Return 1; 0 where there is none, or partials are not merged. */
double tracking_join(const Settings *settings, const Slots *slots, double before_end_s, double *hz,
                     double *phase);

/* Take over a partial in the middle of its vibration, and hold it; at the end of a hop. */
void tracking_adopt(const Settings *settings, Slots *slots, double hz, double phase,
                    double amplitude, Held held);

/* Write one hop of glides: on to the partials that stand at its end. room: what those that are held
 * may add to the sum of amplitudes. left: what the law leaves of the level of what the window shows,
 * which tells tones apart that were one for an onset. */
void tracking_follow(const Settings *settings, Slots *slots, Glides *glides, Partials partials,
                     double room, double left, const Onsets *onsets, void *work);

/* Write one hop in which every partial that sounds dies away. */
void tracking_fade(const Settings *settings, Slots *slots, Glides *glides);

/* Write one hop in which every slot is idle. */
void tracking_rest(const Settings *settings, Glides *glides);

/* Partials that are one: sums of their powers, and of power times frequency. */
typedef struct {
    double power, weighted_hz, strongest;
} PartialGroup;

/* Work space, and the merged partials with the share of the strongest in each. */
typedef struct {
    double *centres;        /* what sounds, then what has begun: most_alive + partials_max */
    PartialGroup *gathered; /* as many */
    struct {
        double *audio_hz, *hz, *amplitude, *dominance;
    } merged;
} Merging;

/* How close a partial must be to one at this frequency to be part of it, in Hz of vibration. */
INLINED double merging_hz(const Settings *s, double hz)
{
    return larger(s->merge_hz, s->merge_ratio * hz);
}

/* Merge partials. The first `sounding` centres are frequencies that sound. */
Partials merging_merge(const Settings *settings, Merging *merging, size_t sounding, Partials partials);
