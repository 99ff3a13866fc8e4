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

#include "exact.h"

/* Bins before the first and after the last that may be read: the first steps of a walk. */
#define EDGE 3

/* Of two peaks with the same r the lower one is the stronger: a bin up takes this share of r. */
#define LOWER_FIRST 1e-10

/* Bounds are raised by this, far more than the rounding in them. */
#define SLACK (1.0 + 1e-9)

/* Some of the peaks, by their place among them, ascending. */
typedef struct {
    int32_t *place, count;
} Chosen;

typedef struct {
    double *edges; /* amplitudes, with EDGE zeros to either side */
    Turns turns;
    double *sorted, *sorting;
    Peaks peaks;
    Chosen chosen;
} Work;

/* Give every part its place in the memory, or count how much that is where there is none. */
static size_t layout_work(void *memory, size_t bins, Work *work)
{
    const size_t most = bins / 2 + 1;
    Peaks *peaks = &work->peaks;
    double **numbers[] = {&peaks->before,       &peaks->top,  &peaks->after, &peaks->offset, &peaks->height,
                          &peaks->level,        &peaks->r,    &peaks->rank,  &peaks->bound,
                          &peaks->bandwidth_hz, &work->sorted, &work->sorting};
    int32_t **places[] = {&peaks->left, &peaks->bin, &peaks->right, &work->chosen.place};
    Arena arena = {memory, 0};
    work->edges = arena_doubles(&arena, bins + 2 * EDGE);
    arena_arrays(&arena, ARRAYS(peaks->down), most);
    arena_arrays(&arena, ARRAYS(peaks->up), most);
    for (size_t which = 0; which < sizeof numbers / sizeof *numbers; which++)
        *numbers[which] = arena_doubles(&arena, most);
    for (size_t which = 0; which < sizeof places / sizeof *places; which++)
        *places[which] = arena_alloc(&arena, most, sizeof(int32_t));
    work->turns.bin = arena_alloc(&arena, bins + 1, sizeof(int32_t));
    work->turns.rising = arena_alloc(&arena, bins, sizeof(uint8_t));
    return arena.used;
}

size_t analysis_work(size_t bins)
{
    Work work;
    return layout_work(NULL, bins, &work);
}

/* ------------------------------------------------------------------------ half-power bandwidth */

/* Find the step at which the walk from a peak to a valley falls under half power. Where there is
 * none, as the valley itself stands higher, it is the valley's. Between the two no amplitude is
 * above the one before. */
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
    const double above = exact_log(side.above[one] / level);
    const double under = exact_log(side.under[one] / level);
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
SIMD_CLONES static void bound(const Settings *s, Peaks *peaks)
{
    bound_side(peaks->down, peaks->level, peaks->count);
    bound_side(peaks->up, peaks->level, peaks->count);
    const double *restrict height = peaks->height;
    const double *restrict down = peaks->down.bound, *restrict up = peaks->up.bound;
    double *restrict bounds = peaks->bound;
    for (int32_t one = 0; one < peaks->count; one++) {
        const double r = height[one] * ((down[one] + up[one]) * s->bin_hz) * SLACK;
        bounds[one] = r > 0.0 ? r : 0.0;
    }
}

/* Measure a peak's r, unless that is done; return whether it is principal. */
static int measure_peak(const Settings *s, Peaks *peaks, int32_t one)
{
    if (peaks->r[one] < 0.0) {
        const double level = peaks->level[one];
        const double bins =
            side_on_bell(peaks->down, one, level) + side_on_bell(peaks->up, one, level);
        peaks->bandwidth_hz[one] = bins * s->bin_hz;
        const double r = peaks->height[one] * peaks->bandwidth_hz[one];
        peaks->r[one] = r;
        peaks->rank[one] = r - r * (LOWER_FIRST * (double)peaks->bin[one]);
    }
    return peaks->r[one] > s->threshold_hz;
}

/* ------------------------------------------------------------------------------------ selection */

