/* The oscillators of one tick, played so that they are felt as strongly as is wanted. */

#pragma once

#include "synthesis.h"

/* What goes on from tick to tick; all of it is state. At the end of the last tick: */
typedef struct {
    double wanted; /* strength */
    double beat;   /* squared ratio of the sum of what beats to its root of squares */
    double moved;  /* power of the sensitivity by which amplitudes were moved */
    double gain;   /* on the partials' amplitudes */
    double rises;  /* 1 where the hop's sum of amplitudes rises, or 0 */
} Drive;

#define DRIVE_STATES (sizeof(Drive) / sizeof(double))

/* One channel's. hop: what its slots do in the hop under way, state as well. */
typedef struct {
    Drive *drive;
    Glides hop;
} Oscillators;

/* Doubles of work space that `oscillators_play` needs. */
size_t oscillators_work(const Settings *settings);

/* Take note of new glides in `hop`. */
void oscillators_begin_hop(const Settings *settings, const Oscillators *oscillators);

/* A tick of one channel. tick: its number in the hop. onset_partials: NULL where none sounds. wanted:
 * strength at its end. */
typedef struct {
    size_t tick;
    const Glides *onset_partials;
    double wanted;
    GlideLog *log;
    size_t channel;
} OscillatorTick;

/* Write a tick at the low rate, (tick_steps,); return in how many of its steps amplitudes were limited. */
size_t oscillators_play(const Settings *settings, const Oscillators *oscillators, OscillatorTick now,
                        double *low_rate, double *work);

/* Whether the numbers are such as can be. */
int oscillators_are_possible(const Settings *settings, const Drive *drive);
