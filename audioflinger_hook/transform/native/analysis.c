/* The live form's analysis of one window.
 *
 * Everything goes in one order and depends on the window alone. Any bytes are fit for a spectrum:
 * every loop is bounded by indices, and no number that came out of the arithmetic becomes an index
 * unchecked. What is not a number compares false and is lost.
 *
 * Noise has some hundreds of peaks, of which a few are kept. So what costs much, the half-power
 * bandwidth by logarithms, is measured only where a bound that costs little does not rule a peak
 * out. That changes no result.
 */

#include "analysis.h"

#include "common.h"
#include "functions.h"

/* 1/sqrt(2). */
#define HALF_POWER 0.70710678118654752440

/* Bins before and after the amplitudes that may be read: the first steps of a walk. */
#define EDGE 3

/* The bins beside a peak count as this share of it at least. Where the window's spectrum has a zero,
 * A^0.2 would make 1e-3 of a rounding of 1e-16, and ln A even more. */
#define FLOOR 1e-6

/* Two amplitudes are told apart from this ratio on, so that rounding decides nothing between equals:
 * the spectrum of a single sample is flat. */
#define APART_FROM (1.0 + 1e-9)

/* The same for a top: the three fifth roots around it are curved at least by this share of it. */
#define CURVED 1e-6

/* Of two peaks with the same r the lower one is the stronger: a bin up takes this share of r. */
#define LOWER_FIRST 1e-10

/* Bounds are raised by this, far more than the rounding in them. */
#define SLACK (1.0 + 1e-9)

/* Where the walk down one side of each peak falls under half power, parallel arrays. */
typedef struct {
    double *near, *far;    /* bins from the refined top to the bins before and after that step */
    double *above, *under; /* amplitudes there, no less and no more than half power */
    double *bound;         /* of the bins to half power, from above */
} Side;

/* Peaks, parallel arrays ascending in frequency; bins fit into 32 bits. */
typedef struct {
    int32_t count;
    int32_t *left, *bin, *right; /* the peak's bin and those of the valleys beside it */
    double *before, *top, *after; /* amplitudes around it */
    double *offset, *height;     /* of its refined top: bins from its own, and amplitude */
    double *level;               /* of half power */
    Side down, up;
    double *bandwidth_hz, *r;    /* r under 0 where it is not known yet */
    double *rank;                /* by which the strongest are chosen: r, a little less higher up */
    double *bound;               /* of both, from above */
} Peaks;

#define PEAK_NUMBERS 20

/* Some of the peaks, by their place among them, ascending. */
typedef struct {
    int32_t *place, count;
} Chosen;

typedef struct {
    double *amplitude; /* of bin 0; EDGE zeros to either side */
    int32_t *turns;    /* bins on which a rise begins or ends */
    uint8_t *rising;   /* for each bin, whether the next is higher */
    double *sorted, *sorting;
    Peaks peaks;
    Chosen chosen;
} Work;

static size_t most_peaks(size_t bins) { return bins / 2 + 1; }

size_t analysis_work(size_t bins)
{
    const size_t peaks = most_peaks(bins);
    return sizeof(double) * (bins + 2 * EDGE + (PEAK_NUMBERS + 2) * peaks) +
           sizeof(int32_t) * (bins + 2 + 4 * peaks) + bins;
}

static Work work_in(void *memory, size_t bins)
{
    const size_t count = most_peaks(bins);
    Work work = {0};
    Peaks *peaks = &work.peaks;
    double **numbers[PEAK_NUMBERS + 2] = {
        &peaks->before,     &peaks->top,        &peaks->after,    &peaks->offset,
        &peaks->height,     &peaks->level,      &peaks->down.near, &peaks->down.far,
        &peaks->down.above, &peaks->down.under, &peaks->down.bound, &peaks->up.near,
        &peaks->up.far,     &peaks->up.above,   &peaks->up.under, &peaks->up.bound,
        &peaks->bandwidth_hz, &peaks->r, &peaks->rank, &peaks->bound, &work.sorted, &work.sorting,
    };
    double *next = memory;
    for (size_t edge = 0; edge < EDGE; edge++)
        next[edge] = next[EDGE + bins + edge] = 0.0;
    work.amplitude = next + EDGE;
    next += bins + 2 * EDGE;
    for (size_t which = 0; which < PEAK_NUMBERS + 2; which++, next += count)
        *numbers[which] = next;
    int32_t **places[] = {&peaks->left, &peaks->bin, &peaks->right, &work.chosen.place};
    int32_t *place = (int32_t *)next;
    for (size_t which = 0; which < sizeof places / sizeof *places; which++, place += count)
        *places[which] = place;
    work.turns = place;
    work.rising = (uint8_t *)(place + bins + 2);
    return work;
}

