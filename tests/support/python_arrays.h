/* What the parts of the Python module share. */

#ifndef CUSHION_MODULE_H
#define CUSHION_MODULE_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "common.h"

/* What is asked of an array that comes from Python. */
typedef struct {
    const char *types; /* the buffer protocol's letters of those that will do, or "Zd" */
    int dimensions, dimensions_max;
    int writable;
    int strided; /* in any layout, and not where its type should stand; else contiguous */
} Expected;

/* Open an array; 0 and an exception where it is not what is expected. */
int open_array(PyObject *array, const char *name, Expected expected, Py_buffer *view);

#endif
