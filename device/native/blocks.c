/* What is done to every block of frames, compiled: `_blocks`; blocks.py and interpolator.py say the
 * same in NumPy. */

#include "blocks.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

int opened(PyObject *array, const char *name, const char *types, int writable, Py_buffer *view)
{
    const int flags = PyBUF_FORMAT | PyBUF_ND | (writable ? PyBUF_WRITABLE : 0);
    if (PyObject_GetBuffer(array, view, flags) < 0)
        return 0;
    const char *format = view->format ? view->format : "B";
    if (*format && !format[1] && strchr(types, *format))
        return 1;
    PyErr_Format(PyExc_TypeError, "%s: of type %s, not %s", name, format, types);
    PyBuffer_Release(view);
    return 0;
}

/* Without their sign, numbers are in the order of their bits, and what is no number is above all. */
#define LARGEST(bits, sign, at, count, largest)                                                    \
    do {                                                                                           \
        for (size_t k = 0; k < (count); k++) {                                                     \
            bits now;                                                                              \
            memcpy(&now, (const char *)(at) + k * sizeof now, sizeof now);                         \
            now &= ~(bits)(sign);                                                                  \
            (largest) = now > (largest) ? now : (largest);                                         \
        }                                                                                          \
    } while (0)

PyDoc_STRVAR(peak_doc, "Return the magnitude of the largest sample; see _blocks.pyi.");

static PyObject *peak(PyObject *Py_UNUSED(module), PyObject *array)
{
    Py_buffer view;
    if (!opened(array, "frames", "fd", 0, &view))
        return NULL;
    const size_t count = (size_t)(view.len / view.itemsize);
    double magnitude;
    if (view.itemsize == sizeof(float)) {
        uint32_t largest = 0;
        LARGEST(uint32_t, 0x80000000u, view.buf, count, largest);
        float number;
        memcpy(&number, &largest, sizeof number);
        magnitude = (double)number;
    } else {
        uint64_t largest = 0;
        LARGEST(uint64_t, 0x8000000000000000u, view.buf, count, largest);
        memcpy(&magnitude, &largest, sizeof magnitude);
    }
    PyBuffer_Release(&view);
    return PyFloat_FromDouble(magnitude);
}

PyDoc_STRVAR(emptied_doc, "Return the bytes of a block, or None; see _blocks.pyi.");

static PyObject *emptied(PyObject *Py_UNUSED(module), PyObject *array)
{
    Py_buffer view;
    if (!opened(array, "frames", "f", 1, &view))
        return NULL;
    uint32_t largest = 0;
    LARGEST(uint32_t, 0x80000000u, view.buf, (size_t)view.len / sizeof(float), largest);
    PyObject *bytes;
    if (largest >= 0x7F800000u) { /* infinity, or no number */
        Py_INCREF(Py_None);
        bytes = Py_None;
    } else {
        bytes = PyBytes_FromStringAndSize(view.buf, view.len);
        if (bytes)
            memset(view.buf, 0, (size_t)view.len);
    }
    PyBuffer_Release(&view);
    return bytes;
}

/* Lagrange's weights of the frames at -1, 0, 1 and 2 for a place s from 0 to 1. */
static void weigh(double s, double weights[4])
{
    const double before = s + 1.0, after = s - 1.0, beyond = s - 2.0;
    const double outer = s * after, inner = before * beyond;
    weights[0] = outer * (beyond * (-1.0 / 6.0));
    weights[1] = inner * (after * 0.5);
    weights[2] = inner * (s * -0.5);
    weights[3] = outer * (before * (1.0 / 6.0));
}

static void interpolate(const float *ring, size_t capacity, size_t channels, float *out,
                        size_t frames, size_t row, double fraction, double step)
{
    for (size_t k = 0; k < frames; k++, out += channels) {
        const double at = fraction + (double)k * step, whole = floor(at);
        double weights[4];
        weigh(at - whole, weights);
        size_t place = row + (size_t)whole;
        const float *taps[4];
        for (int tap = 0; tap < 4; tap++, place++) {
            if (place >= capacity)
                place %= capacity;
            taps[tap] = ring + place * channels;
        }
        for (size_t channel = 0; channel < channels; channel++)
            out[channel] =
                (float)(weights[0] * taps[0][channel] + weights[1] * taps[1][channel] +
                        weights[2] * taps[2][channel] + weights[3] * taps[3][channel]);
    }
}

PyDoc_STRVAR(cubic_doc, "Fill a block with frames between those of a ring; see _blocks.pyi.");

static PyObject *cubic(PyObject *Py_UNUSED(module), PyObject *const *arguments, Py_ssize_t count)
{
    if (count != 5) {
        PyErr_SetString(PyExc_TypeError, "cubic: takes ring, out, row, fraction and step");
        return NULL;
    }
    const size_t row = PyLong_AsSize_t(arguments[2]);
    const double fraction = PyFloat_AsDouble(arguments[3]), step = PyFloat_AsDouble(arguments[4]);
    if (PyErr_Occurred())
        return NULL;
    Py_buffer ring, out;
    if (!opened(arguments[0], "ring", "f", 0, &ring))
        return NULL;
    if (!opened(arguments[1], "out", "f", 1, &out)) {
        PyBuffer_Release(&ring);
        return NULL;
    }
    const char *misfit = NULL;
    if (ring.ndim != 2 || out.ndim != 2 || ring.shape[1] != out.shape[1])
        misfit = "ring, out: not both (frames, channels) of as many channels";
    else if (ring.shape[0] < 1 || row >= (size_t)ring.shape[0])
        misfit = "row: not in the ring";
    else if (!(fraction >= 0.0 && fraction < 1.0))
        misfit = "fraction: not in 0 to 1";
    else if (!(step > 0.0 && step * (double)out.shape[0] < 1e15))
        misfit = "step: not above 0, or beyond all counting";
    if (misfit)
        PyErr_SetString(PyExc_ValueError, misfit);
    else
        interpolate(ring.buf, (size_t)ring.shape[0], (size_t)ring.shape[1], out.buf,
                    (size_t)out.shape[0], row, fraction, step);
    PyBuffer_Release(&ring);
    PyBuffer_Release(&out);
    if (misfit)
        return NULL;
    Py_RETURN_NONE;
}

static PyMethodDef METHODS[] = {
    {"peak", peak, METH_O, peak_doc},
    {"emptied", emptied, METH_O, emptied_doc},
    {"cubic", (PyCFunction)(void (*)(void))cubic, METH_FASTCALL, cubic_doc},
    {"linear_motion", (PyCFunction)(void (*)(void))linear_motion, METH_FASTCALL, linear_motion_doc},
    {"nonlinear_motion", (PyCFunction)(void (*)(void))nonlinear_motion, METH_FASTCALL,
     nonlinear_motion_doc},
    {"linear_suffices", (PyCFunction)(void (*)(void))linear_suffices, METH_FASTCALL,
     linear_suffices_doc},
    {NULL, NULL, 0, NULL},
};

static PyModuleDef_Slot SLOTS[] = {{0, NULL}};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "_blocks", .m_doc = "Blocks of frames, compiled.",
    .m_methods = METHODS,  .m_slots = SLOTS,
};

PyMODINIT_FUNC PyInit__blocks(void) { return PyModuleDef_Init(&MODULE); }
