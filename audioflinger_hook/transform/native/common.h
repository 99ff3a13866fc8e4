/* Constants, small functions and a memory arena, which transform and drive share. */

#pragma once

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define PI 3.14159265358979323846

/* Smallest normal double. Divisors that may be 0 are raised to TINY. Samples with |x| < TINY count as 0. */
#define TINY 2.2250738585072014e-308

/* On x86-64 with GCC and glibc, compile a function for baseline, AVX2 and AVX-512 processors; the dynamic
 * loader selects one version. All versions do the same operations on each number, for identical bits. */
#if !defined(__x86_64__) || !defined(__GLIBC__) || !defined(__GNUC__) || defined(__clang__) || \
    defined(ONE_MACHINE) /* clang cannot link function clones */
#define SIMD_CLONES
#define SIMD_CLONES_NARROW
#elif defined(TWO_MACHINES)
#define SIMD_CLONES __attribute__((target_clones("avx2", "default")))
#define SIMD_CLONES_NARROW SIMD_CLONES
#else
#define SIMD_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
/* For short loops, which would leave AVX-512 registers partly empty. */
#define SIMD_CLONES_NARROW __attribute__((target_clones("avx2", "default")))
#endif

/* Promise the compiler that no iteration of the next loop reads what another iteration writes. */
#if defined(__clang__)
#define NO_ALIAS _Pragma("clang loop vectorize(assume_safety)")
#else
#define NO_ALIAS _Pragma("GCC ivdep")
#endif

/* Always inline a function, so that it uses the instruction set of its caller. */
#define INLINED static inline __attribute__((always_inline))

INLINED double larger(double one, double other) { return one > other ? one : other; }

INLINED double smaller(double one, double other) { return one < other ? one : other; }

/* Return a polynomial that rises from 0 at x = 0 to 1 at x = 1. Slope and curvature are 0 at both ends, so
 * that a fade along it adds least at high frequencies. */
INLINED double smooth_step(double x) { return x * x * x * (10.0 + x * (6.0 * x - 15.0)); }

INLINED double clip(double number, double low, double high) { return larger(low, smaller(high, number)); }

/* Return the sum. The fixed order of additions gives the same bits on every machine. */
INLINED double sum(const double *numbers, size_t count)
{
    double total = 0.0;
    for (size_t one = 0; one < count; one++)
        total += numbers[one];
    return total;
}

/* Return the largest number, or 0 if no number is above 0. */
INLINED double maximum(const double *numbers, size_t count)
{
    double most = 0.0;
    for (size_t one = 0; one < count; one++)
        most = larger(numbers[one], most);
    return most;
}

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/asan_interface.h>
#define GAP 32
#else
#define GAP 0
#define ASAN_POISON_MEMORY_REGION(place, bytes) ((void)0)
#define ASAN_UNPOISON_MEMORY_REGION(place, bytes) ((void)(bytes))
#endif

/* Bump allocator; `used` counts the allocated bytes. With base == NULL, the allocator only counts. */
typedef struct {
    char *base;
    size_t used;
} Arena;

/* Return memory for `count` elements of `bytes` bytes, or NULL if base is NULL. The memory is 16-byte aligned
 * if base is. Under AddressSanitizer a poisoned gap follows the memory. */
INLINED void *arena_alloc(Arena *arena, size_t count, size_t bytes)
{
    const size_t size = (count * bytes + 15) / 16 * 16;
    char *here = arena->base ? arena->base + arena->used : NULL;
    if (here)
        ASAN_POISON_MEMORY_REGION(here + size, GAP);
    arena->used += size + GAP;
    return here;
}

/* Unpoison the next `bytes` bytes of the arena, and return their address. `used` does not change. */
INLINED void *arena_whole(Arena arena, size_t bytes)
{
    ASAN_UNPOISON_MEMORY_REGION(arena.base + arena.used, bytes);
    return arena.base + arena.used;
}

INLINED double *arena_doubles(Arena *arena, size_t count)
{
    return arena_alloc(arena, count, sizeof(double));
}

/* Expand to the arguments `arrays` and `count` of arena_arrays for a structure of pointers to double. */
#define ARRAYS(structure) ((double **)&(structure)), sizeof(structure) / sizeof(double *)

INLINED void arena_arrays(Arena *arena, double **arrays, size_t count, size_t length)
{
    for (size_t which = 0; which < count; which++)
        arrays[which] = arena_doubles(arena, length);
}