/* ------------------------------------------------------------------------------------ amplitudes */

/* |X|, without the overflow guard of hypot: no sound comes near. */
WIDE static void magnitudes(Spectrum spectrum, double *restrict amplitude, int32_t bins)
{
    const double *restrict real = spectrum.real, *restrict imaginary = spectrum.imaginary;
    if (spectrum.step == 1)
        for (int32_t bin = 0; bin < bins; bin++)
            amplitude[bin] = sqrt(real[bin] * real[bin] + imaginary[bin] * imaginary[bin]);
    else
        for (int32_t bin = 0; bin < bins; bin++) {
            const double re = real[bin * spectrum.step], im = imaginary[bin * spectrum.step];
            amplitude[bin] = sqrt(re * re + im * im);
        }
}

/* Refine the tops of all peaks: the parabola in A^0.2, in which a Hamming main lobe is nearest to
 * one, through each peak and the bins beside it. */
WIDE static void refine(const double *amplitude, Peaks *peaks)
{
    const int32_t count = peaks->count;
    double *restrict before = peaks->before, *restrict top = peaks->top;
    double *restrict after = peaks->after;
    double *restrict offsets = peaks->offset, *restrict heights = peaks->height;
    double *restrict levels = peaks->level;
    for (int32_t one = 0; one < count; one++) {
        const double *here = amplitude + peaks->bin[one];
        before[one] = larger(here[-1], FLOOR * here[0]);
        top[one] = here[0];
        after[one] = larger(here[1], FLOOR * here[0]);
    }
    APART
    for (int32_t one = 0; one < count; one++) {
        const double l = fifth_root(before[one]), m = fifth_root(top[one]);
        const double r = fifth_root(after[one]);
        const double curvature = smaller(l - 2.0 * m + r, -CURVED * m);
        const double ratio = (l - r) / (2.0 * curvature);
        /* True half a bin at most; infinite amplitudes give no number. */
        const double offset = fabs(ratio) <= 1.0 ? ratio : 0.0;
        const double root = m - (l - r) * offset / 4.0;
        const double square = root * root, height = square * square * root;
        offsets[one] = offset;
        heights[one] = height;
        levels[one] = HALF_POWER * height;
    }
}

/* ---------------------------------------------------------------------------------------- images */

/* The window's spectrum this many bins from its middle, on a line between the table's entries. */
INLINED double window_at(const Window *window, double distance_bins)
{
    const double position = distance_bins * TABLE_BINS_A_BIN;
    if (!(position < (double)(window->entries - 1)))
        return window->table[window->entries - 1];
    const int32_t below = (int32_t)position;
    const double here = window->table[below];
    return here + (position - (double)below) * (window->table[below + 1] - here);
}

/* List the peaks whose images are worth clearing. */
static void strong_low_peaks(const Window *window, const double *amplitude, Peaks *peaks)
{
    int32_t count = 0;
    for (int32_t bin = 1; bin < window->low_bins; bin++) {
        const double here = amplitude[bin];
        peaks->bin[count] = bin;
        count += (here > window->weakest) & (here > APART_FROM * amplitude[bin - 1]) &
                 !(amplitude[bin + 1] > APART_FROM * here);
    }
    peaks->count = count;
}

/* Rewrite amplitudes of bins from `first` up to `end` without the image of the tone whose peak this
 * is.
 *
 * With phases counted from the window's centre its spectrum is real. There the image is the
 * tone's conjugate, on the window's spectrum around minus the tone's frequency.
 */
static void without_image(const Window *window, Spectrum spectrum, double *amplitude, int32_t peak,
                          double offset, int32_t first, int32_t end)
{
    const double height = window_at(window, fabs(offset));
    const double re = spectrum.real[peak * spectrum.step];
    const double im = spectrum.imaginary[peak * spectrum.step];
    const double cosine = window->cosine[peak], sine = window->sine[peak];
    const double tone_real = (re * cosine - im * sine) / height;
    const double tone_imaginary = (re * sine + im * cosine) / height;
    for (int32_t bin = first; bin < end; bin++) {
        const double image = window_at(window, (double)(bin + peak) + offset);
        const double x = spectrum.real[bin * spectrum.step];
        const double y = spectrum.imaginary[bin * spectrum.step];
        const double c = window->cosine[bin], s = window->sine[bin];
        const double real = x * c - y * s - tone_real * image;
        const double imaginary = x * s + y * c + tone_imaginary * image;
        amplitude[bin] = sqrt(real * real + imaginary * imaginary);
    }
}

