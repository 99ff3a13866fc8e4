/* The live form's analysis of a window, compiled: spectra in, principal frequencies out.
 *
 * What a hop asks of a spectrum are some dozens of peaks, each a few numbers: in NumPy that is 150
 * calls of a microsecond each and little arithmetic. Here it is one call.
 *
 * Every row is treated by itself and in one order, so no result depends on a row's company.
 * Nothing is allocated, and no state is kept: whoever calls brings scratch and room for results.
 * The interpreter lock is held throughout. A row takes some tens of microseconds; to give the lock
 * away and wait for it again can take milliseconds, which an audio thread does not have.
 *
 * Any bytes are fit for a spectrum: every loop is bounded by indices, and no number that came out
 * of the arithmetic becomes an index unchecked. What is not a number compares false and is lost.
 */

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <math.h>
#include <string.h>

/* The power of A in which a Hamming main lobe is nearest to a parabola; its inverse is 5. */
#define PEAK_EXPONENT 0.2

/* 1/sqrt(2). */
#define HALF_POWER 0.70710678118654752440

/* The smallest normal number: keeps a divisor and a logarithm's argument off 0. */
#define TINY 2.2250738585072014e-308

/* Bins to either side of a peak that are cleared of its image: its main lobe, and the half-power
 * walk on it. */
#define NEIGHBOURS 7

/* Entries of the window's table a bin: between them a straight line is within 0.2 % of a side
 * lobe. */
#define TABLE_BINS_A_BIN 32

/* Doubles of scratch a bin: amplitudes, and five lists of peaks, which stand on every other bin. */
#define SCRATCH_A_BIN 4

/* A peak's top, between bins: offset in bins from the peak's own, height as an amplitude. */
typedef struct {
    double offset, height;
} Top;

/* The window's own spectrum, by which images are known. */
typedef struct {
    const double *table; /* real, 1 at 0, TABLE_BINS_A_BIN entries a bin */
    Py_ssize_t entries;
    const double *cosine, *sine; /* of the turn of a bin's phase to the window's centre */
    Py_ssize_t low_bins;         /* peaks under this bin are cleared */
    double weakest;              /* peaks up to this amplitude are left alone */
} Window;

/* What makes a peak principal. */
typedef struct {
    Py_ssize_t bins, first, last; /* bins looked at; the first and last on which a peak counts */
    double bin_hz, threshold_hz;
    double peak_span_min; /* amplitude times bins between valleys from which r can pass */
} Rule;

/* Principal frequencies, parallel arrays ascending in frequency. */
typedef struct {
    double *audio_hz, *amplitude, *bandwidth_hz, *r;
} Principals;

static double larger(double one, double other) { return one > other ? one : other; }

static double smaller(double one, double other) { return one < other ? one : other; }

/* ------------------------------------------------------------------------------------ amplitudes */

/* |X|, without the overflow guard of hypot: no sound comes near. */
static void magnitudes(const double *spectrum, double *amplitude, Py_ssize_t bins)
{
    for (Py_ssize_t bin = 0; bin < bins; bin++) {
        const double real = spectrum[2 * bin], imaginary = spectrum[2 * bin + 1];
        amplitude[bin] = sqrt(real * real + imaginary * imaginary);
    }
}

/* The top of the parabola in A^0.2 through a peak and the bins beside it. */
static Top refined(const double *peak)
{
    const double left = pow(peak[-1], PEAK_EXPONENT);
    const double middle = pow(peak[0], PEAK_EXPONENT);
    const double right = pow(peak[1], PEAK_EXPONENT);
    const double curvature = left - 2.0 * middle + right;
    /* Rounding in the power can flatten the three into a line: its top is the middle bin. */
    double offset = curvature < 0.0 ? (left - right) / (2.0 * curvature) : 0.0;
    if (!(fabs(offset) <= 1.0)) /* true half a bin at most; infinite amplitudes give no number */
        offset = 0.0;
    const double root = middle - (left - right) * offset / 4.0;
    const double square = root * root;
    const Top top = {offset, square * square * root};
    return top;
}

