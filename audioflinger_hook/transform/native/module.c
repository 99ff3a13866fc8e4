/* The kernel for Python: `_kernel.LiveKernel`. */

#include "module.h"

#include <structmember.h>

#include "design_blob.h"
#include "live.h"

/* ------------------------------------------------------------------------------------- the type */

typedef struct {
    PyObject_HEAD Live live;
    void *design; /* the bytes in which the kernel's tables lie; NULL where it is not open */
} LiveKernel;

#define CHANNELS_MAX 1024

/* Copy a design, in memory of PyMem_RawMalloc; 0 and an exception where it cannot be used. */
static int copy_design(PyObject *given, Design *design)
{
    const size_t size = (size_t)PyBytes_GET_SIZE(given);
    void *bytes = PyMem_RawMalloc(size ? size : 1);
    if (!bytes) {
        PyErr_NoMemory();
        return 0;
    }
    memcpy(bytes, PyBytes_AS_STRING(given), size);
    const char *problem = design_open(design, bytes, size);
    if (!problem)
        return 1;
    PyErr_Format(PyExc_ValueError, "the design cannot be used: %s", problem);
    PyMem_RawFree(bytes);
    return 0;
}

static PyObject *kernel_new(PyTypeObject *type, PyObject *arguments, PyObject *keywords)
{
    static char *names[] = {"design", "channels", "each", NULL};
    PyObject *given;
    Py_ssize_t channels;
    int each;
    if (!PyArg_ParseTupleAndKeywords(arguments, keywords, "O!np:LiveKernel", names, &PyBytes_Type,
                                     &given, &channels, &each))
        return NULL;
    if (channels < 1 || channels > CHANNELS_MAX) {
        PyErr_SetString(PyExc_ValueError, "channels: not 1 to 1024");
        return NULL;
    }
    Design design;
    if (!copy_design(given, &design))
        return NULL;
    LiveKernel *self = (LiveKernel *)type->tp_alloc(type, 0);
    const int failed =
        self ? live_open(&self->live, &design.settings, (size_t)channels, each) : -1;
    if (failed) {
        PyMem_RawFree(design.bytes);
        Py_XDECREF(self);
        if (failed == -1)
            return PyErr_NoMemory();
        PyErr_SetString(PyExc_ValueError, "fft_length: has other factors than 2, 3 and 5");
        return NULL;
    }
    self->design = design.bytes;
    return (PyObject *)self;
}

static void kernel_dealloc(LiveKernel *self)
{
    PyTypeObject *type = Py_TYPE(self);
    if (self->design)
        live_close(&self->live);
    PyMem_RawFree(self->design);
    type->tp_free((PyObject *)self);
    Py_DECREF(type);
}

PyDoc_STRVAR(process_doc, "Take a block of sound and write as much vibration; see _kernel.pyi.");

static PyObject *kernel_process(LiveKernel *self, PyObject *const *arguments, Py_ssize_t count)
{
    if (count != 2) {
        PyErr_SetString(PyExc_TypeError, "process: takes frames and vibration");
        return NULL;
    }
    Live *live = &self->live;
    Py_buffer frames, vibration;
    if (!open_array(arguments[0], "frames", (Expected){"fd", 1, 2, 0, 1}, &frames))
        return NULL;
    if (!open_array(arguments[1], "vibration", (Expected){"d", 2, 2, 1, 0}, &vibration)) {
        PyBuffer_Release(&frames);
        return NULL;
    }
    const int flat = frames.ndim == 1;
    const size_t channels = flat ? 1 : (size_t)frames.shape[1];
    const char *misfit = NULL;
    if (channels != live->channels)
        misfit = "frames: not as many channels as the stream has";
    else if (vibration.shape[0] != frames.shape[0])
        misfit = "vibration: not as many frames as there are of sound";
    else if ((size_t)vibration.shape[1] != live->voices_count)
        misfit = "vibration: not as many channels as the stream has of vibration";
    if (misfit) {
        PyErr_SetString(PyExc_ValueError, misfit);
    } else {
        const Sound sound = {
            .at = frames.buf,
            .frame_bytes = frames.strides[0],
            .channel_bytes = flat ? 0 : frames.strides[1],
            .channels = channels,
            .is_float = frames.itemsize == sizeof(float),
        };
        live_process(live, sound, (size_t)frames.shape[0], vibration.buf);
    }
    PyBuffer_Release(&frames);
    PyBuffer_Release(&vibration);
    if (misfit)
        return NULL;
    Py_RETURN_NONE;
}

