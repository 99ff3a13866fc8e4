/* Detects speech, and computes the gain of each partial during speech. */

#pragma once

#include "settings.h"

#define OCTAVES 6

/* Indices of linear ramps in speech_ramps, which holds the start and the end of each ramp. */
enum { VOICED, QUIET, VOICING, SWING, BALANCE, RESTING, SPARED, EXCESS, BACKGROUND, BETWEEN, RAMPS };

/* State of one channel. All members are doubles, and 0 at rest. Arrays are levels in dB relative to
 * speech_silent_power. level, loudness, background: each octave's level of sound, voice and background. */
typedef struct {
    double probability, hops_to_rest;
    double voiced, voicing, steady, log_pitch;
    double swing, balance, peak;
    double fast[OCTAVES], slow[OCTAVES]; /* average levels: upper five octaves; last, all octaves of vowels */
    double level[OCTAVES], loudness[OCTAVES], background[OCTAVES];
} Speech;

/* Return the size of the work space of `speech_update`, in doubles. */
INLINED size_t speech_work(const Settings *s) { return s->bins + s->speech_log_pitches.length; }

/* Update the detection with the spectrum of a hop: `bins` real and imaginary parts. */
void speech_update(const Settings *s, Speech *speech, const double *real,
                 const double *imaginary, double *work);

/* Update the detection with a silent hop. */
void speech_pause(const Settings *s, Speech *speech);

/* Return the gain, 0 to 1, of a partial at an audio frequency in this hop. */
double speech_gain(const Settings *s, const Speech *speech, double audio_hz);

/* Return the gain, 0 to 1, for a frequency that is too uncertain to compare with the pitch's harmonics. */
double speech_coarse_gain(const Settings *s, const Speech *speech, double audio_hz);

/* Return whether the state is cleared. */
INLINED int speech_is_at_rest(const Speech *speech) { return !(speech->hops_to_rest > 0.0); }
