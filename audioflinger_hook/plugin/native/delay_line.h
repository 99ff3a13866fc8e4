/* A delay of samples, changed without a click; and a gain that moves over one buffer. */

#ifndef CUSHION_PLUGIN_DELAY_LINE_H
#define CUSHION_PLUGIN_DELAY_LINE_H

#include <stddef.h>

typedef struct {
    float *past;     /* a ring */
    size_t capacity; /* of the ring, a power of 2 */
    size_t next;     /* where the next sample goes */
    size_t delay;    /* frames */
    size_t before;   /* the delay that is faded out */
    size_t fading;   /* frames of the cross-fade that are left */
    size_t fade_frames;
} DelayLine;

/* Make a line of up to so many seconds; return 0 where memory is lacking. */
int delay_open(DelayLine *line, double longest_s, double samplerate);

void delay_close(DelayLine *line);

/* Forget the past, and take a delay at once. */
void delay_reset(DelayLine *line, size_t frames);

/* Delay samples in place, from now on by so many frames. */
void delay_process(DelayLine *line, float *samples, size_t count, size_t frames);

#endif
