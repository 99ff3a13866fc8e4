/* One actuator's share of a vibration: damping, level, delay, and whether it may be felt.
 *
 * The daemon's wishes come from the page that it shares with the plugin. */

#ifndef CUSHION_ACTUATOR_H
#define CUSHION_ACTUATOR_H

#include "delay_line.h"
#include "fade.h"
#include "level_meter.h"
#include "page.h"

typedef struct {
    Page *page;
    DelayLine delay;
    Fade gain, audible;
    LevelMeter meter;
    double state[2];
    size_t until_check; /* frames until the next look at the state */
    double loudest;     /* recent peak of the damped drive; its level is lowered above 1 */
    size_t held;        /* frames until that peak begins to fall */
    uint64_t frames;
    int fresh;
} Actuator;

/* Make an actuator, NULL where memory is lacking. Allocates. */
Actuator *actuator_open(unsigned long samplerate);

void actuator_close(Actuator *actuator);

void actuator_reset(Actuator *actuator);

/* Process any number of frames, in place or not. Real-time safe. slot: of the page. */
void actuator_process(Actuator *actuator, size_t slot, const float *input, float *output,
                      size_t frames);

#endif
