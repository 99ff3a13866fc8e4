/* Parts of the kernel, each by itself, so that tests can compare them with other results. Built by
 * kernel_probes.py; not part of the shipped kernel. */

#include "python_arrays.h"

#include "analysis.h"
#include "exact.h"
#include "fft.h"

enum { SPECTRA, TABLE, TURN, ROW, FOUND, ARRAYS };

static const struct {
    const char *name;
    Expected expected;
} ARRAY[ARRAYS] = {
    [SPECTRA] = {"spectra", {"Zd", 2, 2, 0, 0}}, [TABLE] = {"table", {"d", 1, 1, 0, 0}},
    [TURN] = {"turn", {"d", 2, 2, 0, 0}},        [ROW] = {"row", {"lq", 1, 1, 1, 0}},
    [FOUND] = {"found", {"d", 2, 2, 1, 0}},
};

#define BINS_MAX (1 << 24)
#define TABLE_MAX (1 << 28)

/* What of the sizes does not fit the others; NULL where all do. */
static const char *misfit(const Py_buffer *views, Py_ssize_t bins, Py_ssize_t first,
                          Py_ssize_t last, Py_ssize_t most)
{
    if (bins < 2 || bins > views[SPECTRA].shape[1] || bins > BINS_MAX)
        return "bins: not within the spectra";
    if (first < 1 || (last >= first && last > bins - 2))
        return "first, last: without a bin to either side";
    if (most < 1)
        return "most: under 1";
    if (views[TABLE].shape[0] < 1 || views[TABLE].shape[0] > TABLE_MAX)
        return "table: empty, or too long";
    if (views[TURN].shape[0] != 2 || views[TURN].shape[1] > bins)
        return "turn: not two rows within the bins";
    const Py_ssize_t room = views[SPECTRA].shape[0] * (most < bins / 2 ? most : bins / 2);
    if (views[ROW].itemsize != (Py_ssize_t)sizeof(int64_t))
        return "row: not of 64 bits";
    if (views[ROW].shape[0] < room)
        return "row: too short for what may be found";
    if (views[FOUND].shape[0] != 4 || views[FOUND].shape[1] < room)
        return "found: not four rows, or too short for what may be found";
    return NULL;
}

static Py_ssize_t found_in_rows(const Py_buffer *views, const Settings *settings, void *work)
{
    const Py_ssize_t pitch = views[FOUND].shape[1];
    double *real = (double *)((char *)work + analysis_work(settings->bins));
    double *imaginary = real + settings->bins;
    int64_t *row_of = views[ROW].buf;
    Py_ssize_t total = 0;
    for (Py_ssize_t row = 0; row < views[SPECTRA].shape[0]; row++) {
        const double *bins = (double *)views[SPECTRA].buf + 2 * views[SPECTRA].shape[1] * row;
        for (size_t bin = 0; bin < settings->bins; bin++) {
            real[bin] = bins[2 * bin];
            imaginary[bin] = bins[2 * bin + 1];
        }
        double *numbers = (double *)views[FOUND].buf + total;
        const Principals found = {numbers, numbers + pitch, numbers + 2 * pitch,
                                  numbers + 3 * pitch};
        const int32_t count = find_principal(settings, (Spectrum){real, imaginary}, found, work);
        for (int32_t one = 0; one < count; one++)
            row_of[total++] = row;
    }
    return total;
}

PyDoc_STRVAR(find_doc, "Find the principal frequencies of each row; see kernel_probes.py.");

static PyObject *find(PyObject *Py_UNUSED(module), PyObject *arguments)
{
    PyObject *arrays[ARRAYS];
    Py_ssize_t bins, first, last, most;
    double first_sample, bin_hz, threshold_hz, peak_span_min, weakest, side_lobe;
    if (!PyArg_ParseTuple(arguments, "OOOdnnndddddnOO:find", &arrays[SPECTRA], &arrays[TABLE],
                          &arrays[TURN], &first_sample, &bins, &first, &last, &bin_hz, &threshold_hz,
                          &peak_span_min, &weakest, &side_lobe, &most, &arrays[ROW],
                          &arrays[FOUND]))
        return NULL;
    Py_buffer views[ARRAYS];
    int open = 0;
    while (open < ARRAYS &&
           open_array(arrays[open], ARRAY[open].name, ARRAY[open].expected, &views[open]))
        open++;
    Py_ssize_t count = -1;
    if (open == ARRAYS) {
        const char *wrong = misfit(views, bins, first, last, most);
        const size_t pairs = 2 * (size_t)bins * sizeof(double);
        void *work = wrong ? NULL : PyMem_Malloc(analysis_work((size_t)bins) + pairs);
        const Settings settings = {
            .bins = (size_t)bins,
            .first_bin = (size_t)first,
            .last_bin = last < first ? 0 : (size_t)last,
            .bin_hz = bin_hz,
            .threshold_hz = threshold_hz,
            .peak_span_min = peak_span_min,
            .side_lobe = side_lobe,
            .partials_max = (size_t)(most < bins ? most : bins),
            .image_table = {views[TABLE].buf, (size_t)views[TABLE].shape[0]},
            .image_turn = {views[TURN].buf, 2 * (size_t)views[TURN].shape[1]},
            .image_first = first_sample,
            .weakest_image = weakest,
        };
        if (wrong)
            PyErr_SetString(PyExc_ValueError, wrong);
        else if (!work)
            PyErr_NoMemory();
        else
            count = found_in_rows(views, &settings, work);
        PyMem_Free(work);
    }
    while (open-- > 0)
        PyBuffer_Release(&views[open]);
    return count < 0 ? NULL : PyLong_FromSsize_t(count);
}

