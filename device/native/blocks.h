/* What is done to blocks of frames; device/blocks.py calls it by ctypes. */

#pragma once

#include <stddef.h>
#include <stdint.h>

#define API __attribute__((visibility("default")))

/* An array of numbers, one row after another. */
typedef struct {
    void *buf;
    size_t ndim, shape[3], len; /* len: in bytes */
} View;

/* Compiled for every processor and for those with wide registers, with the same operations on each
 * number, so all give the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && \
    !defined(__clang__) && !defined(ONE_MACHINE) /* clang's versions of one function do not link */
#define SIMD_CLONES __attribute__((target_clones("avx2", "default")))
#else
#define SIMD_CLONES
#endif

/* Let numbers under 1e-307 count as 0, and return what `usual_numbers` needs. What decays would
 * otherwise stay at such numbers, with which many processors compute tens of times as slowly. */
#if defined(__SSE2__)
#include <xmmintrin.h>
static inline unsigned long long flush_tiny_numbers(void)
{
    const unsigned int before = _mm_getcsr();
    _mm_setcsr(before | 0x8040u); /* results and operands */
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

/* The largest magnitude; NaN if any sample is none. */
API double blocks_peak(const void *frames, size_t count, int is_double);

/* Those below return NULL, or what does not fit; then nothing was done. */

/* Fill a block with frames between those of a ring: frame k is at fraction + k step after that behind
 * `row`. */
API const char *blocks_cubic(const View *ring, const View *out, size_t row, double fraction, double step);

/* Move the linear actuator by volts from start to stop: volts, poles, state, taps, moved. */
API const char *blocks_linear_motion(const View views[5], size_t start, size_t stop, double limit,
                                     size_t *replaced);

/* Move a rig by its models: volts, moved, model, table, steps, map of a sample, coarse map, state, report.
 * numbers: start, stop, length of the first block and of the others, model (0: the cheapest that suffices,
 * 1: linear, 2: non-linear). */
API const char *blocks_move_rig(const View views[9], const size_t numbers[5]);