/* Clear the low amplitudes of what the images of strong peaks add.
 *
 * Where the neighbourhoods of two peaks overlap, in the valley between, the upper one's stands. All
 * peaks are those of the amplitudes as they were.
 */
static void clear_images(const Window *window, Spectrum spectrum, double *amplitude, Peaks *peaks)
{
    strong_low_peaks(window, amplitude, peaks);
    refine(amplitude, peaks);
    for (int32_t one = 0; one < peaks->count; one++) {
        const int32_t peak = peaks->bin[one];
        const int32_t first = peak > NEIGHBOURS ? peak - NEIGHBOURS : 0;
        int32_t end = peak + NEIGHBOURS + 1;
        if (one + 1 < peaks->count && end > peaks->bin[one + 1] - NEIGHBOURS)
            end = peaks->bin[one + 1] - NEIGHBOURS;
        without_image(window, spectrum, amplitude, peak, peaks->offset[one], first, end);
    }
}

/* ----------------------------------------------------------------------------------------- peaks */

/* Note for each bin but the last whether the amplitude rises from it to the next. */
WIDE static void rises(const double *restrict amplitude, uint8_t *restrict rising, int32_t bins)
{
    for (int32_t bin = 0; bin < bins; bin++)
        rising[bin] = amplitude[bin + 1] > APART_FROM * amplitude[bin];
}

/* List the peaks of the band that can be principal.
 *
 * A peak is higher than the bin to its left and not lower than that to its right; the walk down
 * from it goes on while the amplitude does not rise, clearly. A row that ends rising has no peak there.
 * No bandwidth exceeds the span between the valleys, and refinement raises a peak by a bounded
 * factor: what stays under the threshold at that bound is left out before anything costly.
 */
static void able_peaks(const Rule *rule, const double *amplitude, Work *work)
{
    const int32_t top_bin = rule->bins - 1;
    int32_t count = 0;
    int32_t *turns = work->turns;
    uint8_t *rising = work->rising, was = 0;
    Peaks *peaks = &work->peaks;
    rises(amplitude, rising, top_bin);
    for (int32_t bin = 0; bin < top_bin; bin++) {
        turns[count] = bin;
        count += rising[bin] ^ was;
        was = rising[bin];
    }
    /* A valley, a peak, a valley ... */
    turns[count] = top_bin;
    int32_t able = 0;
    for (int32_t turn = 0; turn + 1 < count; turn += 2) {
        const int32_t left = turns[turn], bin = turns[turn + 1], right = turns[turn + 2];
        peaks->left[able] = left;
        peaks->bin[able] = bin;
        peaks->right[able] = right;
        able += (bin >= rule->first) & (bin <= rule->last) &
                (amplitude[bin] * (double)(right - left) > rule->peak_span_min);
    }
    peaks->count = able;
}

/* --------------------------------------------------------------------------- half-power bandwidth */

/* Find the step at which the walk from a peak to a valley falls under half power; where there is
 * none, as the valley itself stands higher, it is the valley's. Between the two no amplitude is above
 * the one before. */
INLINED void step_under(const double *amplitude, const Peaks *peaks, int32_t one, int32_t valley,
                        int32_t direction, Side side)
{
    const double *peak = amplitude + peaks->bin[one];
    const double level = peaks->level[one];
    const int32_t length = direction * (valley - peaks->bin[one]);
    int32_t inside = 0;
    for (int32_t ahead = 1; ahead <= EDGE; ahead++)
        inside += (ahead <= length) & !(peak[direction * ahead] < level);
    if (inside == EDGE)
        while (inside < length && !(peak[direction * (inside + 1)] < level))
            inside++;
    const int32_t outside = inside + (inside < length);
    side.near[one] = (double)(direction * inside) - peaks->offset[one];
    side.far[one] = (double)(direction * outside) - peaks->offset[one];
    side.above[one] = larger(peak[direction * inside], level);
    side.under[one] = larger(smaller(peak[direction * outside], level), FLOOR * level);
}