/* ---------------------------------------------------------------------------------- other parts */

PyDoc_STRVAR(spectrum_doc, "Write the spectrum of samples, as scipy.fft.rfft; see kernel_probes.py.");

static PyObject *spectrum(PyObject *Py_UNUSED(module), PyObject *arguments)
{
    PyObject *given[2];
    Py_ssize_t length;
    if (!PyArg_ParseTuple(arguments, "OnO:spectrum", &given[0], &length, &given[1]))
        return NULL;
    Py_buffer samples, bins;
    if (!open_array(given[0], "samples", (Expected){"d", 1, 1, 0, 0}, &samples))
        return NULL;
    if (!open_array(given[1], "bins", (Expected){"d", 2, 2, 1, 0}, &bins)) {
        PyBuffer_Release(&samples);
        return NULL;
    }
    Fft fft = {0};
    Arena arena = {NULL, 0};
    double *work = NULL;
    const char *wrong = NULL;
    if (length < 2 || length > 1 << 24 || samples.shape[0] > length)
        wrong = "length: not that of the samples or more";
    else if (bins.shape[0] != 2 || bins.shape[1] < 1 || bins.shape[1] > length / 2 + 1)
        wrong = "bins: not two rows of as many as there are at most";
    else if (!fft_open(&fft, (size_t)length, samples.shape[0] <= length / 2, &arena))
        wrong = "length: has other factors than 2, 3 and 5";
    else if (!(arena.base = PyMem_RawMalloc(arena.used))) /* a sanitizer knows when its gaps end */
        wrong = "no memory";
    else if (!(work = PyMem_Calloc(fft_work(&fft) + fft.frames, sizeof(double))))
        wrong = "no memory";
    if (wrong) {
        PyErr_SetString(PyExc_ValueError, wrong);
    } else {
        arena.used = 0;
        fft_open(&fft, (size_t)length, samples.shape[0] <= length / 2, &arena);
        memcpy(work, samples.buf, (size_t)samples.len);
        double *real = bins.buf;
        fft_spectrum(&fft, work, (size_t)bins.shape[1], real, real + bins.shape[1],
                     work + fft.frames);
    }
    PyMem_Free(work);
    PyMem_RawFree(arena.base);
    PyBuffer_Release(&samples);
    PyBuffer_Release(&bins);
    if (wrong)
        return NULL;
    Py_RETURN_NONE;
}

SIMD_CLONES static void fifth_roots_of(double *numbers, Py_ssize_t count)
{
    for (Py_ssize_t one = 0; one < count; one++)
        numbers[one] = fifth_root(numbers[one]);
}

SIMD_CLONES static void cosines_of(double *numbers, Py_ssize_t count)
{
    for (Py_ssize_t one = 0; one < count; one++)
        numbers[one] = cosine_of_turns(numbers[one]);
}

static PyObject *in_place(PyObject *array, void (*function)(double *, Py_ssize_t))
{
    Py_buffer numbers;
    if (!open_array(array, "numbers", (Expected){"d", 1, 1, 1, 0}, &numbers))
        return NULL;
    function(numbers.buf, numbers.shape[0]);
    PyBuffer_Release(&numbers);
    Py_RETURN_NONE;
}

static PyObject *fifth_roots(PyObject *Py_UNUSED(module), PyObject *numbers)
{
    return in_place(numbers, fifth_roots_of);
}

static PyObject *cosines(PyObject *Py_UNUSED(module), PyObject *numbers)
{
    return in_place(numbers, cosines_of);
}

#define EXACT(name)                                                                                \
    static void name##_of(double *numbers, Py_ssize_t count)                                       \
    {                                                                                              \
        for (Py_ssize_t one = 0; one < count; one++)                                               \
            numbers[one] = name(numbers[one]);                                                     \
    }                                                                                              \
    static PyObject *name##s(PyObject *Py_UNUSED(module), PyObject *numbers)                       \
    {                                                                                              \
        return in_place(numbers, name##_of);                                                       \
    }

EXACT(exact_exp)
EXACT(exact_log)
EXACT(exact_log2)
EXACT(exact_log10)
EXACT(exact_amplitude)
EXACT(exact_tanh)
EXACT(exact_sin)
EXACT(exact_cos)

static double power_035(double x) { return exact_pow(x, 0.35); }

EXACT(power_035)

static PyMethodDef PROBES[] = {
    {"find", find, METH_VARARGS, find_doc},
    {"spectrum", spectrum, METH_VARARGS, spectrum_doc},
    {"fifth_roots", fifth_roots, METH_O, "Replace numbers by their fifth roots."},
    {"cosines", cosines, METH_O, "Replace numbers of turns by their cosines."},
    {"exact_exp", exact_exps, METH_O, "Replace numbers x by exp(x)."},
    {"exact_log", exact_logs, METH_O, "Replace numbers x by log(x)."},
    {"exact_log2", exact_log2s, METH_O, "Replace numbers x by log2(x)."},
    {"exact_log10", exact_log10s, METH_O, "Replace numbers x by log10(x)."},
    {"exact_amplitude", exact_amplitudes, METH_O, "Replace numbers x by 10^(x/20)."},
    {"exact_tanh", exact_tanhs, METH_O, "Replace numbers x by tanh(x)."},
    {"exact_sin", exact_sins, METH_O, "Replace numbers x by sin(x)."},
    {"exact_cos", exact_coss, METH_O, "Replace numbers x by cos(x)."},
    {"power_035", power_035s, METH_O, "Replace numbers x by x^0.35."},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT, .m_name = "kernel_probes", .m_size = 0, .m_methods = PROBES,
};

PyMODINIT_FUNC PyInit_kernel_probes(void) { return PyModule_Create(&MODULE); }
