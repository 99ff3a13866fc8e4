/* Parts of `_blocks`, by the file that each is in. */

#ifndef DEVICE_BLOCKS_H
#define DEVICE_BLOCKS_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

/* Compiled for every processor and for those with wide registers, with the same operations on each
 * number, so all give the same bits. */
#if defined(__x86_64__) && defined(__GLIBC__) && defined(__GNUC__) && !defined(ONE_MACHINE)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
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

static inline void usual_numbers(unsigned long long before)
{
    _mm_setcsr((unsigned int)before);
}
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
static inline unsigned long long flush_tiny_numbers(void)
{
    return 0;
}

static inline void usual_numbers(unsigned long long Py_UNUSED(before))
{
}
#endif

/* Open a contiguous array of one of the types; 0 and an exception where it is another. */
int opened(PyObject *array, const char *name, const char *types, int writable, Py_buffer *view);

extern const char linear_motion_doc[];
PyObject *linear_motion(PyObject *module, PyObject *const *arguments, Py_ssize_t count);

extern const char nonlinear_motion_doc[], linear_suffices_doc[];
PyObject *nonlinear_motion(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
PyObject *linear_suffices(PyObject *module, PyObject *const *arguments, Py_ssize_t count);

#endif
