/* Partials followed from hop to hop. */

#ifndef CUSHION_TRACKING_H
#define CUSHION_TRACKING_H

#include "settings.h"

/* The slots of one voice's oscillators: two sets of partials_max, as one set may live while another
 * fades. Frequencies in Hz of vibration, amplitudes in full scale, phases in cycles. */
typedef struct {
    double *hz, *amplitude, *phase;
    double *alive; /* 1 or 0 */
} Slots;

/* What each slot does in one hop. A slot at amplitude 0 at both ends is idle. */
typedef struct {
    double *start_hz, *end_hz, *start_amplitude, *end_amplitude, *start_phase;
} Glides;

/* Partials to follow, ascending in frequency; at least one and partials_max at most. */
typedef struct {
    const double *audio_hz, *hz, *amplitude;
    size_t count;
} Partials;

/* Bytes of work space that `tracking_follow` needs. */
size_t tracking_work(size_t partials_max);

/* Whether any slot sounds after the last hop. */
int tracking_sounds(const Settings *settings, const Slots *slots);

/* Write one hop of glides: on to the partials that stand at its end. */
void tracking_follow(const Settings *settings, Slots *slots, Glides *glides, Partials partials,
                     void *work);

/* Write one hop of glides in which every partial that sounds dies away. */
void tracking_fade(const Settings *settings, Slots *slots, Glides *glides);

/* Write one hop of glides in which every slot is idle. */
void tracking_rest(const Settings *settings, Glides *glides);

#endif