/* Choose those above a share of the highest principal one: the others may be its side lobes. */
static void choose_no_side_lobes(const Settings *s, Peaks *peaks, Chosen *chosen)
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
        if (measure_peak(s, peaks, which))
            highest = height;
        else
            peaks->r[which] = 0.0;
    }
    const double under = highest > 0.0 ? s->side_lobe * highest : INFINITY;
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

/* Leave out, of more than n numbers, most of those under the n-th largest; return how many are
 * left. The least of the maxima of n groups is no larger than that. maxima: room for n. */
SIMD_CLONES static int32_t few_largest(double *restrict numbers, int32_t count, int32_t n,
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
static void rule_out(const Settings *s, Work *work)
{
    const int32_t most = (int32_t)s->partials_max;
    Peaks *peaks = &work->peaks;
    Chosen *chosen = &work->chosen;
    bound(s, peaks);
    for (int32_t one = 0; one < chosen->count; one++)
        work->sorting[one] = peaks->bound[chosen->place[one]];
    const int32_t few = few_largest(work->sorting, chosen->count, most, work->sorted);
    const double likely = nth_largest(work->sorting, few, most, work->sorted);
    int32_t known = 0;
    for (int32_t one = 0; one < chosen->count; one++) {
        const int32_t place = chosen->place[one];
        if (peaks->bound[place] >= likely && measure_peak(s, peaks, place))
            work->sorting[known++] = peaks->rank[place];
    }
    /* What is not principal may stay for now. */
    const double least =
        known < most ? 0.0 : nth_largest(work->sorting, known, most, work->sorted);
    int32_t count = 0;
    for (int32_t one = 0; one < chosen->count; one++) {
        const int32_t place = chosen->place[one];
        chosen->place[count] = place;
        count += peaks->bound[place] >= least;
    }
    chosen->count = count;
}

/* Choose what is principal of the chosen, the `most` with the largest r. */
static void choose_strongest(const Settings *s, Work *work)
{
    const int32_t most = (int32_t)s->partials_max;
    Peaks *peaks = &work->peaks;
    Chosen *chosen = &work->chosen;
    if (chosen->count > most)
        rule_out(s, work);
    int32_t count = 0;
    for (int32_t one = 0; one < chosen->count; one++)
        if (measure_peak(s, peaks, chosen->place[one])) {
            work->sorting[count] = peaks->rank[chosen->place[one]];
            chosen->place[count++] = chosen->place[one];
        }
    chosen->count = count;
    if (count <= most)
        return;
    const double least = nth_largest(work->sorting, count, most, work->sorted);
    int32_t equals = 0;
    while (equals < most && work->sorted[most - 1 - equals] == least)
        equals++;
    int32_t kept = 0;
    for (int32_t one = 0; one < count; one++) {
        const double rank = work->sorting[one];
        if (rank > least || (rank == least && equals-- > 0))
            chosen->place[kept++] = chosen->place[one];
    }
    chosen->count = kept;
}

int32_t find_principal(const Settings *s, Spectrum spectrum, Principals found, void *memory)
{
    const int32_t bins = (int32_t)s->bins;
    Work work;
    layout_work(memory, s->bins, &work);
    double *amplitude = work.edges + EDGE;
    for (int32_t edge = 1; edge <= EDGE; edge++)
        amplitude[-edge] = amplitude[bins - 1 + edge] = 0.0;
    Peaks *peaks = &work.peaks;
    peaks_amplitudes(spectrum, amplitude, bins);
    peaks_clear_images(s, spectrum, amplitude, peaks);
    peaks_list(s, amplitude, work.turns, peaks);
    peaks_refine(amplitude, peaks);
    find_steps(amplitude, peaks);
    choose_no_side_lobes(s, peaks, &work.chosen);
    choose_strongest(s, &work);
    for (int32_t one = 0; one < work.chosen.count; one++) {
        const int32_t place = work.chosen.place[one];
        found.audio_hz[one] = ((double)peaks->bin[place] + peaks->offset[place]) * s->bin_hz;
        found.amplitude[one] = peaks->height[place];
        found.bandwidth_hz[one] = peaks->bandwidth_hz[place];
        found.r[one] = peaks->r[place];
    }
    return work.chosen.count;
}