/* ---------------------------------------------------------------------------------------- images */

/* The window's spectrum this many bins from its middle, on a line between the table's entries. */
static double window_at(const Window *window, double distance_bins)
{
    const double position = distance_bins * TABLE_BINS_A_BIN;
    if (!(position < (double)(window->entries - 1)))
        return window->table[window->entries - 1];
    const Py_ssize_t below = (Py_ssize_t)position;
    const double here = window->table[below];
    return here + (position - (double)below) * (window->table[below + 1] - here);
}

/* The first peak from a bin up whose image is worth clearing; low_bins where there is none. */
static Py_ssize_t next_strong_peak(const Window *window, const double *amplitude, Py_ssize_t bin)
{
    for (; bin < window->low_bins; bin++) {
        const double here = amplitude[bin];
        if (here > window->weakest && here > amplitude[bin - 1] && here >= amplitude[bin + 1])
            return bin;
    }
    return window->low_bins;
}

/* Amplitudes of the bins from `first` to `last` without the image of the tone whose peak this is.
 *
 * With phases counted from the window's centre its spectrum is real. There the image is the
 * tone's conjugate, on the window's spectrum around minus the tone's frequency.
 */
static void without_image(const Window *window, const double *spectrum, double *amplitude,
                          Py_ssize_t peak, double offset, Py_ssize_t first, Py_ssize_t last)
{
    const double height = window_at(window, fabs(offset));
    const double *at_peak = spectrum + 2 * peak;
    const double cosine = window->cosine[peak], sine = window->sine[peak];
    const double tone_real = (at_peak[0] * cosine - at_peak[1] * sine) / height;
    const double tone_imaginary = (at_peak[0] * sine + at_peak[1] * cosine) / height;
    for (Py_ssize_t bin = first; bin <= last; bin++) {
        const double image = window_at(window, (double)(bin + peak) + offset);
        const double *here = spectrum + 2 * bin;
        const double real =
            here[0] * window->cosine[bin] - here[1] * window->sine[bin] - tone_real * image;
        const double imaginary =
            here[0] * window->sine[bin] + here[1] * window->cosine[bin] + tone_imaginary * image;
        amplitude[bin] = sqrt(real * real + imaginary * imaginary);
    }
}

/* Rewrite the low amplitudes from the spectrum, without what the images of strong peaks add.
 *
 * Where the neighbourhoods of two peaks overlap, in the valley between, the upper one's stands. So
 * the lower one's ends there; and as the next peak is looked for before anything is written, and
 * nothing is written as high as it, peaks are those of the amplitudes as they were.
 */
static void clear_images(const Window *window, const double *spectrum, double *amplitude)
{
    Py_ssize_t next = next_strong_peak(window, amplitude, 1);
    while (next < window->low_bins) {
        const Py_ssize_t peak = next;
        const double offset = refined(amplitude + peak).offset;
        next = next_strong_peak(window, amplitude, peak + 1);
        Py_ssize_t first = peak - NEIGHBOURS, last = peak + NEIGHBOURS;
        if (first < 0)
            first = 0;
        if (next < window->low_bins && last > next - NEIGHBOURS - 1)
            last = next - NEIGHBOURS - 1;
        without_image(window, spectrum, amplitude, peak, offset, first, last);
    }
}

/* ------------------------------------------------------------------------- principal frequencies */

/* Bins from a peak's top to where the side that ends at `valley` falls to half power.
 *
 * A window's main lobe is nearly a Gaussian, ln A linear in the squared distance from its top: the
 * edge between two bins is placed on that bell, so that a tone's bandwidth does not depend on
 * where between two bins it stands. A side that stays above half power ends at its valley.
 */
