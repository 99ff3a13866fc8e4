/* Arrays from Python. */

#include "python_arrays.h"

/* Whether a format is one of the letters, or the one type of two letters. */
static int is_one_of(const char *types, const char *format)
{
    if (*types == 'Z')
        return strcmp(types, format) == 0;
    return *format && !format[1] && strchr(types, *format);
}

int open_array(PyObject *array, const char *name, Expected expected, Py_buffer *view)
{
    const int flags = PyBUF_FORMAT | (expected.strided ? PyBUF_STRIDES : PyBUF_ND) |
                      (expected.writable ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(array, view, flags) < 0)
        return 0;
    const char *format = view->format ? view->format : "B";
    if (expected.strided && *format == '=')
        format++; /* of the machine's byte order, but where its type would not stand */
    if (view->ndim < expected.dimensions || view->ndim > expected.dimensions_max)
        PyErr_Format(PyExc_ValueError, "%s: %d dimensions, not %d", name, view->ndim,
                     expected.dimensions);
    else if (!is_one_of(expected.types, format))
        PyErr_Format(PyExc_TypeError, "%s: of type %s, not %s", name, format, expected.types);
    else
        return 1;
    PyBuffer_Release(view);
    return 0;
}
