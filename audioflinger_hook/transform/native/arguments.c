/* What comes from Python, taken in: arrays, and the settings of a kernel. */

#include "module.h"

/* --------------------------------------------------------------------------------------- arrays */

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

/* ------------------------------------------------------------------------------------- settings */

static int count_from(PyObject *settings, const char *name, size_t *count)
{
    PyObject *value = PyDict_GetItemString(settings, name);
    if (!value) {
        PyErr_Format(PyExc_ValueError, "%s: missing", name);
        return 0;
    }
    *count = PyLong_AsSize_t(value);
    return !(*count == (size_t)-1 && PyErr_Occurred());
}

static int number_from(PyObject *settings, const char *name, double *number)
{
    PyObject *value = PyDict_GetItemString(settings, name);
    if (!value) {
        PyErr_Format(PyExc_ValueError, "%s: missing", name);
        return 0;
    }
    *number = PyFloat_AsDouble(value);
    return !(*number == -1.0 && PyErr_Occurred());
}

static int table_from(PyObject *settings, const char *name, Table *table)
{
    PyObject *value = PyDict_GetItemString(settings, name);
    if (!value) {
        PyErr_Format(PyExc_ValueError, "%s: missing", name);
        return 0;
    }
    Py_buffer view;
    if (!open_array(value, name, (Expected){"d", 1, 2, 0, 0}, &view))
        return 0;
    table->at = PyMem_RawMalloc(view.len ? (size_t)view.len : 1);
    if (table->at) {
        memcpy(table->at, view.buf, (size_t)view.len);
        table->length = (size_t)view.len / sizeof(double);
    } else {
        PyErr_NoMemory();
    }
    PyBuffer_Release(&view);
    return table->at != NULL;
}

void settings_close(Settings *settings)
{
#define ENTRY(name)                                                                                \
    PyMem_RawFree(settings->name.at);                                                              \
    settings->name.at = NULL;
    TABLES(ENTRY)
#undef ENTRY
}

int open_settings(PyObject *given, Settings *settings)
{
    memset(settings, 0, sizeof *settings);
    int read = 1;
#define ENTRY(name) read = read && count_from(given, #name, &settings->name);
    COUNTS(ENTRY)
#undef ENTRY
#define ENTRY(name) read = read && number_from(given, #name, &settings->name);
    NUMBERS(ENTRY)
#undef ENTRY
#define ENTRY(name) read = read && table_from(given, #name, &settings->name);
    TABLES(ENTRY)
#undef ENTRY
    const char *misfit = read ? settings_misfit(settings) : NULL;
    if (misfit)
        PyErr_SetString(PyExc_ValueError, misfit);
    if (read && !misfit)
        return 1;
    settings_close(settings);
    return 0;
}