PyDoc_STRVAR(reset_doc, "Begin a new stream; the counters go on.");

static PyObject *kernel_reset(LiveKernel *self, PyObject *Py_UNUSED(none))
{
    live_reset(&self->live);
    Py_RETURN_NONE;
}

/* What of a kernel changes as a stream goes on, beside the numbers of its voices. */
typedef struct {
    uint64_t filled, tick, oldest, silent, replaced, limited, delivered;
} Counters;

static PyObject *kernel_get_state(LiveKernel *self, void *Py_UNUSED(closure))
{
    const Live *live = &self->live;
    const Counters counters = {live->filled,   live->tick,    live->oldest,   live->silent,
                               live->replaced, live->limited, live->delivered};
    const size_t numbers = live->state_length * sizeof(double);
    PyObject *state = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)(sizeof counters + numbers));
    if (!state)
        return NULL;
    char *bytes = PyBytes_AS_STRING(state);
    memcpy(bytes, &counters, sizeof counters);
    memcpy(bytes + sizeof counters, live->state, numbers);
    return state;
}

static int kernel_set_state(LiveKernel *self, PyObject *state, void *Py_UNUSED(closure))
{
    Live *live = &self->live;
    Counters counters;
    const size_t numbers = live->state_length * sizeof(double);
    if (!state || !PyBytes_Check(state) ||
        (size_t)PyBytes_GET_SIZE(state) != sizeof counters + numbers) {
        PyErr_SetString(PyExc_ValueError, "state: not bytes of this kernel's size");
        return -1;
    }
    const char *bytes = PyBytes_AS_STRING(state);
    memcpy(&counters, bytes, sizeof counters);
    memcpy(live->state, bytes + sizeof counters, numbers);
    live->filled = (size_t)counters.filled;
    live->tick = (size_t)counters.tick;
    live->oldest = (size_t)counters.oldest;
    live->silent = (size_t)counters.silent;
    live->replaced = counters.replaced;
    live->limited = counters.limited;
    live->delivered = counters.delivered;
    if (live_is_possible(live))
        return 0;
    live_reset(live);
    PyErr_SetString(PyExc_ValueError, "state: no kernel stands like that");
    return -1;
}

static PyObject *partials_of(const Live *live, const Slots *slots)
{
    PyObject *partials = PyList_New(0);
    for (size_t slot = 0; partials && slot < tracking_slots(&live->settings); slot++) {
        if (slots->alive[slot] == 0.0)
            continue;
        PyObject *partial =
            Py_BuildValue("ddd", slots->hz[slot], slots->amplitude[slot], slots->phase[slot]);
        if (!partial || PyList_Append(partials, partial) < 0)
            Py_CLEAR(partials);
        Py_XDECREF(partial);
    }
    return partials;
}

static PyObject *kernel_get_partials(LiveKernel *self, void *Py_UNUSED(closure))
{
    const Live *live = &self->live;
    PyObject *voices = PyList_New((Py_ssize_t)live->voices_count);
    for (size_t voice = 0; voices && voice < live->voices_count; voice++) {
        PyObject *partials = partials_of(live, &live->voices[voice].slots);
        if (partials)
            PyList_SET_ITEM(voices, (Py_ssize_t)voice, partials);
        else
            Py_CLEAR(voices);
    }
    return voices;
}

