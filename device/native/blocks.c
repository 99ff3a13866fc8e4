/* What is done to every block of frames; blocks.py and ring.py say the same in NumPy. */

#include "blocks.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

/* Without their sign, numbers are in the order of their bits, and what is no number is above all. */
#define LARGEST(bits, sign, at, count, largest)                                                    \
    do {                                                                                           \
        for (size_t k = 0; k < (count); k++) {                                                     \
            bits now;                                                                              \
            memcpy(&now, (const char *)(at) + k * sizeof now, sizeof now);                         \
            now &= ~(bits)(sign);                                                                  \
            (largest) = now > (largest) ? now : (largest);                                         \
        }                                                                                          \
    } while (0)

double blocks_peak(const void *frames, size_t count, int is_double)
{
    if (is_double) {
        uint64_t largest = 0;
        double magnitude;
        LARGEST(uint64_t, 0x8000000000000000u, frames, count, largest);
        memcpy(&magnitude, &largest, sizeof magnitude);
        return magnitude;
    }
    uint32_t largest = 0;
    float magnitude;
    LARGEST(uint32_t, 0x80000000u, frames, count, largest);
    memcpy(&magnitude, &largest, sizeof magnitude);
    return (double)magnitude;
}

/* Lagrange's weights of the frames at -1, 0, 1 and 2 for a place s from 0 to 1. */
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
