/* Speech heard in the sound, and what is left of each partial while it is. */

#pragma once

#include "settings.h"

#define OCTAVES 6

/* The state of one channel, doubles alone; all 0 at rest, and any numbers do no harm. Levels in dB over
 * speech_silent_power. */
typedef struct {
    double probability, hops_to_rest;
    double voiced, voicing, steady, log_pitch;
    double swing, balance, peak;
    double fast[OCTAVES], slow[OCTAVES]; /* of the octaves but the first, then of the vowels */
    double level[OCTAVES], loudness[OCTAVES], background[OCTAVES];
} Speech;

#define SPEECH_STATES (sizeof(Speech) / sizeof(double))

/* Return what of speech's settings does not fit the rest; NULL where all of it does. */
const char *speech_misfit(const Settings *settings);

/* Doubles of work space that `speech_update` needs. */
INLINED size_t speech_work(const Settings *s) { return s->bins + s->speech_log_pitches.length; }

/* Take the next hop's spectrum, `bins` real and imaginary parts. */
void speech_update(const Settings *settings, Speech *speech, const double *real,
                 const double *imaginary, double *work);

/* Take a hop in which nothing is heard. */
void speech_pause(const Settings *settings, Speech *speech);

/* The factor on a partial of this audio frequency in this hop, 0 to 1. */
double speech_gain(const Settings *settings, const Speech *speech, double audio_hz);

/* The same where the frequency is not known well enough to tell whether it is a harmonic's. */
double speech_coarse_gain(const Settings *settings, const Speech *speech, double audio_hz);

/* Whether its memory is empty. */
INLINED int speech_is_at_rest(const Speech *speech) { return !(speech->hops_to_rest > 0.0); }
