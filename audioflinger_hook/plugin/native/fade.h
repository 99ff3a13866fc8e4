/* A factor that moves in a straight line to each new goal. */

#ifndef CUSHION_FADE_H
#define CUSHION_FADE_H

#include <stddef.h>

typedef struct {
    double now, goal, step;
} Fade;

static inline void fade_reset(Fade *fade, double value)
{
    fade->now = fade->goal = value;
    fade->step = 0.0;
}

/* Reach a goal in so many frames from now, 1 at least. */
static inline void fade_to(Fade *fade, double goal, size_t frames)
{
    if (goal == fade->goal)
        return;
    fade->goal = goal;
    fade->step = (goal - fade->now) / (double)(frames ? frames : 1);
}

/* Multiply samples; a factor of exactly 1 leaves them as they are. */
static inline void fade_apply(Fade *fade, float *samples, size_t count)
{
    size_t at = 0;
    for (; at < count && fade->now != fade->goal; at++) {
        const double next = fade->now + fade->step;
        const int past = fade->step > 0.0 ? next >= fade->goal : next <= fade->goal;
        fade->now = past ? fade->goal : next;
        samples[at] = (float)(fade->now * samples[at]);
    }
    if (fade->now != 1.0)
        for (; at < count; at++)
            samples[at] = (float)(fade->now * samples[at]);
}

#endif
