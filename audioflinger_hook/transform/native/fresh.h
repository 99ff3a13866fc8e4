/* Fresh partials: born of an onset, on their own until the analysis knows what has begun. */

#ifndef CUSHION_FRESH_H
#define CUSHION_FRESH_H

#include "follower.h"
#include "onsets.h"
#include "settings.h"
#include "speech.h"
#include "tracking.h"

/* One of them; all of it is state, and lies in one row of numbers. */
typedef struct {
    double sounds; /* 1 or 0 */
    double first_band, last_band;
    double hz, phase, amplitude;
    double goal; /* amplitude that it grows to */
    double base; /* amplitude that sounds there without it */
    double weight; /* what the law was taken to leave it of the level */
    double age;    /* ticks */
} Fresh;

/* By what they are told. */
typedef struct {
    const Onsets *onsets;
    const Follower *follower;
    const Speech *speech;
} Heard;

/* Whether any sounds. */
int fresh_sounds(const Settings *settings, const Fresh *fresh);

/* Let what was heard begin begin. */
void fresh_bear(const Settings *settings, Fresh *fresh, Heard heard, const Slots *slots);

/* Write one tick of glides, fresh_max slots; while more is told of the onset, follow that. */
void fresh_play(const Settings *settings, Fresh *fresh, Heard heard, const Slots *slots,
                Glides *glides);

/* Let those that are told as well as they can be go over to the tracker. */
void fresh_hand_over(const Settings *settings, Fresh *fresh, const Onsets *onsets, Slots *slots);

#endif
