/* What all parts of the live form's kernel share. */

#ifndef CUSHION_COMMON_H
#define CUSHION_COMMON_H

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

#endif
