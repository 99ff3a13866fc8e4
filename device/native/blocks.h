/* Operations on blocks of frames, which device/blocks.py calls with ctypes. */

#pragma once

#include <stddef.h>

#define API __attribute__((visibility("default")))

/* A C-contiguous array of numbers. */
typedef struct {
    void *buf;
    size_t ndim, shape[3], len; /* len: bytes */
} View;

/* On x86-64 with GCC and glibc, SIMD_CLONES compiles two versions of a function: one for AVX2, one for
 * all other processors. Both give identical results. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && \
    !defined(__clang__) && !defined(ONE_MACHINE) /* clang 14 and older have no target_clones */
#define SIMD_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define SIMD_CLONES
#endif

/* On x86 with SSE2 and on 64-bit ARM, make the processor treat denormal numbers as 0. Return the previous
 * value of the control register, which `usual_numbers` restores. Decaying states would become denormal, and
 * many processors are slow with denormal numbers. */
#if defined(__SSE2__)
#include <xmmintrin.h>
static inline unsigned long long flush_tiny_numbers(void)
{
    const unsigned int before = _mm_getcsr();
    _mm_setcsr(before | 0x8040u); /* flush denormal results and operands */
    return before;
}

static inline void usual_numbers(unsigned long long before) { _mm_setcsr((unsigned int)before); }
#elif defined(__aarch64__) && defined(__GNUC__)
static inline unsigned long long flush_tiny_numbers(void)
{
    unsigned long long before;
    __asm__ __volatile__("mrs %0, fpcr" : "=r"(before));
    __asm__ __volatile__("msr fpcr, %0" : : "r"(before | 1ull << 24));
    return before;
}

static inline void usual_numbers(unsigned long long before)
{
    __asm__ __volatile__("msr fpcr, %0" : : "r"(before));
}
#else
static inline unsigned long long flush_tiny_numbers(void) { return 0; }

static inline void usual_numbers(unsigned long long before) { (void)before; }
#endif

/* Return the largest magnitude of `count` samples; NaN if any sample is NaN, 0 if count is 0. */
API double blocks_peak(const void *frames, size_t count, int is_double);

/* The functions below return NULL, or an error message if an argument is invalid. */

/* Interpolate a ring buffer cubically into `out`; both are (frames, channels). Frame k of `out` is at
 * position row + 1 + fraction + k * step of the ring. */
API const char *blocks_cubic(const View *ring, const View *out, size_t row, double fraction, double step);

/* Simulate the linear actuator in the frames from start to stop - 1. views: volts, poles, state, taps, moved.
 * Volts that are NaN or above `limit` in magnitude count as 0; *replaced receives their number. */
API const char *blocks_linear_motion(const View views[5], size_t start, size_t stop, double limit,
                                     size_t *replaced);

/* Simulate a rig. views: volts, moved, Model, table, steps, by_sample, by_coarse, State, report; see
 * rig_steps.h. numbers: start, stop, frames of the first block, frames of the other blocks, model. The model
 * is 0 for the cheapest sufficient model, 1 for the linear model, or 2 for the non-linear model. */
API const char *blocks_move_rig(const View views[9], const size_t numbers[5]);
