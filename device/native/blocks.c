/* Operations on blocks of frames: peak, interpolation, linear actuator. */

#include "blocks.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

/* The bits of non-negative floats, read as integers, sort in the order of the floats; NaN sorts last. */
#define PEAK(type, bits, sign)                                                                     \
    do {                                                                                           \
        const char *at = frames;                                                                   \
        bits largest = 0, now;                                                                     \
        type peak;                                                                                 \
        for (size_t k = 0; k < count; k++) {                                                       \
            memcpy(&now, at + k * sizeof now, sizeof now);                                         \
            now &= ~(bits)(sign);                                                                  \
            largest = now > largest ? now : largest;                                               \
        }                                                                                          \
        memcpy(&peak, &largest, sizeof peak);                                                      \
        return (double)peak;                                                                       \
    } while (0)

double blocks_peak(const void *frames, size_t count, int is_double)
{
    if (is_double)
        PEAK(double, uint64_t, 0x8000000000000000u);
    PEAK(float, uint32_t, 0x80000000u);
}

/* Compute the weights of the frames at -1, 0, 1 and 2 for cubic Lagrange interpolation at s, 0 to 1. */
static void weigh(double s, double weights[4])
{
    const double before = s + 1.0, after = s - 1.0, beyond = s - 2.0;
    const double outer = s * after, inner = before * beyond;
    weights[0] = outer * (beyond * (-1.0 / 6.0));
    weights[1] = inner * (after * 0.5);
    weights[2] = inner * (s * -0.5);
    weights[3] = outer * (before * (1.0 / 6.0));
}

static void interpolate(const float *ring, size_t capacity, size_t channels, float *out,
                        size_t frames, size_t row, double fraction, double step)
{
    for (size_t k = 0; k < frames; k++, out += channels) {
        const double at = fraction + (double)k * step, whole = floor(at);
        double weights[4];
        weigh(at - whole, weights);
        size_t place = row + (size_t)whole;
        const float *taps[4];
        for (int tap = 0; tap < 4; tap++, place++) {
            if (place >= capacity)
                place %= capacity;
            taps[tap] = ring + place * channels;
        }
        for (size_t channel = 0; channel < channels; channel++)
            out[channel] =
                (float)(weights[0] * taps[0][channel] + weights[1] * taps[1][channel] +
                        weights[2] * taps[2][channel] + weights[3] * taps[3][channel]);
    }
}

const char *blocks_cubic(const View *ring, const View *out, size_t row, double fraction, double step)
{
    if (ring->ndim != 2 || out->ndim != 2 || ring->shape[1] != out->shape[1])
        return "ring, out: not both (frames, channels) of as many channels";
    if (ring->shape[0] < 1 || row >= ring->shape[0])
        return "row: not in the ring";
    if (!(fraction >= 0.0 && fraction < 1.0))
        return "fraction: not in 0 to 1";
    if (!(step > 0.0 && step * (double)out->shape[0] < 1e15))
        return "step: not above 0, or beyond all counting";
    interpolate(ring->buf, ring->shape[0], ring->shape[1], out->buf, out->shape[0], row, fraction,
                step);
    return NULL;
}

/* The linear actuator must use the same operations in the same order as device/rig/actuator.py, so that both
 * round identically. */
#define TAPS 4
#define SECTIONS 2
#define COEFFICIENTS 6
#define STATE (2 * SECTIONS + TAPS)
#define TOGETHER 512

/* Filter the volts with two all-pole second-order sections. Volts that are NaN or above `limit` in magnitude
 * become 0; return their number. */
static size_t pass_poles(const double *restrict volts, size_t frames, double limit,
                         const double *poles, double *restrict state, double *restrict filtered)
{
    const double gain = poles[0], a1 = poles[4], a2 = poles[5];
    const double *next = poles + COEFFICIENTS, next_gain = next[0], next_a1 = next[4], next_a2 = next[5];
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

/* Compute one quantity with a 4-tap FIR filter. `recent` begins 3 frames before the first output frame. */
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