static PyObject *kernel_get_told(LiveKernel *self, void *Py_UNUSED(closure))
{
    const Told *told = &self->live.told;
    PyObject *partials = PyTuple_New((Py_ssize_t)told->count);
    for (size_t one = 0; partials && one < told->count; one++) {
        PyObject *partial = Py_BuildValue("ddd", told->audio_hz[one], told->hz[one],
                                          told->amplitude[one]);
        if (partial)
            PyTuple_SET_ITEM(partials, (Py_ssize_t)one, partial);
        else
            Py_CLEAR(partials);
    }
    return partials;
}

PyDoc_STRVAR(take_glides_doc, "Return the glides played since the last call; see _kernel.pyi.");

static PyObject *kernel_take_glides(LiveKernel *self, PyObject *Py_UNUSED(none))
{
    GlideLog *log = &self->live.log;
    if (!log->on) {
        log->on = 1;
        log->frame = 0;
    }
    if (log->incomplete) {
        glide_log_clear(log);
        return PyErr_NoMemory();
    }
    const Py_ssize_t size = (Py_ssize_t)(log->count * sizeof *log->rows);
    PyObject *rows = PyBytes_FromStringAndSize((const char *)log->rows, size);
    if (rows)
        log->count = 0;
    return rows;
}

static PyMethodDef KERNEL_METHODS[] = {
    {"process", (PyCFunction)(void (*)(void))kernel_process, METH_FASTCALL, process_doc},
    {"reset", (PyCFunction)kernel_reset, METH_NOARGS, reset_doc},
    {"take_glides", (PyCFunction)kernel_take_glides, METH_NOARGS, take_glides_doc},
    {NULL, NULL, 0, NULL},
};

static PyGetSetDef KERNEL_PROPERTIES[] = {
    {"state", (getter)kernel_get_state, (setter)kernel_set_state,
     "All that changes as a stream goes on, as bytes.", NULL},
    {"partials", (getter)kernel_get_partials, NULL, "What sounds in each voice.", NULL},
    {"told", (getter)kernel_get_told, NULL, "What the latest hop vibrates.", NULL},
    {NULL, NULL, NULL, NULL, NULL},
};

#define COUNTER(name, doc)                                                                         \
    {#name, T_ULONGLONG, offsetof(LiveKernel, live) + offsetof(Live, name), READONLY, doc}

static PyMemberDef KERNEL_MEMBERS[] = {
    COUNTER(replaced, "Unusable samples so far."),
    COUNTER(limited, "Samples of vibration that the limiter has changed, of the hops computed."),
    COUNTER(delivered, "Frames so far."),
    {NULL, 0, 0, 0, NULL},
};

static PyType_Slot KERNEL_SLOTS[] = {
    {Py_tp_doc, "The live form of one stream, compiled; see _kernel.pyi."},
    {Py_tp_new, kernel_new},
    {Py_tp_dealloc, kernel_dealloc},
    {Py_tp_methods, KERNEL_METHODS},
    {Py_tp_getset, KERNEL_PROPERTIES},
    {Py_tp_members, KERNEL_MEMBERS},
    {0, NULL},
};

static PyType_Spec KERNEL_SPEC = {
    .name = "audioflinger_hook.transform._kernel.LiveKernel",
    .basicsize = sizeof(LiveKernel),
    .flags = Py_TPFLAGS_DEFAULT,
    .slots = KERNEL_SLOTS,
};

/* ----------------------------------------------------------------------------------- the module */

static int fill_module(PyObject *module)
{
    PyObject *type = PyType_FromModuleAndSpec(module, &KERNEL_SPEC, NULL);
    if (!type)
        return -1;
    const int added = PyModule_AddType(module, (PyTypeObject *)type);
    Py_DECREF(type);
    if (added < 0 || PyModule_AddIntMacro(module, NEIGHBOURS) < 0 ||
        PyModule_AddIntMacro(module, TABLE_BINS_A_BIN) < 0)
        return -1;
    return 0;
}

static PyModuleDef_Slot SLOTS[] = {
    {Py_mod_exec, fill_module},
    {0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "_kernel", .m_doc = "The live form, compiled.", .m_slots = SLOTS,
};

PyMODINIT_FUNC PyInit__kernel(void) { return PyModuleDef_Init(&MODULE); }
