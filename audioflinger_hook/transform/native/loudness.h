/* The loudness follower of one voice: a loudness each hop in, the strength of its vibration out. */

#ifndef CUSHION_LOUDNESS_H
#define CUSHION_LOUDNESS_H

#include "settings.h"

/* State, in dB of loudness. But gain is the factor on the last amplitudes. far_hops counts the hops
 * with loudness far above the programme; negative: far below. */
typedef struct {
    double *programme, *floor, *loud, *steady, *gain, *far_hops;
} Loudness;

/* Numbers in it. */
#define FOLLOWER_NUMBERS 6

/* Whether loudness is followed at all. */
int loudness_is_on(const Settings *settings);

/* Return to what is taken for granted before a stream. */
void loudness_reset(const Settings *settings, Loudness *follower);

/* Take note of a hop without any sound. */
void loudness_rest(const Settings *settings, Loudness *follower);

/* The loudness in dB of a spectrum of `bins`. */
double loudness_loudness_db(const Settings *settings, const double *real, const double *imaginary);

/* Return how strong the next hop vibrates, the root of its partials' sum of squares; 0 where the
 * gate is closed. */
double loudness_strength(const Settings *settings, Loudness *follower, double measured_db);

/* How strong an onset of this level vibrates. power: of the short window's bins. */
double loudness_onset_strength(const Settings *settings, const Loudness *follower,
                               const double *power, double level);

/* Return, and keep, the factor that gives the amplitudes of a hop, 1 or more, their strength. hz: of
 * vibration. */
double loudness_gain(const Settings *settings, Loudness *follower, double strength,
                     const double *hz, const double *amplitude, size_t count);

/* Move amplitudes to where a body feels them best, at the same strength, where their sum `total` is
 * over the ceiling; the more, the more it is over. Return their sum. */
double loudness_concentrate(const Settings *settings, const double *hz, double *amplitude,
                            size_t count, double total);

/* Whether the numbers are such as a follower can have. */
int loudness_is_possible(const Settings *settings, const Loudness *follower);

#endif
