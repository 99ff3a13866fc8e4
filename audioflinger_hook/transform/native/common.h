/* What all parts of the live form's kernel share. */

#pragma once

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#define PI 3.14159265358979323846

/* The smallest normal number: keeps a divisor and a logarithm's argument off 0. */
#define TINY 2.2250738585072014e-308

/* A function of plain loops over arrays, compiled once for every processor and once each for those
 * with registers of 32 and of 64 bytes; the right one is chosen when the module is loaded. All do the
 * same operations on each number, so all give the same bits. */
#if !defined(__x86_64__) || !defined(__GLIBC__) || !defined(__GNUC__) || defined(__clang__) || \
    defined(ONE_MACHINE) /* clang's versions of one function do not link */
#define SIMD_CLONES
#define SIMD_CLONES_NARROW
#elif defined(TWO_MACHINES)
#define SIMD_CLONES __attribute__((target_clones("avx2", "default")))
#define SIMD_CLONES_NARROW SIMD_CLONES
#else
#define SIMD_CLONES __attribute__((target_clones("avx512f", "avx2", "default")))
/* For loops over a dozen numbers, where half of a register of 64 bytes would stay empty. */
#define SIMD_CLONES_NARROW __attribute__((target_clones("avx2", "default")))
#endif

/* Before a loop: what it writes is not what it reads a step later. */
#if defined(__clang__)
#define NO_ALIAS _Pragma("clang loop vectorize(assume_safety)")
#elif defined(__GNUC__)
#define NO_ALIAS _Pragma("GCC ivdep")
#else
#define NO_ALIAS
#endif

/* Part of the function that calls it, and compiled for that function's processor. */
#define INLINED static inline __attribute__((always_inline))

INLINED double larger(double one, double other) { return one > other ? one : other; }

INLINED double smaller(double one, double other) { return one < other ? one : other; }

INLINED double clip(double number, double low, double high) { return larger(low, smaller(high, number)); }

/* Added one after the other: the same bits everywhere. */
INLINED double sum(const double *numbers, size_t count)
{
    double total = 0.0;
    for (size_t one = 0; one < count; one++)
        total += numbers[one];
    return total;
}

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/asan_interface.h>
#define GAP 32
#else
#define GAP 0
#define ASAN_POISON_MEMORY_REGION(place, bytes) ((void)0)
#endif

/* Without a base, the bytes are only counted. */
typedef struct {
    char *base;
    size_t used;
} Arena;

/* Return room for `count` elements of `bytes` bytes, at a multiple of 16; NULL without a base. Under a
 * sanitizer, a gap follows that nobody may touch. */
INLINED void *arena_alloc(Arena *arena, size_t count, size_t bytes)
{
    const size_t size = (count * bytes + 15) / 16 * 16;
    char *here = arena->base ? arena->base + arena->used : NULL;
    if (here)
        ASAN_POISON_MEMORY_REGION(here + size, GAP);
    arena->used += size + GAP;
    return here;
}

INLINED double *arena_doubles(Arena *arena, size_t count)
{
    return arena_alloc(arena, count, sizeof(double));
}

/* Where the arrays of a structure stand that consists of pointers to them, and how many they are. */
#define ARRAYS(structure) ((double **)&(structure)), sizeof(structure) / sizeof(double *)

/* Allocate arrays of `length` doubles each. */
INLINED void arena_arrays(Arena *arena, double **arrays, size_t count, size_t length)
{
    for (size_t which = 0; which < count; which++)
        arrays[which] = arena_doubles(arena, length);
}
