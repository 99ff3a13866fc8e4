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

/* Open a contiguous array of one of the types; 0 and an exception where it is another. */
int opened(PyObject *array, const char *name, const char *types, int writable, Py_buffer *view);

extern const char linear_motion_doc[];
PyObject *linear_motion(PyObject *module, PyObject *const *arguments, Py_ssize_t count);

extern const char nonlinear_motion_doc[], linear_suffices_doc[];
PyObject *nonlinear_motion(PyObject *module, PyObject *const *arguments, Py_ssize_t count);
PyObject *linear_suffices(PyObject *module, PyObject *const *arguments, Py_ssize_t count);

#endif