static double side_on_bell(const double *amplitude, Py_ssize_t peak, Py_ssize_t valley, Top top)
{
    const double level = HALF_POWER * top.height;
    const Py_ssize_t step = valley < peak ? -1 : 1;
    Py_ssize_t inside = peak;
    while (inside != valley && !(amplitude[inside + step] < level))
        inside += step;
    const double near = (double)(inside - peak) - top.offset;
    if (inside == valley)
        return fabs(near);
    const double far = (double)(inside + step - peak) - top.offset;
    const double above = log(larger(amplitude[inside], level) / level);
    const double under = log(larger(smaller(amplitude[inside + step], level), TINY) / level);
    const double fraction = above / larger(above - under, TINY);
    return sqrt(near * near + fraction * (far * far - near * near));
}

/* Add a peak between two valleys to the found ones if it is principal; return how many they are.
 *
 * No bandwidth exceeds the span between the valleys, and refinement raises a peak by a bounded
 * factor: what stays under the threshold at that bound is left out before anything costly.
 */
static Py_ssize_t add_principal(const Rule *rule, const double *amplitude, Py_ssize_t valley_left,
                                Py_ssize_t peak, Py_ssize_t valley_right, Principals found,
                                Py_ssize_t count)
{
    if (!(amplitude[peak] * (double)(valley_right - valley_left) > rule->peak_span_min))
        return count;
    const Top top = refined(amplitude + peak);
    const double bandwidth_hz = (side_on_bell(amplitude, peak, valley_left, top) +
                                 side_on_bell(amplitude, peak, valley_right, top)) *
                                rule->bin_hz;
    const double r = top.height * bandwidth_hz;
    if (!(r > rule->threshold_hz))
        return count;
    found.audio_hz[count] = ((double)peak + top.offset) * rule->bin_hz;
    found.amplitude[count] = top.height;
    found.bandwidth_hz[count] = bandwidth_hz;
    found.r[count] = r;
    return count + 1;
}

/* Find what is principal in one row; return how many: under half as many as there are bins.
 *
 * A peak is higher than the bin to its left and not lower than that to its right; the walk down
 * from it goes on while the amplitude does not rise. A row that ends rising has no peak there.
 */
static Py_ssize_t all_principal(const Rule *rule, const double *amplitude, Principals found)
{
    const Py_ssize_t top_bin = rule->bins - 1;
    Py_ssize_t count = 0, bin = 0, peak = 0, valley_left = 0;
    while (bin < top_bin && !(amplitude[bin + 1] > amplitude[bin]))
        bin++;
    for (;;) {
        valley_left = bin;
        while (bin < top_bin && amplitude[bin + 1] > amplitude[bin])
            bin++;
        peak = bin;
        if (peak == top_bin || peak > rule->last)
            return count;
        while (bin < top_bin && !(amplitude[bin + 1] > amplitude[bin]))
            bin++;
        if (peak >= rule->first)
            count = add_principal(rule, amplitude, valley_left, peak, bin, found, count);
    }
}

/* ------------------------------------------------------------------------------------- selection */

static void move(Principals found, Py_ssize_t from, Py_ssize_t to)
{
    found.audio_hz[to] = found.audio_hz[from];
    found.amplitude[to] = found.amplitude[from];
    found.bandwidth_hz[to] = found.bandwidth_hz[from];
    found.r[to] = found.r[from];
}

/* Keep those above this share of the highest: the others may be its side lobes. */
static Py_ssize_t without_side_lobes(Principals found, Py_ssize_t count, double share)
{
    double highest = 0.0;
    for (Py_ssize_t one = 0; one < count; one++)
        highest = larger(found.amplitude[one], highest);
    Py_ssize_t kept = 0;
    for (Py_ssize_t one = 0; one < count; one++)
        if (found.amplitude[one] > share * highest)
            move(found, one, kept++);
    return kept;
}

