/* The linear model of the actuator. rig/actuator.py computes the same with SciPy's sosfilt and NumPy
 * in the same order, and therefore with the same rounding. */

#include "blocks.h"

#include <math.h>
#include <string.h>

#define TAPS 4
#define SECTIONS 2
#define COEFFICIENTS 6
#define STATE (2 * SECTIONS + TAPS)
#define TOGETHER 512

/* Filters the voltage with two transposed second-order sections without zeros. */
static size_t pass_poles(const double *restrict volts, size_t frames, double limit,
                         const double *poles, double *restrict state, double *restrict filtered)
{
    const double gain = poles[0], a1 = poles[4], a2 = poles[5];
    const double next_gain = poles[COEFFICIENTS], next_a1 = poles[COEFFICIENTS + 4],
                 next_a2 = poles[COEFFICIENTS + 5];
    double near = state[0], far = state[1], next_near = state[2], next_far = state[3];
    size_t replaced = 0;
    for (size_t frame = 0; frame < frames; frame++) {
        double drive = volts[frame];
        if (!(fabs(drive) <= limit)) {
            drive = 0.0;
            replaced++;
        }
        const double middle = gain * drive + near;
        near = -a1 * middle + far;
        far = -a2 * middle;
        const double after = next_gain * middle + next_near;
        next_near = -next_a1 * after + next_far;
        next_far = -next_a2 * after;
        filtered[frame] = after;
    }
    state[0] = near;
    state[1] = far;
    state[2] = next_near;
    state[3] = next_far;
    return replaced;
}

/* Computes one quantity from the filtered voltage: three earlier frames, then these. */
SIMD_CLONES static void apply_taps(const double *restrict recent, size_t frames, const double *taps,
                            double *restrict moved)
{
    const double newest = taps[0], one = taps[1], two = taps[2], oldest = taps[3];
    for (size_t frame = 0; frame < frames; frame++)
        moved[frame] = oldest * recent[frame] + two * recent[frame + 1] + one * recent[frame + 2] +
                       newest * recent[frame + 3];
}

enum { VOLTS, POLES, KEPT, WEIGHTS, MOVED };

static const char *misfit_of(const View *views, size_t start, size_t stop)
{
    if (views[VOLTS].ndim != 1 || start > stop || stop > views[VOLTS].shape[0])
        return "start, stop: no part of the volts, (frames,)";
    if (views[POLES].ndim != 2 || views[POLES].shape[0] != SECTIONS ||
        views[POLES].shape[1] != COEFFICIENTS)
        return "poles: not (2, 6)";
    if (views[KEPT].ndim != 1 || views[KEPT].shape[0] != STATE)
        return "state: not (8,)";
    if (views[WEIGHTS].ndim != 2 || views[WEIGHTS].shape[1] != TAPS)
        return "taps: not (quantities, 4)";
    if (views[MOVED].ndim != 2 || views[MOVED].shape[0] != views[WEIGHTS].shape[0] ||
        views[MOVED].shape[1] != views[VOLTS].shape[0])
        return "moved: not (quantities, frames)";
    return NULL;
}

static size_t move(const View *views, size_t start, size_t stop, double limit)
{
    double *state = views[KEPT].buf, *last = state + 2 * SECTIONS;
    const double *volts = views[VOLTS].buf, *taps = views[WEIGHTS].buf;
    const size_t quantities = views[WEIGHTS].shape[0], all = views[VOLTS].shape[0];
    double filtered[TAPS + TOGETHER], *moved = views[MOVED].buf;
    size_t replaced = 0;
    const unsigned long long numbers = flush_tiny_numbers();
    while (start < stop) {
        const size_t left = stop - start, frames = left < TOGETHER ? left : TOGETHER;
        memcpy(filtered, last, TAPS * sizeof(double));
        replaced += pass_poles(volts + start, frames, limit, views[POLES].buf, state,
                               filtered + TAPS);
        for (size_t one = 0; one < quantities; one++)
            apply_taps(filtered + 1, frames, taps + one * TAPS, moved + one * all + start);
        memcpy(last, filtered + frames, TAPS * sizeof(double));
        start += frames;
    }
    usual_numbers(numbers);
    return replaced;
}

const char *blocks_linear_motion(const View views[5], size_t start, size_t stop, double limit,
                                 size_t *replaced)
{
    const char *misfit = misfit_of(views, start, stop);
    if (!misfit)
        *replaced = move(views, start, stop, limit);
    return misfit;
}
