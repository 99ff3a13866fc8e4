/* A factor that moves to each new goal: in a straight line, or from 0 to 1 and back smoothly. */

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

static inline double fade_step(Fade *fade)
{
    const double next = fade->now + fade->step;
    const int past = fade->step > 0.0 ? next >= fade->goal : next <= fade->goal;
    fade->now = past ? fade->goal : next;
    return fade->now;
}

/* Multiply samples; a factor of exactly 1 leaves them as they are. */
static inline void fade_apply(Fade *fade, float *samples, size_t count)
{
    size_t at = 0;
    for (; at < count && fade->now != fade->goal; at++)
        samples[at] = (float)(fade_step(fade) * samples[at]);
    if (fade->now != 1.0)
        for (; at < count; at++)
            samples[at] = (float)(fade->now * samples[at]);
}

/* The same between 0 and 1, without a bend at either end. */
static inline void fade_apply_smoothly(Fade *fade, float *samples, size_t count)
{
    size_t at = 0;
    for (; at < count && fade->now != fade->goal; at++) {
        const double x = fade_step(fade);
        samples[at] = (float)(x * x * (3.0 - 2.0 * x) * samples[at]);
    }
    if (fade->now != 1.0)
        for (; at < count; at++)
            samples[at] = (float)(fade->now * samples[at]);
}

#endif