/* Keep the `most` with the largest r, of equals those of lower frequency. largest: scratch. */
static Py_ssize_t strongest(Principals found, Py_ssize_t count, Py_ssize_t most, double *largest)
{
    if (count <= most)
        return count;
    /* Sorted downwards as they come; few of many have to be put in their place. */
    Py_ssize_t sorted = 0;
    for (Py_ssize_t one = 0; one < count; one++) {
        const double r = found.r[one];
        if (sorted == most && !(r > largest[most - 1]))
            continue;
        Py_ssize_t place = sorted < most ? sorted++ : most - 1;
        for (; place > 0 && r > largest[place - 1]; place--)
            largest[place] = largest[place - 1];
        largest[place] = r;
    }
    const double least = largest[most - 1];
    Py_ssize_t equals = 0;
    while (equals < most && largest[most - 1 - equals] == least)
        equals++;
    Py_ssize_t kept = 0;
    for (Py_ssize_t one = 0; one < count; one++)
        if (found.r[one] > least || (found.r[one] == least && equals-- > 0))
            move(found, one, kept++);
    return kept;
}

/* --------------------------------------------------------------------------------- seen by Python */

enum { SPECTRA, TABLE, TURN, SCRATCH, ROW, FOUND, ARRAYS };

static const struct {
    const char *name, *type; /* the type as the buffer protocol has it; "n" for any of that size */
    int dimensions, writable;
} EXPECTED[ARRAYS] = {
    [SPECTRA] = {"spectra", "Zd", 2, 0}, [TABLE] = {"table", "d", 1, 0},
    [TURN] = {"turn", "d", 2, 0},        [SCRATCH] = {"scratch", "d", 1, 1},
    [ROW] = {"row", "n", 1, 1},          [FOUND] = {"found", "d", 2, 1},
};

static int is_of_type(const Py_buffer *view, const char *type)
{
    const char *given = view->format ? view->format : "B";
    if (*type != 'n')
        return strcmp(given, type) == 0;
    return *given && !given[1] && strchr("ilqn", *given) &&
           view->itemsize == (Py_ssize_t)sizeof(Py_ssize_t);
}

/* Open one array for reading or writing; 0 and an exception where it is not what is expected. */
static int opened(PyObject *array, int which, Py_buffer *view)
{
    const int writable = EXPECTED[which].writable ? PyBUF_WRITABLE : 0;
    if (PyObject_GetBuffer(array, view, PyBUF_ND | PyBUF_FORMAT | writable) < 0)
        return 0;
    const int right_shape = view->ndim == EXPECTED[which].dimensions;
    if (right_shape && is_of_type(view, EXPECTED[which].type))
        return 1;
    if (right_shape)
        PyErr_Format(PyExc_TypeError, "%s: of type %s, not %s", EXPECTED[which].name,
                     view->format ? view->format : "B", EXPECTED[which].type);
    else
        PyErr_Format(PyExc_ValueError, "%s: %d dimensions, not %d", EXPECTED[which].name,
                     view->ndim, EXPECTED[which].dimensions);
    PyBuffer_Release(view);
    return 0;
}

/* What of the sizes does not fit the others; NULL where all do. */
static const char *misfit(const Py_buffer *views, Py_ssize_t bins, Py_ssize_t most)
{
    if (bins < 1 || bins > views[SPECTRA].shape[1])
        return "bins: not within the spectra";
    if (most < 1)
        return "most: under 1";
    if (views[TABLE].shape[0] < 1)
        return "table: empty";
    if (views[TURN].shape[0] != 2 || views[TURN].shape[1] > bins)
        return "turn: not two rows within the bins";
    if (views[SCRATCH].shape[0] / SCRATCH_A_BIN < bins)
        return "scratch: too short for the bins";
    const Py_ssize_t room = views[SPECTRA].shape[0] * (most < bins / 2 ? most : bins / 2);
    if (views[ROW].shape[0] < room)
        return "row: too short for what may be found";
    if (views[FOUND].shape[0] != 4 || views[FOUND].shape[1] < room)
        return "found: not four rows, or too short for what may be found";
    return NULL;
}

static Principals principals_at(double *numbers, Py_ssize_t pitch)
{
    const Principals parts = {numbers, numbers + pitch, numbers + 2 * pitch, numbers + 3 * pitch};
    return parts;
}