static void find_steps(const double *amplitude, Peaks *peaks)
{
    for (int32_t one = 0; one < peaks->count; one++) {
        step_under(amplitude, peaks, one, peaks->left[one], -1, peaks->down);
        step_under(amplitude, peaks, one, peaks->right[one], 1, peaks->up);
        peaks->r[one] = -1.0;
    }
}

/* Bins from a peak's top to half power.
 *
 * A window's main lobe is nearly a Gaussian, ln A linear in the squared distance from its top: the
 * edge between two bins is placed on that bell, so that a tone's bandwidth does not depend on
 * where between two bins it stands.
 */
static double side_on_bell(Side side, int32_t one, double level)
{
    const double near = side.near[one] * side.near[one], far = side.far[one] * side.far[one];
    const double above = log(side.above[one] / level), under = log(side.under[one] / level);
    return sqrt(near + above / larger(above - under, TINY) * (far - near));
}

/* The same on a straight line, which gives no less. */
INLINED void bound_side(Side side, const double *restrict level, int32_t count)
{
    const double *restrict near = side.near, *restrict far = side.far;
    const double *restrict above = side.above, *restrict under = side.under;
    double *restrict bound = side.bound;
    for (int32_t one = 0; one < count; one++) {
        const double part = (above[one] - level[one]) / larger(above[one] - under[one], TINY);
        const double inner = near[one] * near[one], outer = far[one] * far[one];
        bound[one] = sqrt(inner + part * (outer - inner));
    }
}

/* Bound the r of all peaks from above; the bound is a number even where the amplitudes are none. */
WIDE static void bound(const Rule *rule, Peaks *peaks)
{
    bound_side(peaks->down, peaks->level, peaks->count);
    bound_side(peaks->up, peaks->level, peaks->count);
    const double *restrict height = peaks->height;
    const double *restrict down = peaks->down.bound, *restrict up = peaks->up.bound;
    double *restrict bounds = peaks->bound;
    for (int32_t one = 0; one < peaks->count; one++) {
        const double r = height[one] * ((down[one] + up[one]) * rule->bin_hz) * SLACK;
        bounds[one] = r > 0.0 ? r : 0.0;
    }
}

/* Measure a peak's r, unless that is done; return whether it is principal. */
static int measured(const Rule *rule, Peaks *peaks, int32_t one)
{
    if (peaks->r[one] < 0.0) {
        const double level = peaks->level[one];
        const double bins =
            side_on_bell(peaks->down, one, level) + side_on_bell(peaks->up, one, level);
        peaks->bandwidth_hz[one] = bins * rule->bin_hz;
        const double r = peaks->height[one] * peaks->bandwidth_hz[one];
        peaks->r[one] = r;
        peaks->rank[one] = r - r * (LOWER_FIRST * (double)peaks->bin[one]);
    }
    return peaks->r[one] > rule->threshold_hz;
}

/* ------------------------------------------------------------------------------------- selection */

/* Choose those above a share of the highest principal one: the others may be its side lobes. */
static void choose_no_side_lobes(const Rule *rule, Peaks *peaks, Chosen *chosen)
{
    double highest = 0.0;
    while (highest == 0.0) {
        int32_t which = -1;
        double height = 0.0;
        for (int32_t one = 0; one < peaks->count; one++)
            if (peaks->height[one] > height && peaks->r[one] < 0.0) {
                which = one;
                height = peaks->height[one];
            }
        if (which < 0)
            break;
        if (measured(rule, peaks, which))
            highest = height;
        else
            peaks->r[which] = 0.0;
    }
    const double under = highest > 0.0 ? rule->side_lobe * highest : INFINITY;
    int32_t count = 0;
    for (int32_t one = 0; one < peaks->count; one++) {
        chosen->place[count] = one;
        count += peaks->height[one] > under;
    }
    chosen->count = count;
}

/* The n-th largest of the numbers; n at most as many as they are. sorted: the n largest. */
static double nth_largest(const double *numbers, int32_t count, int32_t n, double *sorted)
{
    int32_t filled = 0;
    for (int32_t one = 0; one < count; one++) {
        const double number = numbers[one];
        if (filled == n && !(number > sorted[n - 1]))
            continue;
        int32_t place = filled < n ? filled++ : n - 1;
        for (; place > 0 && number > sorted[place - 1]; place--)
            sorted[place] = sorted[place - 1];
        sorted[place] = number;
    }
    return sorted[n - 1];
}