/* Find what is principal in every row; return how many. The arrays fit one another. */
static Py_ssize_t found_in_rows(const Py_buffer *views, const Rule *rule, double weakest,
                                double side_lobe, Py_ssize_t most)
{
    const double *turn = views[TURN].buf;
    const Window window = {
        .table = views[TABLE].buf,
        .entries = views[TABLE].shape[0],
        .cosine = turn,
        .sine = turn + views[TURN].shape[1],
        .low_bins = views[TURN].shape[1] - NEIGHBOURS,
        .weakest = weakest,
    };
    double *amplitude = views[SCRATCH].buf;
    const Py_ssize_t half = rule->bins / 2;
    const Principals of_row = principals_at(amplitude + rule->bins, half);
    double *largest = of_row.r + half;
    const Principals found = principals_at(views[FOUND].buf, views[FOUND].shape[1]);
    Py_ssize_t *row_of = views[ROW].buf;

    Py_ssize_t total = 0;
    for (Py_ssize_t row = 0; row < views[SPECTRA].shape[0]; row++) {
        const double *spectrum = (double *)views[SPECTRA].buf + 2 * views[SPECTRA].shape[1] * row;
        magnitudes(spectrum, amplitude, rule->bins);
        clear_images(&window, spectrum, amplitude);
        Py_ssize_t count = all_principal(rule, amplitude, of_row);
        count = without_side_lobes(of_row, count, side_lobe);
        count = strongest(of_row, count, most, largest);
        for (Py_ssize_t one = 0; one < count; one++, total++) {
            row_of[total] = row;
            found.audio_hz[total] = of_row.audio_hz[one];
            found.amplitude[total] = of_row.amplitude[one];
            found.bandwidth_hz[total] = of_row.bandwidth_hz[one];
            found.r[total] = of_row.r[one];
        }
    }
    return total;
}

PyDoc_STRVAR(find_doc, "Find the principal frequencies of each row; see _analysis.pyi.");

static PyObject *find(PyObject *Py_UNUSED(module), PyObject *arguments)
{
    PyObject *arrays[ARRAYS];
    Rule rule;
    double weakest, side_lobe;
    Py_ssize_t most;
    if (!PyArg_ParseTuple(arguments, "OOOnnndddddnOOO:find", &arrays[SPECTRA], &arrays[TABLE],
                          &arrays[TURN], &rule.bins, &rule.first, &rule.last, &rule.bin_hz,
                          &rule.threshold_hz, &rule.peak_span_min, &weakest, &side_lobe,
                          &most, &arrays[SCRATCH], &arrays[ROW], &arrays[FOUND]))
        return NULL;

    Py_buffer views[ARRAYS];
    int open = 0;
    while (open < ARRAYS && opened(arrays[open], open, &views[open]))
        open++;

    Py_ssize_t count = -1;
    if (open == ARRAYS) {
        const char *wrong = misfit(views, rule.bins, most);
        if (wrong)
            PyErr_SetString(PyExc_ValueError, wrong);
        else
            count = found_in_rows(views, &rule, weakest, side_lobe, most);
    }
    while (open-- > 0)
        PyBuffer_Release(&views[open]);
    return count < 0 ? NULL : PyLong_FromSsize_t(count);
}

static PyMethodDef METHODS[] = {
    {"find", find, METH_VARARGS, find_doc},
    {NULL, NULL, 0, NULL},
};

static int add_constants(PyObject *module)
{
    return PyModule_AddIntMacro(module, NEIGHBOURS) < 0 ||
                   PyModule_AddIntMacro(module, TABLE_BINS_A_BIN) < 0 ||
                   PyModule_AddIntMacro(module, SCRATCH_A_BIN) < 0
               ? -1
               : 0;
}

static PyModuleDef_Slot SLOTS[] = {
    {Py_mod_exec, add_constants},
    {0, NULL},
};

static struct PyModuleDef MODULE = {
    PyModuleDef_HEAD_INIT,
    .m_name = "_analysis",
    .m_doc = "The live form's analysis of spectra, compiled.",
    .m_methods = METHODS,
    .m_slots = SLOTS,
};

PyMODINIT_FUNC PyInit__analysis(void) { return PyModuleDef_Init(&MODULE); }