/* Leave out, of more than n numbers, most of those under the n-th largest; return how many are left.
 * The least of the maxima of n groups is no larger than that. maxima: room for n. */
WIDE static int32_t few_largest(double *restrict numbers, int32_t count, int32_t n,
                                double *restrict maxima)
{
    memcpy(maxima, numbers, (size_t)n * sizeof(double));
    for (int32_t first = n; first + n <= count; first += n)
        for (int32_t one = 0; one < n; one++)
            maxima[one] = larger(numbers[first + one], maxima[one]);
    double least = maxima[0];
    for (int32_t one = 1; one < n; one++)
        least = smaller(maxima[one], least);
    int32_t left = 0;
    for (int32_t one = 0; one < count; one++) {
        const double number = numbers[one];
        numbers[left] = number;
        left += number >= least;
    }
    return left;
}

/* Of more than `most` rule out what cannot be among those with the largest r: first those that have
 * the largest bounds are measured, then it is known what the others must exceed. */
static void rule_out(const Rule *rule, Work *work)
{
    Peaks *peaks = &work->peaks;
    Chosen *chosen = &work->chosen;
    bound(rule, peaks);
    for (int32_t one = 0; one < chosen->count; one++)
        work->sorting[one] = peaks->bound[chosen->place[one]];
    const int32_t few = few_largest(work->sorting, chosen->count, rule->most, work->sorted);
    const double likely = nth_largest(work->sorting, few, rule->most, work->sorted);
    int32_t known = 0;
    for (int32_t one = 0; one < chosen->count; one++) {
        const int32_t place = chosen->place[one];
        if (peaks->bound[place] >= likely && measured(rule, peaks, place))
            work->sorting[known++] = peaks->rank[place];
    }
    /* What is not principal may stay for now. */
    const double least = known < rule->most
                             ? 0.0
                             : nth_largest(work->sorting, known, rule->most, work->sorted);
    int32_t count = 0;
    for (int32_t one = 0; one < chosen->count; one++) {
        const int32_t place = chosen->place[one];
        chosen->place[count] = place;
        count += peaks->bound[place] >= least;
    }
    chosen->count = count;
}

/* Choose what is principal of the chosen, the `most` with the largest r. */
static void choose_strongest(const Rule *rule, Work *work)
{
    Peaks *peaks = &work->peaks;
    Chosen *chosen = &work->chosen;
    if (chosen->count > rule->most)
        rule_out(rule, work);
    int32_t count = 0;
    for (int32_t one = 0; one < chosen->count; one++)
        if (measured(rule, peaks, chosen->place[one])) {
            work->sorting[count] = peaks->rank[chosen->place[one]];
            chosen->place[count++] = chosen->place[one];
        }
    chosen->count = count;
    if (count <= rule->most)
        return;
    const double least = nth_largest(work->sorting, count, rule->most, work->sorted);
    int32_t equals = 0;
    while (equals < rule->most && work->sorted[rule->most - 1 - equals] == least)
        equals++;
    int32_t kept = 0;
    for (int32_t one = 0; one < count; one++) {
        const double rank = work->sorting[one];
        if (rank > least || (rank == least && equals-- > 0))
            chosen->place[kept++] = chosen->place[one];
    }
    chosen->count = kept;
}

int32_t principal(const Rule *rule, const Window *window, Spectrum spectrum, Principals found,
                  void *memory)
{
    Work work = work_in(memory, (size_t)rule->bins);
    Peaks *peaks = &work.peaks;
    magnitudes(spectrum, work.amplitude, rule->bins);
    clear_images(window, spectrum, work.amplitude, peaks);
    able_peaks(rule, work.amplitude, &work);
    refine(work.amplitude, peaks);
    find_steps(work.amplitude, peaks);
    choose_no_side_lobes(rule, peaks, &work.chosen);
    choose_strongest(rule, &work);
    for (int32_t one = 0; one < work.chosen.count; one++) {
        const int32_t place = work.chosen.place[one];
        found.audio_hz[one] = ((double)peaks->bin[place] + peaks->offset[place]) * rule->bin_hz;
        found.amplitude[one] = peaks->height[place];
        found.bandwidth_hz[one] = peaks->bandwidth_hz[place];
        found.r[one] = peaks->r[place];
    }
    return work.chosen.count;
}
